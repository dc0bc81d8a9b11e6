//! Ctrl-C, termination, lack of memory and crashes: leave no half-written file. Ctrl-C and
//! termination exit with 130, lack of memory with 2; crashes end the process by their signal.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{LazyLock, OnceLock};
#[cfg(unix)]
use std::time::Duration;

use meniscus::Cancel;

/// The cancel handle of this process.
static CANCEL: LazyLock<Cancel> = LazyLock::new(|| {
    // Fails if the caller of the library has installed a handler.
    let _ = ctrlc::set_handler(|| {
        CANCEL.abandon();
        let what = if RESUMABLE.load(Ordering::Relaxed) {
            "finished frames are kept; --resume continues"
        } else {
            "nothing was written"
        };
        super::notes::say(&format!("meniscus: interrupted; {what}"));
        std::process::exit(130);
    });
    let cancel = Cancel::new();
    let _ = UNFINISHED.set(cancel.clone());
    cancel
});

/// The cancel handle, once it is there, for the handlers of signals.
static UNFINISHED: OnceLock<Cancel> = OnceLock::new();

/// Installs handlers of SIGABRT, which the standard library raises when no memory is left, and of
/// the signals of a crash, which may happen in a driver.
#[cfg(unix)]
pub fn catch_crashes() {
    extern "C" fn abort(_: libc::c_int) {
        abandon(
            b"meniscus: aborted, probably because memory ran out; use a smaller --memory \
            or fewer --threads\n",
        );
        // SAFETY: may be called in a handler.
        unsafe { libc::_exit(2) };
    }
    extern "C" fn crash(signal: libc::c_int) {
        // SAFETY: may be called in a handler. A crash that corrupted what `abandon` needs could
        // make it wait for ever.
        unsafe { libc::alarm(2) };
        abandon(
            b"meniscus: crashed. If it used a Vulkan device, the driver may be the cause: try \
            --backend cpu. Otherwise, please report this\n",
        );
        // SAFETY: may be called in a handler. The signal waits until this handler returns, and then
        // ends the process.
        unsafe {
            libc::signal(signal, libc::SIG_DFL);
            libc::raise(signal);
        }
    }
    let handle = |signal, handler: extern "C" fn(libc::c_int)| {
        // SAFETY: the handlers wait at most 2 s. They run on the stack that the standard library
        // gives threads for handlers, because the usual one may be full.
        unsafe {
            let mut action: libc::sigaction = std::mem::zeroed();
            action.sa_sigaction = handler as libc::sighandler_t;
            action.sa_flags = libc::SA_ONSTACK;
            libc::sigaction(signal, &action, std::ptr::null_mut());
        }
    };
    handle(libc::SIGABRT, abort);
    for signal in [libc::SIGSEGV, libc::SIGBUS, libc::SIGILL, libc::SIGFPE] {
        handle(signal, crash);
    }
}

/// Prints the message and removes all unfinished files, in a handler of a signal.
#[cfg(unix)]
fn abandon(message: &[u8]) {
    static IS_ABANDONED: AtomicBool = AtomicBool::new(false);
    if IS_ABANDONED.swap(true, Ordering::Relaxed) {
        // Another thread removes the files, or this one failed to.
        std::thread::sleep(Duration::from_millis(300));
        return;
    }
    // SAFETY: may be called in a handler.
    unsafe { libc::write(libc::STDERR_FILENO, message.as_ptr().cast(), message.len()) };
    if let Some(cancel) = UNFINISHED.get() {
        cancel.abandon_soon();
    }
}

#[cfg(not(unix))]
pub fn catch_crashes() {}

/// Whether an interrupt keeps finished frames.
static RESUMABLE: AtomicBool = AtomicBool::new(false);

/// The handle to pass to all work, so that an interrupt removes half-written files.
pub fn handle() -> Cancel {
    CANCEL.clone()
}

/// Declares that from now on frames are finished one by one, and are kept.
pub fn resumable() {
    RESUMABLE.store(true, Ordering::Relaxed);
}

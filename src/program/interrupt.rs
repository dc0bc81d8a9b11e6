//! Removes half-written files when Ctrl-C, termination, lack of memory or a crash ends the process.
//! The exit code is 130 after Ctrl-C or termination, and 2 after lack of memory. A crash ends the
//! process with the signal of the crash.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{LazyLock, OnceLock};
#[cfg(unix)]
use std::time::Duration;

use meniscus::Cancel;

/// The cancel handle of this process.
static CANCEL: LazyLock<Cancel> = LazyLock::new(|| {
    #[cfg(unix)]
    let ignored = ignored_signals();
    // `set_handler` fails if the caller of this library has already installed a handler, which then
    // stays in place.
    let _ = ctrlc::set_handler(|| {
        CANCEL.abandon();
        let what = if RESUMABLE.load(Ordering::Relaxed) {
            "finished frames are kept; --resume continues"
        } else {
            "no unfinished file remains"
        };
        super::notes::say(&format!("meniscus: interrupted; {what}"));
        std::process::exit(130);
    });
    #[cfg(unix)]
    ignored.for_each(ignore);
    let cancel = Cancel::new();
    let _ = HANDLER_CANCEL.set(cancel.clone());
    cancel
});

/// The signals that the parent process made this process ignore. For example, `nohup` makes a
/// program ignore the end of the session, and a shell makes a background job ignore Ctrl-C.
#[cfg(unix)]
fn ignored_signals() -> impl Iterator<Item = libc::c_int> {
    let signals = [libc::SIGHUP, libc::SIGINT, libc::SIGTERM];
    let ignored = signals.map(|signal| {
        // SAFETY: the pointer to the new action is null, so `sigaction` only reads the current
        // action.
        let action = unsafe {
            let mut action: libc::sigaction = std::mem::zeroed();
            libc::sigaction(signal, std::ptr::null(), &mut action);
            action
        };
        (signal, action.sa_sigaction == libc::SIG_IGN)
    });
    ignored.into_iter().filter(|(_, is_ignored)| *is_ignored).map(|(signal, _)| signal)
}

#[cfg(unix)]
fn ignore(signal: libc::c_int) {
    // SAFETY: no other thread changes the handler of this signal.
    unsafe { libc::signal(signal, libc::SIG_IGN) };
}

/// The cancel handle for signal handlers, set when `CANCEL` is first used.
static HANDLER_CANCEL: OnceLock<Cancel> = OnceLock::new();

/// Installs signal handlers for SIGABRT, which the standard library raises when no memory is left,
/// and for crashes, which may happen in a driver. Also installs a panic hook: if a new thread has
/// no memory for its signal stack, the standard library panics, and the hook aborts the process
/// (SIGABRT).
#[cfg(unix)]
pub fn catch_crashes() {
    extern "C" fn abort(_: libc::c_int) {
        abandon(
            b"meniscus: aborted, probably because memory ran out; use a smaller --memory \
            or fewer --threads\n",
        );
        // SAFETY: `_exit` may be called in a signal handler.
        unsafe { libc::_exit(2) };
    }
    extern "C" fn crash(signal: libc::c_int) {
        // SAFETY: `alarm` may be called in a signal handler. The alarm ends the process if
        // `abandon` waits forever because the crash corrupted its data.
        unsafe { libc::alarm(2) };
        abandon(
            b"meniscus: crashed. If it used a GPU, the Vulkan driver may be the cause: try \
            --backend cpu. Otherwise, please report this crash\n",
        );
        // SAFETY: both functions may be called in a signal handler. The raised signal is blocked
        // until this handler returns, and then ends the process.
        unsafe {
            libc::signal(signal, libc::SIG_DFL);
            libc::raise(signal);
        }
    }
    let handle = |signal, handler: extern "C" fn(libc::c_int)| {
        // SAFETY: the handlers wait at most 2 s. They run on the separate stack that the standard
        // library allocates for signal handlers, because the thread's own stack may be full.
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
    let print = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        if panic.location().is_some_and(|location| location.file().ends_with("stack_overflow.rs")) {
            std::process::abort();
        }
        print(panic);
    }));
}

/// Prints the message and removes all unfinished files, from a signal handler.
#[cfg(unix)]
fn abandon(message: &[u8]) {
    static IS_ABANDONED: AtomicBool = AtomicBool::new(false);
    if IS_ABANDONED.swap(true, Ordering::Relaxed) {
        // Another thread is removing the files and needs time to finish, or this thread crashed
        // while removing them.
        std::thread::sleep(Duration::from_millis(300));
        return;
    }
    // SAFETY: `write` may be called in a signal handler.
    unsafe { libc::write(libc::STDERR_FILENO, message.as_ptr().cast(), message.len()) };
    if let Some(cancel) = HANDLER_CANCEL.get() {
        cancel.abandon_soon();
    }
}

#[cfg(not(unix))]
pub fn catch_crashes() {}

/// Whether an interrupt keeps finished frames.
static RESUMABLE: AtomicBool = AtomicBool::new(false);

/// Returns the cancel handle to pass to all work, so that an interrupt removes half-written files.
pub fn handle() -> Cancel {
    CANCEL.clone()
}

/// Declares that an interrupt keeps finished frames from now on. Affects only the message.
pub fn set_resumable() {
    RESUMABLE.store(true, Ordering::Relaxed);
}

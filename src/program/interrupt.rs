//! Ctrl-C, termination and lack of memory: leave no half-written file. Ctrl-C and termination exit
//! with 130, lack of memory with 2.

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
            "what is done stays; --resume goes on"
        } else {
            "nothing was written"
        };
        super::notes::say(&format!("meniscus: interrupted; {what}"));
        std::process::exit(130);
    });
    let cancel = Cancel::new();
    let _ = ABORTED.set(cancel.clone());
    cancel
});

/// The cancel handle, once it is there, for the handler of SIGABRT.
static ABORTED: OnceLock<Cancel> = OnceLock::new();

/// Installs a handler of SIGABRT, which the standard library raises when no memory is left.
#[cfg(unix)]
pub fn catch_lack_of_memory() {
    extern "C" fn abandon(_: libc::c_int) {
        static IS_ABANDONED: AtomicBool = AtomicBool::new(false);
        const MESSAGE: &[u8] =
            b"meniscus: aborted, probably for lack of memory; a smaller --memory \
            and fewer --threads need less\n";
        if IS_ABANDONED.swap(true, Ordering::Relaxed) {
            // Another thread removes the files, or this one lacks memory for that.
            std::thread::sleep(Duration::from_millis(300));
        } else {
            // SAFETY: may be called in a handler.
            unsafe { libc::write(libc::STDERR_FILENO, MESSAGE.as_ptr().cast(), MESSAGE.len()) };
            if let Some(cancel) = ABORTED.get() {
                cancel.abandon_soon();
            }
        }
        // SAFETY: may be called in a handler.
        unsafe { libc::_exit(2) };
    }
    // SAFETY: `abandon` waits at most 0.3 s, and never returns.
    unsafe {
        let mut action: libc::sigaction = std::mem::zeroed();
        action.sa_sigaction = abandon as extern "C" fn(libc::c_int) as libc::sighandler_t;
        libc::sigaction(libc::SIGABRT, &action, std::ptr::null_mut());
    }
}

#[cfg(not(unix))]
pub fn catch_lack_of_memory() {}

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

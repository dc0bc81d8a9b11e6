//! Ctrl-C, termination and lack of memory: leave no half-written file. Ctrl-C and termination exit
//! with 130, lack of memory with 2.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{LazyLock, OnceLock};

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
        if let Some(cancel) = ABORTED.get() {
            cancel.abandon_soon();
        }
        const MESSAGE: &[u8] =
            b"meniscus: aborted, probably for lack of memory; a smaller --memory \
            and fewer --threads need less\n";
        // SAFETY: both functions may be called in a handler.
        unsafe {
            libc::write(libc::STDERR_FILENO, MESSAGE.as_ptr().cast(), MESSAGE.len());
            libc::_exit(2);
        }
    }
    // SAFETY: `abandon` waits at most 0.2 s, and never returns. If it lacks memory itself,
    // the second SIGABRT ends the process.
    unsafe {
        let mut action: libc::sigaction = std::mem::zeroed();
        action.sa_sigaction = abandon as extern "C" fn(libc::c_int) as libc::sighandler_t;
        action.sa_flags = libc::SA_RESETHAND;
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

//! Ctrl-C and termination: leave no half-written file, and exit with 130.

use std::sync::LazyLock;
use std::sync::atomic::{AtomicBool, Ordering};

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
    Cancel::new()
});

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

//! Ctrl-C and termination: leave no half-written file, and exit with 130.

use std::sync::LazyLock;
use std::sync::atomic::{AtomicBool, Ordering};

use meniscus::Cancel;

/// The handle of all work of this process.
static CANCEL: LazyLock<Cancel> = LazyLock::new(|| {
    // Where there is a handler already, it is another's.
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

/// Whether frames that are done stay when an interrupt comes.
static RESUMABLE: AtomicBool = AtomicBool::new(false);

/// The handle that work has to take, so that an interrupt removes what it has half written.
pub fn handle() -> Cancel {
    CANCEL.clone()
}

/// From now on frames are done one by one, and stay.
pub fn resumable() {
    RESUMABLE.store(true, Ordering::Relaxed);
}

//! Ctrl-C and termination: leave no half-written file, and exit with 130.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// The temporary file of the output in progress.
static UNFINISHED: Mutex<Option<PathBuf>> = Mutex::new(None);

/// From now on an interrupt removes `temporary` before the process ends.
pub fn remove_on_interrupt(temporary: Option<&Path>) {
    *UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner) = temporary.map(Path::to_owned);
    // A second call finds the handler in place, which is what it is for.
    let _ = ctrlc::set_handler(|| {
        let unfinished = UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(path) = &*unfinished {
            let _ = std::fs::remove_file(path);
        }
        eprintln!("meniscus: interrupted; nothing was written");
        std::process::exit(130);
    });
}

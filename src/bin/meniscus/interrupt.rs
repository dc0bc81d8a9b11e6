//! Ctrl-C and termination: leave no half-written file, and exit with 130.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError, RwLock, RwLockReadGuard};

/// The temporary files of the outputs in progress.
static UNFINISHED: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());
/// Held by everyone whom no interrupt may disturb, and for good by the interrupt itself.
static UNDISTURBED: RwLock<()> = RwLock::new(());
/// Whether frames that are done stay when an interrupt comes.
static RESUMABLE: AtomicBool = AtomicBool::new(false);

fn unfinished() -> MutexGuard<'static, Vec<PathBuf>> {
    UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner)
}

fn hold() -> RwLockReadGuard<'static, ()> {
    UNDISTURBED.read().unwrap_or_else(PoisonError::into_inner)
}

/// An output in progress: as long as this lives, an interrupt removes its temporary file.
pub struct Unfinished(Option<PathBuf>);

impl Drop for Unfinished {
    fn drop(&mut self) {
        let _held = hold();
        unfinished().retain(|path| Some(path) != self.0.as_ref());
    }
}

/// Prepares an output whose `temporary` file an interrupt removes. None comes between its creation and this.
pub fn guard<T, E>(
    prepare: impl FnOnce() -> Result<T, E>,
    temporary: impl Fn(&T) -> Option<&Path>,
) -> Result<(T, Unfinished), E> {
    handle();
    let _held = hold();
    let output = prepare()?;
    let path = temporary(&output).map(Path::to_owned);
    unfinished().extend(path.clone());
    Ok((output, Unfinished(path)))
}

/// Does something short that no interrupt comes between.
pub fn undisturbed<T>(act: impl FnOnce() -> T) -> T {
    let _held = hold();
    act()
}

/// From now on frames are done one by one, and stay.
pub fn resumable() {
    RESUMABLE.store(true, Ordering::Relaxed);
    handle();
}

fn handle() {
    // A second call finds the handler in place, which is what it is for.
    let _ = ctrlc::set_handler(|| {
        // Never unlocked again: whoever would create a file from now on waits for the end.
        let _held = UNDISTURBED.write().unwrap_or_else(PoisonError::into_inner);
        for path in &*unfinished() {
            let _ = std::fs::remove_file(path);
        }
        let what = if RESUMABLE.load(Ordering::Relaxed) {
            "what is done stays; --resume goes on"
        } else {
            "nothing was written"
        };
        crate::say::say(&format!("meniscus: interrupted; {what}"));
        std::process::exit(130);
    });
}

//! Cancels work at any time and from any thread, without leaving unfinished files.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock, RwLockReadGuard};
use std::time::Duration;

use thiserror::Error;

/// A handle to cancel work; its clones share one state.
///
/// ```
/// use meniscus::{Cancel, Cause, Reconstruction};
///
/// let cancel = Cancel::new();
/// let request = Reconstruction::new().spacing(1.0).cancel(cancel.clone());
/// cancel.cancel();
/// let error = request.run(&[[0.0; 3]][..]).unwrap_err();
/// assert_eq!(error.cause(), Cause::Cancelled);
/// ```
#[derive(Debug, Clone, Default)]
pub struct Cancel(Arc<CancelState>);

/// The error of cancelled work.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[error("cancelled")]
pub struct Cancelled;

impl From<Cancelled> for io::Error {
    fn from(cancelled: Cancelled) -> Self {
        Self::other(cancelled)
    }
}

#[derive(Debug, Default)]
struct CancelState {
    cancelled: AtomicBool,
    /// For each output in progress: its temporary files, followed by the folders that were created
    /// for them.
    unfinished: Mutex<Vec<PathBuf>>,
    /// A thread holds this lock for reading while it does work that
    /// [`abandon`](Cancel::abandon) must not interrupt. `abandon` takes the lock for writing, and
    /// never releases it.
    undisturbed: RwLock<()>,
}

impl Cancel {
    /// A handle that is not cancelled.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Cancels all work that has this handle. The work soon ends with the error [`Cancelled`].
    /// Every stage of a frame checks the handle.
    pub fn cancel(&self) {
        self.0.cancelled.store(true, Ordering::Relaxed);
    }

    /// Whether the work was cancelled.
    #[must_use]
    pub fn is_cancelled(&self) -> bool {
        self.0.cancelled.load(Ordering::Relaxed)
    }

    /// Returns an error if the work was cancelled.
    ///
    /// # Errors
    /// [`Cancelled`].
    pub(crate) fn go_on(&self) -> Result<(), Cancelled> {
        if self.is_cancelled() { Err(Cancelled) } else { Ok(()) }
    }

    /// Removes all unfinished outputs, for a process that is about to exit. Outputs that already
    /// have their final name stay.
    ///
    /// First waits for threads that are in a step that must not be interrupted. Such a step writes
    /// the plan of a frame's parts or a record of a conversion, such as the record of a finished
    /// frame, or begins or ends an output. A thread that reaches such a step after this call waits
    /// forever.
    pub fn abandon(&self) {
        let held = self.0.undisturbed.write().unwrap_or_else(PoisonError::into_inner);
        remove(&self.unfinished());
        std::mem::forget(held);
    }

    /// Like [`abandon`](Self::abandon), for a process that has crashed or run out of memory. Waits
    /// at most 0.2 s for the locks, because the calling thread may hold them itself, if it was
    /// interrupted while it began or ended an output.
    pub fn abandon_soon(&self) {
        let soon = || (0..100).inspect(|_| std::thread::sleep(Duration::from_millis(1)));
        let held = soon().find_map(|_| self.0.undisturbed.try_write().ok());
        if let Some(unfinished) = soon().find_map(|_| self.0.unfinished.try_lock().ok()) {
            remove(&unfinished);
        }
        std::mem::forget(held);
    }

    fn unfinished(&self) -> MutexGuard<'_, Vec<PathBuf>> {
        self.0.unfinished.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn hold(&self) -> RwLockReadGuard<'_, ()> {
        self.0.undisturbed.read().unwrap_or_else(PoisonError::into_inner)
    }

    /// Runs `act` without interruption by [`abandon`](Self::abandon).
    pub(crate) fn undisturbed<T>(&self, act: impl FnOnce() -> T) -> T {
        let _held = self.hold();
        act()
    }

    /// Prepares an output, and registers its temporary files and folders, which `temporary` lists.
    /// [`abandon`](Self::abandon) removes registered paths: first the files, then the empty
    /// folders. `abandon` cannot run between `prepare` and the registration, so it finds everything
    /// that `prepare` created.
    pub(crate) fn guard<T, E>(
        &self,
        prepare: impl FnOnce() -> Result<T, E>,
        temporary: impl Fn(&T) -> Vec<PathBuf>,
    ) -> Result<(T, UnfinishedOutput), E> {
        let _held = self.hold();
        let output = prepare()?;
        let paths = temporary(&output);
        self.unfinished().extend(paths.clone());
        Ok((output, UnfinishedOutput { cancel: self.clone(), paths }))
    }
}

/// Suffixes of the companion folders of a temporary file: the new folder, and the old folder that
/// it replaces.
pub(crate) const COMPANION_SUFFIXES: [&str; 2] = [".new", ".old"];

/// The companion folder of a temporary file with the suffix `ending`.
pub(crate) fn companion_folder(temporary: &Path, ending: &str) -> PathBuf {
    let mut name = temporary.as_os_str().to_owned();
    name.push(ending);
    name.into()
}

/// Removes the temporary files and their companion folders, and then the empty folders.
fn remove(unfinished: &[PathBuf]) {
    for path in unfinished {
        let _ = std::fs::remove_file(path);
    }
    unfinished.iter().for_each(|path| remove_companions(path));
    for path in unfinished {
        let _ = std::fs::remove_dir(path);
    }
}

/// Removes the companion folders of a temporary file.
pub(crate) fn remove_companions(temporary: &Path) {
    for ending in COMPANION_SUFFIXES {
        let _ = std::fs::remove_dir_all(companion_folder(temporary, ending));
    }
}

/// An output in progress. Until this value is dropped, [`Cancel::abandon`] removes its temporary
/// files.
#[derive(Debug)]
pub(crate) struct UnfinishedOutput {
    cancel: Cancel,
    paths: Vec<PathBuf>,
}

impl UnfinishedOutput {
    /// Whether the work was cancelled.
    pub(crate) fn is_cancelled(&self) -> bool {
        self.cancel.is_cancelled()
    }
}

impl Drop for UnfinishedOutput {
    fn drop(&mut self) {
        let _held = self.cancel.hold();
        let mut unfinished = self.cancel.unfinished();
        for registered in &self.paths {
            // Other outputs may have registered the same folder, so only one of its entries is
            // removed.
            if let Some(at) = unfinished.iter().position(|path| path == registered) {
                unfinished.remove(at);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn abandon_deletes_unfinished_outputs_and_keeps_finished_ones() {
        let folder = tempfile::tempdir().unwrap();
        let [done, begun] = ["done", "begun"].map(|name| folder.path().join(name));
        let cancel = Cancel::new();
        let create = |path: &PathBuf| {
            let prepare = || fs::write(path, "half").map(|()| path.clone());
            cancel.guard(prepare, |path| vec![path.clone()]).unwrap().1
        };
        drop(create(&done));
        let unfinished = create(&begun);
        cancel.abandon();
        assert!(done.exists() && !begun.exists());
        assert!(!cancel.is_cancelled());
        // Dropping `unfinished` would wait forever, because `abandon` never releases its lock.
        std::mem::forget(unfinished);
    }

    #[test]
    fn abandon_deletes_the_empty_folders_made_for_unfinished_outputs() {
        let folder = tempfile::tempdir().unwrap();
        let [outer, inner] = ["outer", "outer/inner"].map(|name| folder.path().join(name));
        let cancel = Cancel::new();
        let begin = |name: &str| {
            let file = inner.join(name);
            let prepare = || {
                fs::create_dir_all(&inner)?;
                fs::write(&file, "half")
            };
            let paths = || vec![file.clone(), inner.clone(), outer.clone()];
            cancel.guard(prepare, |()| paths()).unwrap().1
        };
        // Dropping the first output removes one of the two entries for each folder.
        drop(begin("done"));
        let second = begin("second");
        fs::remove_file(inner.join("done")).unwrap();
        cancel.abandon();
        assert!(!outer.exists());
        std::mem::forget(second);
    }
}

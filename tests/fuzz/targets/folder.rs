//! A temporary folder for each thread, in which targets write files repeatedly.

use std::fs;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

thread_local! {
    static FOLDER: TempDir = in_memory().unwrap_or_else(|| tempfile::tempdir().unwrap());
}

/// Creates a folder in an in-memory file system, if there is one. Most disks are slow at truncating
/// and rewriting files.
fn in_memory() -> Option<TempDir> {
    tempfile::tempdir_in("/dev/shm").ok()
}

/// The path of a file with this name in this thread's folder.
pub fn path(name: &str) -> PathBuf {
    FOLDER.with(|folder| folder.path().join(name))
}

/// Writes a file into this thread's folder.
pub fn file(name: &str, bytes: &[u8]) -> PathBuf {
    let path = path(name);
    fs::write(&path, bytes).unwrap();
    path
}

/// Creates or empties a folder in this thread's folder.
pub fn empty(name: &str) -> PathBuf {
    let folder = path(name);
    clear(&folder);
    folder
}

/// Empties a folder, or creates it if it does not exist.
fn clear(folder: &Path) {
    match fs::remove_dir_all(folder) {
        Err(fault) if fault.kind() == std::io::ErrorKind::NotFound => {}
        removed => removed.unwrap(),
    }
    fs::create_dir_all(folder).unwrap();
}

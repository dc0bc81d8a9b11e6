//! Files that their process holds while it works on them, by which others tell whether it lives.
//!
//! On Windows a file is held by refusing others the right to write: a lock there would refuse it to
//! its holder, too. Elsewhere it is held by a lock, which most network file systems pass on.

use std::fs::{File, OpenOptions, TryLockError};
use std::io;
use std::path::Path;

/// Creates a file that this process holds until it is closed.
///
/// Where locks are missing nobody can tell, and nothing that is held is taken. Where another process
/// takes the file at once, it may have no name any more when this returns.
///
/// # Errors
/// The system's, such as [`io::ErrorKind::AlreadyExists`].
pub fn create(path: &Path) -> io::Result<File> {
    let file = options().create_new(true).open(path)?;
    #[cfg(not(windows))]
    let _ = file.lock_shared();
    Ok(file)
}

/// Opens a file that no process holds, and keeps others from taking it until it is closed.
///
/// # Errors
/// [`TryLockError::WouldBlock`] for a file that is held or taken, and the system's own.
pub fn take(path: &Path) -> Result<File, TryLockError> {
    let file = options().open(path).map_err(|fault| match fault.raw_os_error() {
        Some(SHARING_VIOLATION) if cfg!(windows) => TryLockError::WouldBlock,
        _ => TryLockError::Error(fault),
    })?;
    #[cfg(not(windows))]
    file.try_lock()?;
    Ok(file)
}

/// Whether a process holds a file, as far as the file system tells.
pub fn is_held(path: &Path) -> bool {
    matches!(take(path), Err(TryLockError::WouldBlock))
}

/// The error of Windows for a file that another process keeps from being opened like that.
const SHARING_VIOLATION: i32 = 32;

/// Options for reading and writing: over a network some locks are for readers, and some for writers.
fn options() -> OpenOptions {
    let mut options = OpenOptions::new();
    options.read(true).write(true);
    #[cfg(windows)]
    {
        use std::os::windows::fs::OpenOptionsExt;
        const READ: u32 = 1;
        const DELETE: u32 = 4;
        // Others may read the file, rename and delete it, and not write it.
        options.share_mode(READ | DELETE);
    }
    options
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::io::{Read, Write};

    use super::*;

    #[test]
    fn what_is_held_is_written_read_and_renamed_but_not_taken() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log");
        let mut file = create(&path).unwrap();
        file.write_all(b"line").unwrap();
        assert!(is_held(&path) && take(&path).is_err());
        assert_eq!(fs::read(&path).unwrap(), b"line");
        let renamed = folder.path().join("renamed");
        fs::rename(&path, &renamed).unwrap();
        file.write_all(b" more").unwrap();
        drop(file);
        let mut taken = take(&renamed).unwrap();
        assert!(is_held(&renamed));
        let mut text = String::new();
        taken.read_to_string(&mut text).unwrap();
        assert_eq!(text, "line more");
        fs::remove_file(&renamed).unwrap();
        drop(taken);
        assert!(!renamed.exists() && !is_held(&renamed));
    }
}

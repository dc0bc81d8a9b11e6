//! Files that a process holds while it works on them, so that other processes can detect whether
//! that process is still running.
//!
//! On Windows, the holder opens the file in a mode in which no other process can write to it,
//! because a lock would also prevent the holder from writing. On other systems, the holder locks
//! the file. Most network file systems support such locks.

use std::fs::{File, OpenOptions, TryLockError};
use std::io;
use std::path::Path;

/// Creates a file that this process holds until the file is closed.
///
/// On a file system without locks, other processes cannot detect whether the file is held, and
/// cannot take it. Another process can take the file after this function creates it and before this
/// function locks it. That process may have deleted the file by the time this function returns.
///
/// # Errors
/// Errors of the system, such as [`io::ErrorKind::AlreadyExists`].
pub fn create(path: &Path) -> io::Result<File> {
    let file = options().create_new(true).open(path)?;
    #[cfg(not(windows))]
    let _ = file.lock_shared();
    Ok(file)
}

/// Opens a file that no process holds, and prevents other processes from taking it until it is
/// closed.
///
/// # Errors
/// [`TryLockError::WouldBlock`] for a file that is held or taken, and errors of the system.
pub fn take(path: &Path) -> Result<File, TryLockError> {
    let file = options().open(path).map_err(|fault| match fault.raw_os_error() {
        Some(SHARING_VIOLATION) if cfg!(windows) => TryLockError::WouldBlock,
        _ => TryLockError::Error(fault),
    })?;
    #[cfg(not(windows))]
    file.try_lock()?;
    Ok(file)
}

/// Whether a process holds or has taken a file. Always false on a file system without locks.
pub fn is_held(path: &Path) -> bool {
    matches!(take(path), Err(TryLockError::WouldBlock))
}

/// The error code of Windows for a file that another process has opened and does not share.
const SHARING_VIOLATION: i32 = 32;

/// Options that open a file for reading and writing, because some locks on network file systems
/// need read access, and others need write access.
fn options() -> OpenOptions {
    let mut options = OpenOptions::new();
    options.read(true).write(true);
    #[cfg(windows)]
    {
        use std::os::windows::fs::OpenOptionsExt;
        const READ: u32 = 1;
        const DELETE: u32 = 4;
        // Other processes may read, rename and delete the file, but not write to it.
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
    fn a_held_file_can_be_read_and_renamed_but_not_taken() {
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

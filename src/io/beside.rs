//! Writes the folder of files that a list file names. The folder gets its final name just before
//! the list does.
//!
//! Because of this order, a list never names missing files. Until the folder is renamed, it has a
//! temporary name, which is derived from the name of the list's temporary file. If the work is
//! abandoned, the folder and the list's temporary file are removed.

use std::fs::{self, File, TryLockError};
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

use crc32fast::Hasher;

use crate::system::cancel::{COMPANION_SUFFIXES, companion_folder};

use super::whole::write_counted_to_file;

/// A folder that is being filled. It is removed on drop unless [`keep`](Self::keep) is called.
#[derive(Debug)]
pub struct FolderInProgress {
    temporary: PathBuf,
    /// The path to which an existing folder is moved if it is replaced. The moved folder is removed
    /// on drop.
    replaced: PathBuf,
    /// The final path of the folder.
    target: PathBuf,
    /// The final name of the folder, with which the names of its files begin.
    stem: String,
    extension: &'static str,
    /// Checksum of the files written so far.
    sum: Hasher,
}

impl FolderInProgress {
    /// Creates a temporary folder for files with the extension `extension`. The folder's final name
    /// will be the name of the file `list` without that file's extension. `temporary` is the path
    /// of the list's temporary file.
    ///
    /// # Errors
    /// If the folder cannot be created, and [`io::ErrorKind::InvalidInput`] if the name of `list`
    /// is not Unicode.
    pub fn begin(list: &Path, temporary: &Path, extension: &'static str) -> io::Result<Self> {
        let (target, stem) = folder_and_stem(list)?;
        let [temporary, replaced] =
            COMPANION_SUFFIXES.map(|ending| companion_folder(temporary, ending));
        fs::create_dir(&temporary)?;
        Ok(Self { temporary, replaced, target, stem, extension, sum: Hasher::new() })
    }

    /// Checks whether the folder for the file `list` may be created or replaced.
    ///
    /// An existing folder may be replaced if it is empty, or if `replaceable` is true and it
    /// contains only files that are named like those of [`write`](Self::write).
    ///
    /// # Errors
    /// [`io::ErrorKind::InvalidInput`] if the folder contains other files, or if the name of
    /// `list` is not Unicode. [`io::ErrorKind::AlreadyExists`] if the folder is not empty and
    /// `replaceable` is false. The system's error if the folder cannot be read.
    pub fn check(list: &Path, extension: &str, replaceable: bool) -> io::Result<()> {
        let (folder, stem) = folder_and_stem(list)?;
        let entries = match fs::read_dir(&folder) {
            Ok(entries) => entries,
            Err(fault) if fault.kind() == ErrorKind::NotFound => return Ok(()),
            Err(fault) => return Err(fault),
        };
        let mut empty = true;
        for entry in entries {
            let name = entry?.file_name();
            let is_ours = name.to_str().is_some_and(|name| is_piece(name, &stem, extension));
            if !is_ours {
                let what = format!(
                    "its pieces go into the folder {}, which contains other files; choose another \
                     name",
                    folder.display()
                );
                return Err(io::Error::new(ErrorKind::InvalidInput, what));
            }
            empty = false;
        }
        if empty || replaceable { Ok(()) } else { Err(ErrorKind::AlreadyExists.into()) }
    }

    /// Path of file number `number`, relative to the parent of the folder.
    pub fn name(&self, number: u64) -> String {
        let Self { stem, extension, .. } = self;
        format!("{stem}/{stem}_{number}.{extension}")
    }

    /// Writes file number `number`, and waits until it is on disk. Files must be written in order.
    ///
    /// # Errors
    /// If the file cannot be created or written, and the errors of `content`.
    pub fn write(
        &mut self,
        number: u64,
        content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
    ) -> io::Result<()> {
        let name = self.name(number);
        let name = name.rsplit('/').next().unwrap_or_default();
        let file = File::create_new(self.temporary.join(name))?;
        let (_, sum) = write_counted_to_file(&file, Some(Hasher::new()), content)?;
        sum.iter().for_each(|sum| self.sum.combine(sum));
        file.sync_all()
    }

    /// Checksum of the list followed by all files. `crc` is the checksum of the list, and `bytes`
    /// is its size in bytes.
    pub fn checksum_after_list(&self, crc: u32, bytes: u64) -> u32 {
        let mut all = Hasher::new_with_initial_len(crc, bytes);
        all.combine(&self.sum);
        all.finalize()
    }

    /// Renames the folder to its final name.
    ///
    /// If a folder with this name exists and `replaceable` is true, first removes the existing file
    /// `list`, which names the files in the existing folder, and then replaces that folder. The
    /// caller should hold the lock of [`lock_parent_folder`], so that other processes that write
    /// the same output wait. On a file system without locks, these processes do not wait, and the
    /// folder of the process that finishes last remains.
    ///
    /// # Errors
    /// [`io::ErrorKind::AlreadyExists`] if `list` or the folder exists and `replaceable` is false,
    /// and the system's error if a file or folder cannot be renamed or removed.
    pub fn keep(self, list: &Path, replaceable: bool) -> io::Result<()> {
        if !replaceable && list.symlink_metadata().is_ok() {
            return Err(ErrorKind::AlreadyExists.into());
        }
        let mut tries_left = TRIES;
        while let Err(fault) = fs::rename(&self.temporary, &self.target) {
            let taken =
                matches!(fault.kind(), ErrorKind::DirectoryNotEmpty | ErrorKind::AlreadyExists)
                    || self.target.is_dir();
            tries_left -= 1;
            if !taken || tries_left == 0 {
                return Err(fault);
            }
            if !replaceable {
                return Err(ErrorKind::AlreadyExists.into());
            }
            ignore_not_found(fs::remove_file(list))?;
            ignore_not_found(fs::remove_dir_all(&self.replaced))?;
            ignore_not_found(fs::rename(&self.target, &self.replaced))?;
        }
        Ok(())
    }
}

/// Maximum number of attempts to rename the folder while other processes keep creating a folder
/// with the final name.
const TRIES: u32 = 100;

/// Ignores the error that a file is missing, because another process may have moved or removed it.
fn ignore_not_found(result: io::Result<()>) -> io::Result<()> {
    result.or_else(|fault| if fault.kind() == ErrorKind::NotFound { Ok(()) } else { Err(fault) })
}

/// Maximum time to wait for a lock.
const LOCK_TIMEOUT: Duration = Duration::from_secs(2);
/// Interval between attempts to take a lock.
const PAUSE: Duration = Duration::from_millis(2);

/// Locks the parent folder of the file `list`, so that only one process at a time renames a list
/// and its folder. The lock is released when the returned file is dropped. Returns `None` if the
/// folder cannot be locked, or if another process holds the lock for longer than `LOCK_TIMEOUT`.
pub fn lock_parent_folder(list: &Path) -> Option<File> {
    let folder =
        list.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let folder = File::open(folder).ok()?;
    let begun = Instant::now();
    loop {
        match folder.try_lock() {
            Ok(()) => return Some(folder),
            Err(TryLockError::WouldBlock) if begun.elapsed() < LOCK_TIMEOUT => thread::sleep(PAUSE),
            Err(_) => return None,
        }
    }
}

impl Drop for FolderInProgress {
    fn drop(&mut self) {
        for folder in [&self.temporary, &self.replaced] {
            let _ = fs::remove_dir_all(folder);
        }
    }
}

/// The path of the folder that belongs to the file `list`, and the folder's name.
fn folder_and_stem(list: &Path) -> io::Result<(PathBuf, String)> {
    let stem = list.file_stem().and_then(|stem| stem.to_str()).map(str::to_owned);
    let not_unicode = || {
        io::Error::new(
            ErrorKind::InvalidInput,
            "its name is not valid Unicode, so other files cannot refer to it; rename it",
        )
    };
    let stem = stem.ok_or_else(not_unicode)?;
    Ok((list.with_file_name(&stem), stem))
}

fn is_piece(name: &str, stem: &str, extension: &str) -> bool {
    let number = name.strip_prefix(stem).and_then(|rest| rest.strip_prefix('_'));
    let number = number
        .and_then(|rest| rest.strip_suffix(extension))
        .and_then(|rest| rest.strip_suffix('.'));
    number.is_some_and(|number| {
        !number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Creates a folder with one file next to `m.list`. The file contains the name of the job.
    fn folder_of_job(within: &Path, job: &str) -> FolderInProgress {
        let mut folder =
            FolderInProgress::begin(&within.join("m.list"), &within.join(job), "piece").unwrap();
        folder.write(0, |out| out.write_all(job.as_bytes())).unwrap();
        folder
    }

    #[test]
    fn concurrent_replacements_of_a_folder_all_succeed() {
        let within = tempfile::tempdir().unwrap();
        let (list, piece) = (within.path().join("m.list"), within.path().join("m/m_0.piece"));
        let job = |name: &str| {
            for _ in 0..300 {
                folder_of_job(within.path(), name).keep(&list, true).unwrap();
            }
        };
        thread::scope(|scope| {
            ["a", "b", "c"]
                .map(|name| scope.spawn(move || job(name)))
                .map(|job| job.join().unwrap())
        });
        assert!(["a", "b", "c"].contains(&&*fs::read_to_string(piece).unwrap()));
        assert_eq!(fs::read_dir(&within).unwrap().count(), 1, "other files remain");
    }

    #[test]
    fn keep_fails_and_preserves_a_list_or_piece_created_meanwhile() {
        for taken in ["m/m_0.piece", "m.list"] {
            let within = tempfile::tempdir().unwrap();
            let folder = folder_of_job(within.path(), "a");
            let existing = within.path().join(taken);
            fs::create_dir_all(existing.parent().unwrap()).unwrap();
            fs::write(&existing, "existing").unwrap();
            let refused = folder.keep(&within.path().join("m.list"), false).unwrap_err();
            assert_eq!(refused.kind(), ErrorKind::AlreadyExists);
            assert_eq!(fs::read_to_string(&existing).unwrap(), "existing");
            assert_eq!(fs::read_dir(&within).unwrap().count(), 1, "other files remain");
        }
    }

    #[test]
    fn a_second_writer_waits_for_the_folder_lock() {
        let within = tempfile::tempdir().unwrap();
        let list = within.path().join("m.list");
        let first = lock_parent_folder(&list).unwrap();
        let second = thread::spawn(move || lock_parent_folder(&list).is_some());
        thread::sleep(10 * PAUSE);
        assert!(!second.is_finished());
        drop(first);
        assert!(second.join().unwrap());
    }
}

//! Files that are read at given offsets. Only the most recently read files stay open, because a
//! frame may have more pieces than a process may have open files. When a file is reopened, a check
//! ensures that it has not changed.

use std::fs::{File, Metadata};
use std::io;
use std::path::{Path, PathBuf, absolute};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, LazyLock};
use std::time::SystemTime;

use quick_cache::sync::Cache;
use quick_cache::{OptionsBuilder, UnitWeighter};
#[cfg(target_os = "linux")]
use std::num::NonZeroU64;

/// Maximum number of files that stay open. It exceeds the number of threads that read at once, and
/// is far below the limit of any system.
pub const MOST_OPEN: usize = 96;

/// The open files, by their numbers.
static OPEN: LazyLock<Cache<u64, Arc<File>>> = LazyLock::new(|| {
    let options = OptionsBuilder::new()
        .estimated_items_capacity(MOST_OPEN)
        .weight_capacity(MOST_OPEN as u64)
        // Files are read one after the other, so recent reads matter more than frequent ones.
        .hot_allocation(0.5)
        // With one shard, the capacity is exact.
        .shards(1)
        .build()
        .expect("both required capacities are set");
    Cache::with_options(options, UnitWeighter, Default::default(), Default::default())
});
static NEXT: AtomicU64 = AtomicU64::new(0);

/// A file's identity, size and modification time, which show whether the file was changed or
/// replaced.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FileStamp {
    /// The file's size, in bytes.
    pub bytes: u64,
    modified: Option<SystemTime>,
    /// Device and inode.
    #[cfg(unix)]
    node: [u64; 2],
}

impl FileStamp {
    /// Makes the stamp of a file from its metadata.
    pub fn of(metadata: &Metadata) -> Self {
        #[cfg(unix)]
        use std::os::unix::fs::MetadataExt;
        Self {
            bytes: metadata.len(),
            modified: metadata.modified().ok(),
            #[cfg(unix)]
            node: [metadata.dev(), metadata.ino()],
        }
    }
}

/// An error while reading a file that must not change.
#[derive(Debug)]
pub enum ReopenedError {
    /// The file was changed or replaced.
    Changed,
    /// The system's error.
    Io(io::Error),
}

impl From<ReopenedError> for io::Error {
    fn from(error: ReopenedError) -> Self {
        match error {
            ReopenedError::Changed => Self::other("the file changed while it was being read"),
            ReopenedError::Io(fault) => fault,
        }
    }
}

impl From<io::Error> for ReopenedError {
    fn from(fault: io::Error) -> Self {
        Self::Io(fault)
    }
}

/// A file that is reopened for reading if it is not open.
#[derive(Debug)]
pub struct ReopenedFile {
    number: u64,
    path: PathBuf,
    stamp: FileStamp,
}

impl ReopenedFile {
    /// Takes `file`, which must be the open file at `path`.
    ///
    /// # Errors
    /// I/O errors of the operating system.
    pub fn new(path: &Path, file: File) -> io::Result<Self> {
        let stamp = FileStamp::of(&file.metadata()?);
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        OPEN.insert(number, Arc::new(file));
        Ok(Self { number, path: absolute(path)?, stamp })
    }

    /// The file's number, which no other file in this process has.
    pub fn number(&self) -> u64 {
        self.number
    }

    /// The stamp of the file when it was first opened.
    pub fn stamp(&self) -> FileStamp {
        self.stamp
    }

    /// Returns the open file, and reopens it if necessary.
    ///
    /// # Errors
    /// [`ReopenedError::Changed`] if the file must be reopened and has changed, and errors of the
    /// system.
    pub fn file(&self) -> Result<Arc<File>, ReopenedError> {
        OPEN.get_or_insert_with(&self.number, || {
            let file = File::open(&self.path)?;
            if FileStamp::of(&file.metadata()?) == self.stamp {
                Ok(Arc::new(file))
            } else {
                Err(ReopenedError::Changed)
            }
        })
    }

    /// Fills `bytes` with the data at offset `at`.
    ///
    /// # Errors
    /// The errors of [`file`](Self::file), and [`io::ErrorKind::UnexpectedEof`] if the range goes
    /// past the file's end.
    pub fn read_exact_at(&self, at: u64, bytes: &mut [u8]) -> Result<(), ReopenedError> {
        Ok(read_exact_at(&*self.file()?, at, bytes)?)
    }

    /// Checks that the file is unchanged. While the file is open, the check passes even if another
    /// file has taken its name.
    pub fn check(&self) -> Result<(), ReopenedError> {
        let metadata = match OPEN.get(&self.number) {
            Some(file) => file.metadata()?,
            None => self.path.metadata()?,
        };
        if FileStamp::of(&metadata) == self.stamp { Ok(()) } else { Err(ReopenedError::Changed) }
    }
}

impl Drop for ReopenedFile {
    fn drop(&mut self) {
        OPEN.remove(&self.number);
    }
}

/// Fills `bytes` with the data at offset `at`.
///
/// # Errors
/// Errors of the system, and [`io::ErrorKind::UnexpectedEof`] if the range goes past the file's
/// end.
pub fn read_exact_at(file: &File, at: u64, bytes: &mut [u8]) -> io::Result<()> {
    #[cfg(unix)]
    return std::os::unix::fs::FileExt::read_exact_at(file, bytes, at);
    #[cfg(windows)]
    return windows::read_exact_at(file, bytes, at);
}

/// Writes all of `bytes` at offset `at`.
///
/// # Errors
/// Errors of the system, such as a full disk.
pub fn write_all_at(file: &File, at: u64, bytes: &[u8]) -> io::Result<()> {
    #[cfg(unix)]
    return std::os::unix::fs::FileExt::write_all_at(file, bytes, at);
    #[cfg(windows)]
    return windows::write_all_at(file, bytes, at);
}

/// Asks the system to read `bytes` bytes of a file, from offset `at`, in advance.
pub fn will_read(file: &File, at: u64, bytes: u64) {
    // Errors are ignored: if the system does not read the data in advance, it reads the data later.
    #[cfg(target_os = "linux")]
    let _ = rustix::fs::fadvise(file, at, NonZeroU64::new(bytes), rustix::fs::Advice::WillNeed);
    #[cfg(not(target_os = "linux"))]
    let _ = (file, at, bytes);
}

/// Reads and writes whole ranges with system calls, each of which may handle only a part of the
/// range.
#[cfg(windows)]
mod windows {
    use std::fs::File;
    use std::io::{self, ErrorKind};
    use std::os::windows::fs::FileExt;

    pub fn read_exact_at(file: &File, mut bytes: &mut [u8], mut at: u64) -> io::Result<()> {
        while !bytes.is_empty() {
            match file.seek_read(bytes, at) {
                Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
                Ok(count) => {
                    let all = bytes;
                    (bytes, at) = (&mut all[count..], at + count as u64);
                }
                Err(fault) if fault.kind() == ErrorKind::Interrupted => {}
                Err(fault) => return Err(fault),
            }
        }
        Ok(())
    }

    pub fn write_all_at(file: &File, mut bytes: &[u8], mut at: u64) -> io::Result<()> {
        while !bytes.is_empty() {
            match file.seek_write(bytes, at) {
                Ok(0) => return Err(ErrorKind::WriteZero.into()),
                Ok(count) => (bytes, at) = (&bytes[count..], at + count as u64),
                Err(fault) if fault.kind() == ErrorKind::Interrupted => {}
                Err(fault) => return Err(fault),
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn opened(path: &Path) -> ReopenedFile {
        ReopenedFile::new(path, File::open(path).unwrap()).unwrap()
    }

    #[test]
    fn many_files_are_read_while_only_a_few_stay_open() {
        let folder = tempfile::tempdir().unwrap();
        let path = |number: usize| folder.path().join(number.to_string());
        let files = 4 * MOST_OPEN;
        (0..files).for_each(|number| fs::write(path(number), format!("{number:04}")).unwrap());
        let taken: Vec<_> = (0..files).map(|number| opened(&path(number))).collect();
        let read = |number: usize| {
            let mut bytes = [0; 4];
            taken[number].read_exact_at(0, &mut bytes).map(|()| bytes)
        };
        for number in (0..files).chain((0..files).rev()) {
            assert_eq!(read(number).unwrap(), format!("{number:04}").as_bytes());
            taken[number].check().unwrap();
        }
        // For files that are no longer open, a later read or check detects changes.
        assert!(OPEN.len() <= MOST_OPEN);
        let closed = |number: &usize| OPEN.get(&taken[*number].number).is_none();
        let [gone, longer, other, ..] = (0..files).filter(closed).collect::<Vec<_>>()[..] else {
            panic!()
        };
        fs::remove_file(path(gone)).unwrap();
        assert!(
            matches!(taken[gone].check(), Err(ReopenedError::Io(_)))
                && matches!(read(gone), Err(ReopenedError::Io(_)))
        );
        fs::write(path(longer), "12345").unwrap();
        assert!(matches!(taken[longer].check(), Err(ReopenedError::Changed)));
        assert!(matches!(read(longer), Err(ReopenedError::Changed)));
        let modified = path(other).metadata().unwrap().modified().unwrap();
        let later = folder.path().join("later");
        fs::write(&later, "abcd").unwrap();
        File::options().write(true).open(&later).unwrap().set_modified(modified).unwrap();
        fs::rename(&later, path(other)).unwrap();
        if cfg!(unix) {
            assert!(matches!(read(other), Err(ReopenedError::Changed)));
        }
    }
}

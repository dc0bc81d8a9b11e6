//! Scratch files for data that exceeds the memory limit. They disappear when the process ends, even
//! if it crashes.

mod lists;

pub use lists::Lists;

use std::fs::File;
use std::io;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::system::reopened::{read_exact_at, write_all_at};

/// An unnamed file that several threads read and write at given offsets. It is never mapped into
/// memory, so a full disk gives an ordinary error.
#[derive(Debug)]
pub struct Scratch {
    file: File,
    end: AtomicU64,
}

impl Scratch {
    /// Creates a file without a name in `folder`. It needs no clean-up, even after a crash.
    ///
    /// # Errors
    /// If the system cannot create a file there.
    pub fn in_folder(folder: &Path) -> io::Result<Self> {
        Ok(Self { file: tempfile::tempfile_in(folder)?, end: AtomicU64::new(0) })
    }

    /// Reserves `bytes` bytes, and returns their offset in the file.
    pub fn reserve(&self, bytes: u64) -> u64 {
        self.end.fetch_add(bytes, Ordering::Relaxed)
    }

    /// Number of reserved bytes.
    pub fn len(&self) -> u64 {
        self.end.load(Ordering::Relaxed)
    }

    /// Whether nothing is reserved.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Writes all of `bytes` at offset `at`.
    ///
    /// # Errors
    /// Errors of the system, such as a full disk.
    pub fn write_at(&self, at: u64, bytes: &[u8]) -> io::Result<()> {
        write_all_at(&self.file, at, bytes)
    }

    /// Fills `bytes` with the data at offset `at`.
    ///
    /// # Errors
    /// Errors of the system, and [`io::ErrorKind::UnexpectedEof`] if the range goes past the
    /// written data.
    pub fn read_at(&self, at: u64, bytes: &mut [u8]) -> io::Result<()> {
        read_exact_at(&self.file, at, bytes)
    }

    /// Writes `bytes` at the end, and returns their offset in the file.
    pub fn append(&self, bytes: &[u8]) -> io::Result<u64> {
        let at = self.reserve(bytes.len() as u64);
        self.write_at(at, bytes)?;
        Ok(at)
    }
}

/// Returns the disk space, in bytes, that is available to files in `folder`.
///
/// # Errors
/// Errors of the system, such as a missing folder.
pub fn free_bytes(folder: &Path) -> io::Result<u64> {
    fs4::available_space(folder)
}

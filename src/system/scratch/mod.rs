//! Scratch files: room for what exceeds the memory budget, gone with the process however it ends.

mod lists;

pub use lists::Lists;

use std::fs::File;
use std::io;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::system::reopened::{read_exact_at, write_all_at};

/// An unnamed file. It is written and read by position, by several threads at once; it is never
/// mapped, so a full disk is an error and nothing else.
#[derive(Debug)]
pub struct Scratch {
    file: File,
    end: AtomicU64,
}

impl Scratch {
    /// A new one in `folder`, without a name: nothing is left to be removed, not even after a
    /// crash.
    ///
    /// # Errors
    /// The system's refusal to create a file there.
    pub fn in_folder(folder: &Path) -> io::Result<Self> {
        Ok(Self { file: tempfile::tempfile_in(folder)?, end: AtomicU64::new(0) })
    }

    /// Sets `bytes` aside and returns where they begin.
    pub fn reserve(&self, bytes: u64) -> u64 {
        self.end.fetch_add(bytes, Ordering::Relaxed)
    }

    /// Bytes set aside so far.
    pub fn len(&self) -> u64 {
        self.end.load(Ordering::Relaxed)
    }

    /// Whether nothing was set aside.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Writes all of `bytes` from position `at` on.
    ///
    /// # Errors
    /// The system's, such as a full disk.
    pub fn write_at(&self, at: u64, bytes: &[u8]) -> io::Result<()> {
        write_all_at(&self.file, at, bytes)
    }

    /// Fills `bytes` from position `at` on.
    ///
    /// # Errors
    /// The system's, and [`io::ErrorKind::UnexpectedEof`] past what was written.
    pub fn read_at(&self, at: u64, bytes: &mut [u8]) -> io::Result<()> {
        read_exact_at(&self.file, at, bytes)
    }

    /// Writes `bytes` at the end and returns where they begin.
    pub fn append(&self, bytes: &[u8]) -> io::Result<u64> {
        let at = self.reserve(bytes.len() as u64);
        self.write_at(at, bytes)?;
        Ok(at)
    }
}

/// Bytes that can still be written in `folder`.
///
/// # Errors
/// The system's, such as that there is no such folder.
pub fn free_bytes(folder: &Path) -> io::Result<u64> {
    fs4::available_space(folder)
}

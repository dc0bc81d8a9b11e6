//! Access to the bytes of columns in windows: in memory, in a mapped scratch file, or in the input
//! itself.
//!
//! The input is read by position into buffers, one per thread, and never mapped: if another program
//! shortens or rewrites a file meanwhile, this is an error of that frame, while a map would end the
//! process with a signal. All files of an input share their buffers.

use std::fmt::Debug;
use std::ops::Range;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use crate::particles::RereadError;
use crate::system::reopened::{ReopenedError, ReopenedFile};
use crate::system::reopened::{read_exact_at, will_read};

use super::bytes::{Bytes, PrivateBytes};

/// Bytes per read if a thread continues where it was.
const LARGE: usize = 1 << 18;
/// Bytes per read at other positions.
const SMALL: usize = 1 << 14;
/// Minimum number of bytes that the system is asked to read ahead of a thread. The system checks
/// its cache for each request, so requests do not overlap.
const AHEAD: usize = 1 << 22;

/// Bytes with access in windows.
pub trait Windows: Sync + Debug {
    /// Number of bytes.
    fn count(&self) -> usize;

    /// Passes on the bytes of a range. If they cannot be read, passes on zeros, and
    /// [`check`](Self::check) fails from then on.
    ///
    /// # Panics
    /// If the range exceeds the bytes.
    fn with<R>(&self, range: Range<usize>, read: impl FnOnce(&[u8]) -> R) -> R;

    /// Bytes of memory that cannot be released.
    fn resident_bytes(&self) -> u64 {
        0
    }

    /// Releases the memory of a range; reading it again restores it.
    fn release(&self, range: Range<usize>) {
        let _ = range;
    }

    /// Checks that the bytes have not changed since they were opened.
    fn check(&self) -> Result<(), RereadError> {
        Ok(())
    }
}

impl Windows for &[u8] {
    fn count(&self) -> usize {
        self.len()
    }

    fn with<R>(&self, range: Range<usize>, read: impl FnOnce(&[u8]) -> R) -> R {
        read(&self[range])
    }
}

/// Bytes of an input, in memory or in its file.
#[derive(Debug)]
pub enum InputBytes {
    /// In memory or in a scratch file.
    Kept(PrivateBytes),
    /// In the input's file.
    File(FileWindows),
}

impl InputBytes {
    /// Bytes of scratch files.
    #[must_use]
    pub fn scratch_bytes(&self) -> u64 {
        match self {
            Self::Kept(bytes) => bytes.scratch_bytes(),
            Self::File(_) => 0,
        }
    }

    /// Bytes that are read from the input's file in windows.
    #[must_use]
    pub fn file_bytes(&self) -> u64 {
        match self {
            Self::Kept(_) => 0,
            Self::File(file) => file.file.stamp().bytes,
        }
    }

    /// Reads through the windows of a shared shelf.
    pub fn share(&mut self, shelf: &Arc<WindowPool>) {
        if let Self::File(file) = self {
            file.shelf = Arc::clone(shelf);
        }
    }
}

impl From<Bytes> for InputBytes {
    fn from(bytes: Bytes) -> Self {
        match bytes {
            Bytes::File(file) => Self::File(FileWindows::new(file)),
            Bytes::Kept(kept) => Self::Kept(kept),
        }
    }
}

impl From<PrivateBytes> for InputBytes {
    fn from(kept: PrivateBytes) -> Self {
        Self::Kept(kept)
    }
}

impl Windows for InputBytes {
    fn count(&self) -> usize {
        match self {
            Self::Kept(bytes) => bytes.len(),
            Self::File(file) => file.count(),
        }
    }

    fn with<R>(&self, range: Range<usize>, read: impl FnOnce(&[u8]) -> R) -> R {
        match self {
            Self::Kept(bytes) => read(&bytes[range]),
            Self::File(file) => file.with(range, read),
        }
    }

    fn resident_bytes(&self) -> u64 {
        match self {
            Self::Kept(bytes) => bytes.resident_bytes(),
            Self::File(file) => file.resident_bytes(),
        }
    }

    fn release(&self, range: Range<usize>) {
        match self {
            Self::Kept(bytes) => bytes.release(range),
            Self::File(_) => {}
        }
    }

    fn check(&self) -> Result<(), RereadError> {
        match self {
            Self::Kept(_) => Ok(()),
            Self::File(file) => file.check(),
        }
    }
}

/// A file that is read by position.
#[derive(Debug)]
pub struct FileWindows {
    file: ReopenedFile,
    shelf: Arc<WindowPool>,
    fault: OnceLock<RereadError>,
}

/// Unused windows of several files; the most recently used one is last.
#[derive(Debug, Default)]
pub struct WindowPool {
    idle: Mutex<Vec<FileWindow>>,
}

/// A range of bytes of a file.
#[derive(Debug, Default)]
struct FileWindow {
    /// The file's number.
    file: u64,
    at: usize,
    bytes: Vec<u8>,
    /// The end of the range that the system was asked to read.
    advised: usize,
}

impl FileWindow {
    fn end(&self) -> usize {
        self.at + self.bytes.len()
    }
}

impl WindowPool {
    /// Windows per thread, which reads a few columns in turn.
    const A_THREAD: usize = 4;

    fn most() -> usize {
        Self::A_THREAD * rayon::current_num_threads()
    }

    /// Bytes of all windows of files with this total size.
    pub fn resident_bytes(file_bytes: u64) -> u64 {
        file_bytes.min((Self::most() * LARGE) as u64)
    }

    /// A window of a file that contains byte `at`, or ends there, or the least recently used one.
    fn take(&self, file: u64, at: usize) -> FileWindow {
        let mut idle = self.idle.lock().unwrap_or_else(PoisonError::into_inner);
        let holds =
            |window: &FileWindow| window.file == file && (window.at..window.end()).contains(&at);
        let ends = |window: &FileWindow| window.file == file && window.end() == at;
        let found = idle.iter().position(holds).or_else(|| idle.iter().position(ends));
        let window = match found {
            Some(found) => return idle.remove(found),
            None if idle.len() < Self::most() => FileWindow::default(),
            None => idle.remove(0),
        };
        // The window has other bytes.
        let mut bytes = window.bytes;
        bytes.clear();
        FileWindow { file, at: 0, bytes, advised: 0 }
    }

    fn put(&self, window: FileWindow) {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner).push(window);
    }
}

impl FileWindows {
    fn new(file: ReopenedFile) -> Self {
        Self { file, shelf: Arc::default(), fault: OnceLock::new() }
    }

    fn fill(&self, window: &mut FileWindow, range: &Range<usize>) {
        let goes_on = window.at < range.start && range.start <= window.end();
        let piece = if goes_on { LARGE } else { SMALL };
        let len = range.len().max(piece).min(self.count() - range.start);
        window.at = range.start;
        window.bytes.resize(len, 0);
        if let Err(lost) = self.read(window, goes_on) {
            window.bytes.fill(0);
            let _ = self.fault.set(unread(lost));
        }
    }

    fn read(&self, window: &mut FileWindow, goes_on: bool) -> Result<(), ReopenedError> {
        let file = self.file.file()?;
        let end = window.end();
        if goes_on && window.advised < end + AHEAD {
            let from = end.max(window.advised);
            window.advised = end + 2 * AHEAD;
            will_read(&file, from as u64, (window.advised - from) as u64);
        }
        Ok(read_exact_at(&file, window.at as u64, &mut window.bytes)?)
    }
}

fn unread(lost: ReopenedError) -> RereadError {
    match lost {
        ReopenedError::Changed => RereadError::Changed,
        ReopenedError::Io(fault) => RereadError::Io(fault.kind()),
    }
}

impl Windows for FileWindows {
    fn count(&self) -> usize {
        self.file.stamp().bytes as usize
    }

    fn with<R>(&self, range: Range<usize>, read: impl FnOnce(&[u8]) -> R) -> R {
        assert!(range.end <= self.count(), "bytes to {} of {}", range.end, self.count());
        let mut window = self.shelf.take(self.file.number(), range.start);
        if range.start < window.at || window.end() < range.end {
            self.fill(&mut window, &range);
        }
        let result = read(&window.bytes[range.start - window.at..][..range.len()]);
        self.shelf.put(window);
        result
    }

    fn resident_bytes(&self) -> u64 {
        WindowPool::resident_bytes(self.file.stamp().bytes)
    }

    fn check(&self) -> Result<(), RereadError> {
        match (self.file.check(), self.fault.get()) {
            (Err(ReopenedError::Changed), _) => Err(RereadError::Changed),
            (_, Some(&fault)) => Err(fault),
            (Err(lost), None) => Err(unread(lost)),
            (Ok(()), None) => Ok(()),
        }
    }
}

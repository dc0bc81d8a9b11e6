//! Reads the bytes of columns piece by piece. A piece is called a window. The bytes are in memory,
//! in a mapped scratch file, or in the input file.
//!
//! An input file is never mapped, because a signal would end the process if another program
//! shortened the mapped file. Instead, byte ranges of the file are read into buffers, a few per
//! thread. If the file was shortened, the read fails, and only the current frame has an error. All
//! files of an input share their buffers.

use std::fmt::Debug;
use std::ops::Range;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use crate::particles::RereadError;
use crate::system::reopened::{ReopenedError, ReopenedFile};
use crate::system::reopened::{read_exact_at, will_read};

use super::bytes::{Bytes, PrivateBytes};

/// Number of bytes per read if a thread continues within or at the end of its last read.
const LARGE: usize = 1 << 18;
/// Number of bytes per read at other positions.
const SMALL: usize = 1 << 14;
/// Minimum number of bytes to request ahead of a thread's position. The system searches its cache
/// for all bytes of a request, so a request starts at the end of the previous request and does not
/// repeat its bytes.
const AHEAD: usize = 1 << 22;

/// A source of bytes that is accessed in windows.
pub trait Windows: Sync + Debug {
    /// Number of bytes.
    fn count(&self) -> usize;

    /// Calls `read` with the bytes of a range. If they cannot be read, calls it with zeros, and
    /// [`check`](Self::check) fails from then on.
    ///
    /// # Panics
    /// If the range exceeds the bytes of the source.
    fn with<R>(&self, range: Range<usize>, read: impl FnOnce(&[u8]) -> R) -> R;

    /// Memory, in bytes, that cannot be released.
    fn resident_bytes(&self) -> u64 {
        0
    }

    /// Releases the memory of a range, if possible. A later access reads the bytes again.
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

/// Bytes of an input, in memory, in a scratch file, or in the input file.
#[derive(Debug)]
pub enum InputBytes {
    /// Bytes in memory or in a scratch file.
    Kept(PrivateBytes),
    /// Bytes in the input file.
    File(FileWindows),
}

impl InputBytes {
    /// Number of bytes in scratch files.
    #[must_use]
    pub fn scratch_bytes(&self) -> u64 {
        match self {
            Self::Kept(bytes) => bytes.scratch_bytes(),
            Self::File(_) => 0,
        }
    }

    /// Number of bytes in the input file, which is read in windows.
    #[must_use]
    pub fn file_bytes(&self) -> u64 {
        match self {
            Self::Kept(_) => 0,
            Self::File(file) => file.file.stamp().bytes,
        }
    }

    /// Makes this input use the windows of `pool`, which several files share.
    pub fn share(&mut self, pool: &Arc<WindowPool>) {
        if let Self::File(file) = self {
            file.pool = Arc::clone(pool);
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

/// An input file that is read in windows.
#[derive(Debug)]
pub struct FileWindows {
    file: ReopenedFile,
    pool: Arc<WindowPool>,
    /// The first error of a read.
    fault: OnceLock<RereadError>,
}

/// Unused windows of several files. The most recently used window is last.
#[derive(Debug, Default)]
pub struct WindowPool {
    idle: Mutex<Vec<FileWindow>>,
}

/// A buffer with a range of bytes of a file.
#[derive(Debug, Default)]
struct FileWindow {
    /// Number of the file, see [`ReopenedFile::number`].
    file: u64,
    at: usize,
    bytes: Vec<u8>,
    /// End of the bytes that the system was asked to read ahead.
    advised: usize,
}

impl FileWindow {
    fn end(&self) -> usize {
        self.at + self.bytes.len()
    }
}

impl WindowPool {
    /// Number of windows per thread. A thread alternates between a few columns.
    const PER_THREAD: usize = 4;

    fn max_windows() -> usize {
        Self::PER_THREAD * rayon::current_num_threads()
    }

    /// Maximum memory, in bytes, of the windows for files with a total size of `file_bytes`.
    pub fn resident_bytes(file_bytes: u64) -> u64 {
        file_bytes.min((Self::max_windows() * LARGE) as u64)
    }

    /// Takes a window that contains byte `at` of file number `file`, or else one that ends at this
    /// byte. If there is none, returns an empty window with a new buffer, or with the buffer of the
    /// least recently used window.
    fn take(&self, file: u64, at: usize) -> FileWindow {
        let mut idle = self.idle.lock().unwrap_or_else(PoisonError::into_inner);
        let holds =
            |window: &FileWindow| window.file == file && (window.at..window.end()).contains(&at);
        let ends = |window: &FileWindow| window.file == file && window.end() == at;
        let found = idle.iter().position(holds).or_else(|| idle.iter().position(ends));
        let window = match found {
            Some(found) => return idle.remove(found),
            None if idle.len() < Self::max_windows() => FileWindow::default(),
            None => idle.remove(0),
        };
        // The window holds bytes of another range or file, which are discarded.
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
        Self { file, pool: Arc::default(), fault: OnceLock::new() }
    }

    fn fill(&self, window: &mut FileWindow, range: &Range<usize>) {
        let is_sequential = window.at < range.start && range.start <= window.end();
        let piece = if is_sequential { LARGE } else { SMALL };
        let len = range.len().max(piece).min(self.count() - range.start);
        window.at = range.start;
        window.bytes.resize(len, 0);
        if let Err(error) = self.read(window, is_sequential) {
            window.bytes.fill(0);
            let _ = self.fault.set(reread_error(error));
        }
    }

    fn read(&self, window: &mut FileWindow, is_sequential: bool) -> Result<(), ReopenedError> {
        let file = self.file.file()?;
        let end = window.end();
        if is_sequential && window.advised < end + AHEAD {
            let from = end.max(window.advised);
            window.advised = end + 2 * AHEAD;
            will_read(&file, from as u64, (window.advised - from) as u64);
        }
        Ok(read_exact_at(&file, window.at as u64, &mut window.bytes)?)
    }
}

fn reread_error(error: ReopenedError) -> RereadError {
    match error {
        ReopenedError::Changed => RereadError::Changed,
        ReopenedError::Io(fault) => RereadError::Io(fault.kind()),
    }
}

impl Windows for FileWindows {
    fn count(&self) -> usize {
        self.file.stamp().bytes as usize
    }

    fn with<R>(&self, range: Range<usize>, read: impl FnOnce(&[u8]) -> R) -> R {
        assert!(range.end <= self.count(), "range to byte {} of {}", range.end, self.count());
        let mut window = self.pool.take(self.file.number(), range.start);
        if range.start < window.at || window.end() < range.end {
            self.fill(&mut window, &range);
        }
        let result = read(&window.bytes[range.start - window.at..][..range.len()]);
        self.pool.put(window);
        result
    }

    fn resident_bytes(&self) -> u64 {
        WindowPool::resident_bytes(self.file.stamp().bytes)
    }

    fn check(&self) -> Result<(), RereadError> {
        match (self.file.check(), self.fault.get()) {
            (Err(ReopenedError::Changed), _) => Err(RereadError::Changed),
            (_, Some(&fault)) => Err(fault),
            (Err(error), None) => Err(reread_error(error)),
            (Ok(()), None) => Ok(()),
        }
    }
}

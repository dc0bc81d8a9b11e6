//! The bytes that columns lie in, window by window: in memory, in a mapped scratch file, or in the input itself.
//!
//! The input is read by position into buffers, each thread in its own, and never mapped while its numbers are read: a file that
//! another program shortens or rewrites meanwhile is an error of that frame, where a map would end the process by a signal.

use std::fmt::Debug;
use std::fs::File;
use std::io;
use std::ops::Range;
use std::sync::{Mutex, OnceLock, PoisonError};

use crate::particles::Unread;
use crate::system::positioned::{read_exact_at, will_read};

use super::bytes::{ByteStore, Bytes, FileStamp};

/// Bytes that are read at once where a thread goes on where it was.
const LARGE: usize = 1 << 18;
/// Bytes that are read at once anywhere else.
const SMALL: usize = 1 << 14;
/// Bytes that the system is told to read ahead of a thread.
const AHEAD: u64 = 1 << 22;

/// Bytes that are handed out by windows.
pub trait Windows: Sync + Debug {
    /// How many there are.
    fn count(&self) -> usize;

    /// Passes the bytes of a range on. Where they cannot be read, it passes zeros, and [`check`](Self::check) fails from then on.
    ///
    /// # Panics
    /// If the range exceeds them.
    fn with<R>(&self, range: Range<usize>, read: impl FnOnce(&[u8]) -> R) -> R;

    /// Bytes of memory that cannot be given back.
    fn resident_bytes(&self) -> u64 {
        0
    }

    /// Gives the memory of a range back; reading it again brings it back.
    fn release(&self, range: Range<usize>) {
        let _ = range;
    }

    /// Makes sure that all that was passed on is what the bytes were from the beginning.
    ///
    /// # Errors
    /// [`Unread`].
    fn check(&self) -> Result<(), Unread> {
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

/// Bytes of an input: kept, or read from its file.
#[derive(Debug)]
pub enum Source {
    /// Kept in memory or in a scratch file.
    Kept(Bytes),
    /// In the input's file.
    File(FileWindows),
}

impl Source {
    /// Bytes of scratch files.
    #[must_use]
    pub fn scratch_bytes(&self) -> u64 {
        match self {
            Self::Kept(bytes) => bytes.scratch_bytes(),
            Self::File(_) => 0,
        }
    }
}

impl From<Bytes> for Source {
    /// An input that was mapped is read by windows from now on.
    fn from(bytes: Bytes) -> Self {
        match bytes {
            Bytes::Mapped(mapped) => Self::File(FileWindows::new(mapped.file, mapped.stamp)),
            kept => Self::Kept(kept),
        }
    }
}

impl Windows for Source {
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

    fn check(&self) -> Result<(), Unread> {
        match self {
            Self::Kept(_) => Ok(()),
            Self::File(file) => file.check(),
        }
    }
}

/// A file that is read by position.
#[derive(Debug)]
pub struct FileWindows {
    file: File,
    /// The file as it was when its header was read.
    stamp: FileStamp,
    /// Windows that no thread reads in at the moment; that which was used last comes last.
    idle: Mutex<Vec<Window>>,
    fault: OnceLock<io::Error>,
}

/// Some bytes of a file.
#[derive(Debug, Default)]
struct Window {
    at: usize,
    bytes: Vec<u8>,
}

impl Window {
    fn end(&self) -> usize {
        self.at + self.bytes.len()
    }
}

impl FileWindows {
    /// Windows for each thread: it reads a few columns in turn.
    const A_THREAD: usize = 4;

    fn new(file: File, stamp: FileStamp) -> Self {
        Self { file, stamp, idle: Mutex::default(), fault: OnceLock::new() }
    }

    /// A window that holds byte `at`, or else that ends there, or else the one that was not used for longest.
    fn take(&self, at: usize) -> Window {
        let mut idle = self.idle.lock().unwrap_or_else(PoisonError::into_inner);
        let holds = |window: &Window| (window.at..window.end()).contains(&at);
        let found = idle.iter().position(holds).or_else(|| idle.iter().position(|window| window.end() == at));
        let most = Self::A_THREAD * rayon::current_num_threads();
        match found {
            Some(found) => idle.remove(found),
            None if idle.len() < most => Window::default(),
            None => idle.remove(0),
        }
    }

    fn fill(&self, window: &mut Window, range: &Range<usize>) {
        let goes_on = window.at < range.start && range.start <= window.end();
        let piece = if goes_on { LARGE } else { SMALL };
        let len = range.len().max(piece).min(self.count() - range.start);
        window.at = range.start;
        window.bytes.resize(len, 0);
        if goes_on {
            will_read(&self.file, window.end() as u64, AHEAD);
        }
        if let Err(fault) = read_exact_at(&self.file, window.at as u64, &mut window.bytes) {
            window.bytes.fill(0);
            let _ = self.fault.set(fault);
        }
    }
}

impl Windows for FileWindows {
    fn count(&self) -> usize {
        self.stamp.bytes as usize
    }

    fn with<R>(&self, range: Range<usize>, read: impl FnOnce(&[u8]) -> R) -> R {
        assert!(range.end <= self.count(), "bytes to {} of {}", range.end, self.count());
        let mut window = self.take(range.start);
        if range.start < window.at || window.end() < range.end {
            self.fill(&mut window, &range);
        }
        let result = read(&window.bytes[range.start - window.at..][..range.len()]);
        self.idle.lock().unwrap_or_else(PoisonError::into_inner).push(window);
        result
    }

    fn resident_bytes(&self) -> u64 {
        let most = Self::A_THREAD * rayon::current_num_threads() * LARGE;
        self.stamp.bytes.min(most as u64)
    }

    fn check(&self) -> Result<(), Unread> {
        let now = self.file.metadata().map(|metadata| FileStamp::of(&metadata));
        match (now, self.fault.get()) {
            (Ok(now), _) if now != self.stamp => Err(Unread::Changed),
            (_, Some(fault)) => Err(Unread::Io(fault.kind())),
            (Err(fault), None) => Err(Unread::Io(fault.kind())),
            (Ok(_), None) => Ok(()),
        }
    }
}

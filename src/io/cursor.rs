//! Reads the header of a binary file. Every read is checked against the available bytes.

use std::borrow::Cow;

use super::bytes::ByteView;
use super::columns::Endian;
use super::{ReadFault, malformed};

/// Minimum number of bytes per read from the file.
const WINDOW: usize = 16 << 10;

/// A position in the bytes of a file. Every read advances it.
#[derive(Debug, Clone)]
pub struct Cursor<'a> {
    bytes: ByteView<'a>,
    at: usize,
    endian: Endian,
    /// The bytes of the last read from the file, which start at `window_at`.
    window: Cow<'a, [u8]>,
    window_at: usize,
}

impl<'a> Cursor<'a> {
    /// Creates a cursor at byte `at` of `bytes`.
    pub fn new(bytes: ByteView<'a>, at: usize, endian: Endian) -> Self {
        let window = match bytes {
            ByteView::File(_) => Cow::Owned(Vec::new()),
            ByteView::Kept(slice) => Cow::Borrowed(slice.bytes()),
        };
        Self { bytes, at, endian, window, window_at: 0 }
    }

    /// The byte offset from the start of the file.
    pub fn at(&self) -> usize {
        self.at
    }

    /// Skips `count` records of `stride` bytes each. Returns the byte offset of the first record.
    ///
    /// # Errors
    /// [`ReadFault::Truncated`] if the file ends before the records do.
    pub fn skip(&mut self, what: &str, count: u64, stride: u64) -> Result<usize, ReadFault> {
        let start = self.at;
        let needed = count.saturating_mul(stride).saturating_add(start as u64);
        if needed > self.bytes.len() as u64 {
            let have = self.bytes.len() as u64;
            return Err(ReadFault::Truncated { what: what.into(), needed, have });
        }
        self.at = needed as usize;
        Ok(start)
    }

    /// Reads the next `count` bytes.
    ///
    /// # Errors
    /// [`ReadFault::Truncated`] if fewer bytes remain, and [`ReadFault::Changed`] or
    /// [`ReadFault::Io`] if the file cannot be read. All methods below return these errors too.
    pub fn take(&mut self, what: &str, count: u64) -> Result<&[u8], ReadFault> {
        let start = self.skip(what, count, 1)?;
        if start < self.window_at || self.window_at + self.window.len() < self.at {
            self.window =
                self.bytes.read(start..self.at.max(start + WINDOW).min(self.bytes.len()))?;
            self.window_at = start;
        }
        Ok(&self.window[start - self.window_at..][..count as usize])
    }

    /// Reads an `N`-byte number, and returns its bytes in little-endian order.
    ///
    /// # Errors
    /// The errors of [`take`](Self::take).
    pub fn array<const N: usize>(&mut self, what: &str) -> Result<[u8; N], ReadFault> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(what, N as u64)?);
        if self.endian == Endian::Big {
            array.reverse();
        }
        Ok(array)
    }

    /// Reads an unsigned 16-bit integer.
    pub fn u16(&mut self, what: &str) -> Result<u16, ReadFault> {
        self.array(what).map(u16::from_le_bytes)
    }

    /// Reads an unsigned 32-bit integer.
    pub fn u32(&mut self, what: &str) -> Result<u32, ReadFault> {
        self.array(what).map(u32::from_le_bytes)
    }

    /// Reads an unsigned 64-bit integer.
    pub fn u64(&mut self, what: &str) -> Result<u64, ReadFault> {
        self.array(what).map(u64::from_le_bytes)
    }

    /// Reads a 64-bit floating-point number.
    pub fn f64(&mut self, what: &str) -> Result<f64, ReadFault> {
        self.array(what).map(f64::from_le_bytes)
    }

    /// Reads a count that the format stores as a signed integer.
    ///
    /// # Errors
    /// [`ReadFault::Malformed`] for a negative count.
    pub fn count(&mut self, what: &str) -> Result<u64, ReadFault> {
        let at = self.at;
        let count = self.u32(what)? as i32;
        u64::try_from(count)
            .map_err(|_| malformed(at, format!("the number of {what} is negative: {count}")))
    }
}

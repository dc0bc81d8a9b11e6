//! Scans text for lines, words and numbers, even in files that also contain binary data.

use std::borrow::Cow;
use std::ops::Range;

use super::bytes::{ByteView, Slice};
use super::number::ParseNumber;
use super::{ReadFault, malformed};

/// Maximum length, in bytes, of a line in a header. This limit detects binary data early.
const LONGEST_LINE: usize = 64 << 10;
/// Number of bytes that are first searched for the end of a line.
const SHORT_LINE: usize = 1 << 8;
/// Number of bytes after which the memory of the scanned bytes is released.
const RELEASE_STEP: usize = 1 << 20;

/// The length of the UTF-8 byte order mark at the start of `bytes`. 0 if there is no mark.
pub fn mark_length(bytes: &[u8]) -> usize {
    const MARK: &[u8] = b"\xef\xbb\xbf";
    if bytes.starts_with(MARK) { MARK.len() } else { 0 }
}

/// A position in a text, which moves only forward.
#[derive(Debug, Clone)]
pub struct Scanner<'a> {
    bytes: &'a [u8],
    at: usize,
    /// The bytes, if their memory can be released.
    store: Option<Slice<'a>>,
    /// Start of the bytes whose memory has not been released.
    unreleased_from: usize,
}

impl<'a> Scanner<'a> {
    /// Creates a scanner at byte `at` of `bytes`, or at their end if `at` is beyond it.
    pub fn new(bytes: &'a [u8], at: usize) -> Self {
        let at = at.min(bytes.len());
        Self { bytes, at, store: None, unreleased_from: at }
    }

    /// Creates a scanner at byte `at` of `store` that releases the memory of bytes before its
    /// position.
    pub fn releasing(store: Slice<'a>, at: usize) -> Self {
        Self { store: Some(store), ..Self::new(store.bytes(), at) }
    }

    /// Creates a scanner of a range of `store` that releases the memory of bytes before its
    /// position.
    pub fn releasing_to(store: Slice<'a>, range: Range<usize>) -> Self {
        Self { store: Some(store), ..Self::new(&store.bytes()[..range.end], range.start) }
    }

    fn advance(&mut self, count: usize) {
        self.at += count;
        if let Some(store) = self.store
            && self.at - self.unreleased_from >= RELEASE_STEP
        {
            store.release(self.unreleased_from..self.at);
            self.unreleased_from = self.at;
        }
    }

    /// The position, as a byte offset from the start of the file.
    pub fn at(&self) -> usize {
        self.at
    }

    /// The bytes from the position to the end.
    pub fn rest(&self) -> &'a [u8] {
        &self.bytes[self.at..]
    }

    /// Skips `count` bytes. In an error, `what` describes them.
    ///
    /// # Errors
    /// [`ReadFault::Truncated`] if fewer bytes remain.
    pub fn skip(&mut self, count: usize, what: &str) -> Result<(), ReadFault> {
        if count > self.rest().len() {
            return Err(ReadFault::Truncated {
                what: what.to_owned(),
                needed: (self.at as u64).saturating_add(count as u64),
                have: self.bytes.len() as u64,
            });
        }
        self.at += count;
        Ok(())
    }

    /// Skips the rest of this line and its line end. Returns false at the end of the file.
    pub fn skip_line(&mut self) -> bool {
        let rest = self.rest();
        self.advance(rest.iter().position(|&b| b == b'\n').map_or(rest.len(), |end| end + 1));
        !rest.is_empty()
    }

    /// Skips spaces, tabs and line ends.
    pub fn skip_whitespace(&mut self) {
        self.at += self.rest().iter().take_while(|b| b.is_ascii_whitespace()).count();
    }

    /// Skips spaces and tabs.
    pub fn skip_blanks(&mut self) {
        self.at += self.rest().iter().take_while(|b| matches!(b, b' ' | b'\t')).count();
    }

    /// Reads a word. The result is empty if no word starts at this position.
    pub fn word(&mut self) -> &'a [u8] {
        let rest = self.rest();
        let length = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
        self.advance(length);
        &rest[..length]
    }

    /// Reads a number.
    ///
    /// # Errors
    /// [`ReadFault::Line`] if no number starts at this position.
    pub fn number<T: ParseNumber>(&mut self) -> Result<T, ReadFault> {
        let start = self.at;
        let word = self.word();
        T::of(word).ok_or_else(|| {
            let found = match (word.is_empty(), start == self.bytes.len()) {
                (true, true) => "the end of the file".to_owned(),
                (true, false) => "the end of the line".to_owned(),
                _ => format!("{:?}", String::from_utf8_lossy(&word[..word.len().min(40)])),
            };
            self.fault(start, format!("expected a number, found {found}"))
        })
    }

    /// Returns an error if `count` numbers cannot fit in the remaining bytes. Every number except
    /// the last takes at least two bytes, including the space after it.
    pub fn expect_numbers(&self, count: usize, what: &str) -> Result<(), ReadFault> {
        let needed = count.saturating_mul(2).saturating_sub(1);
        self.clone().skip(needed, what)
    }

    /// An error in the line that contains byte `at`.
    pub fn fault(&self, at: usize, what: String) -> ReadFault {
        ReadFault::Line { line: 1 + count_line_ends(&self.bytes[..at]), what }
    }
}

/// The number of line ends in `text`.
fn count_line_ends(text: &[u8]) -> u64 {
    text.iter().filter(|&&b| b == b'\n').count() as u64
}

/// A position in a file that may contain lines and blocks of binary data. The position moves only
/// forward.
#[derive(Debug, Clone)]
pub struct Lines<'a> {
    bytes: ByteView<'a>,
    at: usize,
}

impl<'a> Lines<'a> {
    /// Creates a reader at byte `at` of `bytes`, or at their end if `at` is beyond it.
    pub fn new(bytes: ByteView<'a>, at: usize) -> Self {
        Self { bytes, at: at.min(bytes.len()) }
    }

    /// Creates a reader at the start of `bytes`. A byte order mark is skipped.
    ///
    /// # Errors
    /// The errors of [`ahead`](Self::ahead).
    pub fn of_text(bytes: ByteView<'a>) -> Result<Self, ReadFault> {
        let head = bytes.read(0..bytes.len().min(3))?;
        Ok(Self::new(bytes, mark_length(&head)))
    }

    /// The position, as a byte offset from the start of the file.
    pub fn at(&self) -> usize {
        self.at
    }

    /// The next `count` bytes, or fewer at the end of the file. The position does not change.
    ///
    /// # Errors
    /// [`ReadFault::Changed`] and [`ReadFault::Io`] if the file cannot be read. The methods below
    /// return these errors too.
    pub fn ahead(&self, count: usize) -> Result<Cow<'a, [u8]>, ReadFault> {
        self.bytes.read(self.at..self.bytes.len().min(self.at.saturating_add(count)))
    }

    /// Skips `count` bytes. In an error, `what` describes them.
    ///
    /// # Errors
    /// [`ReadFault::Truncated`] if fewer bytes remain.
    pub fn skip(&mut self, count: usize, what: &str) -> Result<(), ReadFault> {
        let have = self.bytes.len();
        if count > have - self.at {
            return Err(ReadFault::Truncated {
                what: what.to_owned(),
                needed: (self.at as u64).saturating_add(count as u64),
                have: have as u64,
            });
        }
        self.at += count;
        Ok(())
    }

    /// Skips bytes until `stops` returns true for the next byte. Returns false at the end of the
    /// file.
    fn skip_to(&mut self, stops: impl Fn(u8) -> bool) -> Result<bool, ReadFault> {
        let mut count = SHORT_LINE;
        loop {
            let ahead = self.ahead(count)?;
            let found = ahead.iter().position(|&byte| stops(byte));
            self.at += found.unwrap_or(ahead.len());
            if found.is_some() || ahead.is_empty() {
                return Ok(found.is_some());
            }
            count = LONGEST_LINE;
        }
    }

    /// Skips the rest of this line and its line end. Returns false at the end of the file.
    pub fn skip_line(&mut self) -> Result<bool, ReadFault> {
        let start = self.at;
        self.at += usize::from(self.skip_to(|byte| byte == b'\n')?);
        Ok(self.at > start)
    }

    /// Skips spaces, tabs and line ends.
    pub fn skip_whitespace(&mut self) -> Result<(), ReadFault> {
        self.skip_to(|byte| !byte.is_ascii_whitespace()).map(|_| ())
    }

    /// Reads the rest of this line and skips its line end (LF or CR LF). `None` at the end of the
    /// file.
    ///
    /// # Errors
    /// [`ReadFault::Malformed`] for a line that is not text or is too long for a header, and the
    /// errors of [`ahead`](Self::ahead).
    pub fn line(&mut self) -> Result<Option<String>, ReadFault> {
        for limit in [SHORT_LINE, LONGEST_LINE] {
            let ahead = self.ahead(limit)?;
            let length = match ahead.iter().position(|&byte| byte == b'\n') {
                Some(end) => end + 1,
                None if self.at + ahead.len() == self.bytes.len() => ahead.len(),
                None => continue,
            };
            if length == 0 {
                return Ok(None);
            }
            let Ok(text) = std::str::from_utf8(&ahead[..length]) else { break };
            self.at += length;
            return Ok(Some(text.trim_end_matches(['\r', '\n']).to_owned()));
        }
        Err(malformed(self.at, "expected a line of text"))
    }

    /// An error in the line that contains byte `at`. If the file cannot be read up to this byte,
    /// returns the read error instead.
    pub fn fault(&self, at: usize, what: String) -> ReadFault {
        let pieces = (0..at).step_by(LONGEST_LINE).map(|start| start..at.min(start + LONGEST_LINE));
        let counted = pieces
            .map(|piece| Ok(count_line_ends(&self.bytes.read(piece)?)))
            .sum::<Result<u64, ReadFault>>();
        counted.map_or_else(|fault| fault, |ends| ReadFault::Line { line: 1 + ends, what })
    }
}

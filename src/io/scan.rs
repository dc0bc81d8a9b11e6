//! Lines, words and numbers of a file that is text, at least where we look.

use std::ops::Range;

use super::bytes::ByteStore;
use super::{ReadFault, malformed};

/// No line of a header is longer, so that binary data taken for text is found out early.
const LONGEST_LINE: usize = 64 << 10;
/// Bytes that are passed before their memory is given back.
const PASSED: usize = 1 << 20;

/// A place in a file, moving forward.
#[derive(Debug, Clone)]
pub struct Scanner<'a> {
    bytes: &'a [u8],
    at: usize,
    /// The store that gives memory back, and the offset from which on it has not done so.
    store: Option<&'a dyn ByteStore>,
    held: usize,
}

impl<'a> Scanner<'a> {
    /// Starts at byte `at` of `bytes`, or at their end.
    #[must_use]
    pub fn new(bytes: &'a [u8], at: usize) -> Self {
        let at = at.min(bytes.len());
        Self { bytes, at, store: None, held: at }
    }

    /// Starts at byte `at` of `store`, and gives the memory of passed lines and words back.
    #[must_use]
    pub fn releasing(store: &'a dyn ByteStore, at: usize) -> Self {
        Self { store: Some(store), ..Self::new(store, at) }
    }

    /// Reads a range of `store`, and gives the memory of passed lines and words back.
    #[must_use]
    pub fn releasing_to(store: &'a dyn ByteStore, range: Range<usize>) -> Self {
        Self { store: Some(store), ..Self::new(&store[..range.end], range.start) }
    }

    fn pass(&mut self, count: usize) {
        self.at += count;
        if let Some(store) = self.store
            && self.at - self.held >= PASSED
        {
            store.release(self.held..self.at);
            self.held = self.at;
        }
    }

    /// The place in bytes from the start of the file.
    #[must_use]
    pub fn at(&self) -> usize {
        self.at
    }

    /// Returns the bytes that lie ahead.
    #[must_use]
    pub fn rest(&self) -> &'a [u8] {
        &self.bytes[self.at..]
    }

    /// Passes `count` bytes that hold `what`.
    ///
    /// # Errors
    /// [`ReadFault::Truncated`] where there are fewer.
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

    /// Passes the rest of this line and its end; false at the end of the file.
    pub fn skip_line(&mut self) -> bool {
        let rest = self.rest();
        self.pass(rest.iter().position(|&b| b == b'\n').map_or(rest.len(), |end| end + 1));
        !rest.is_empty()
    }

    /// Passes spaces, tabs and line ends.
    pub fn skip_whitespace(&mut self) {
        self.at += self.rest().iter().take_while(|b| b.is_ascii_whitespace()).count();
    }

    /// Passes spaces and tabs.
    pub fn skip_blanks(&mut self) {
        self.at += self.rest().iter().take_while(|b| matches!(b, b' ' | b'\t')).count();
    }

    /// The rest of this line, passing its end (LF or CR LF); nothing at the end of the file.
    ///
    /// # Errors
    /// [`ReadFault::Malformed`] if that is no text, or longer than any header's line.
    pub fn line(&mut self) -> Result<Option<&'a str>, ReadFault> {
        let (start, rest) = (self.at, self.rest());
        if !self.skip_line() {
            return Ok(None);
        }
        let line = &rest[..self.at - start];
        match std::str::from_utf8(&line[..line.len().min(LONGEST_LINE)]) {
            Ok(text) if line.len() <= LONGEST_LINE => Ok(Some(text.trim_end_matches(['\r', '\n']))),
            _ => Err(malformed(start, "expected a line of text")),
        }
    }

    /// Passes a word, if one starts here.
    pub fn word(&mut self) -> &'a [u8] {
        let rest = self.rest();
        let length = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
        self.pass(length);
        &rest[..length]
    }

    /// The number that starts here.
    ///
    /// # Errors
    /// [`ReadFault::Line`] if there is none.
    pub fn number<T: std::str::FromStr>(&mut self) -> Result<T, ReadFault> {
        let start = self.at;
        let word = self.word();
        std::str::from_utf8(word).ok().and_then(|word| word.parse().ok()).ok_or_else(|| {
            let found = match (word.is_empty(), start == self.bytes.len()) {
                (true, true) => "the file ends".to_owned(),
                (true, false) => "the line ends".to_owned(),
                _ => format!("{:?} stands", String::from_utf8_lossy(&word[..word.len().min(40)])),
            };
            self.fault(start, format!("{found} where a number should"))
        })
    }

    /// Refuses `count` numbers of `what` that cannot lie ahead, as each but the last takes two bytes.
    ///
    /// # Errors
    /// [`ReadFault::Truncated`].
    pub fn expect_numbers(&self, count: usize, what: &str) -> Result<(), ReadFault> {
        let needed = count.saturating_mul(2).saturating_sub(1);
        self.clone().skip(needed, what)
    }

    /// A fault of the line that byte `at` is in.
    #[must_use]
    pub fn fault(&self, at: usize, what: String) -> ReadFault {
        let line = 1 + self.bytes[..at].iter().filter(|&&b| b == b'\n').count() as u64;
        ReadFault::Line { line, what }
    }
}

//! Lines, words and numbers of a file that is text, at least where we look.

use std::borrow::Cow;
use std::ops::Range;

use super::bytes::{Slice, View};
use super::number::Number;
use super::{ReadFault, malformed};

/// No line of a header is longer, so that binary data taken for text is found out early.
const LONGEST_LINE: usize = 64 << 10;
/// Bytes in which a line's end is looked for first.
const SHORT_LINE: usize = 1 << 8;
/// Bytes that are passed before their memory is given back.
const PASSED: usize = 1 << 20;

/// A place in a file, moving forward.
#[derive(Debug, Clone)]
pub struct Scanner<'a> {
    bytes: &'a [u8],
    at: usize,
    /// The store that gives memory back, and the offset from which on it has not done so.
    store: Option<Slice<'a>>,
    held: usize,
}

impl<'a> Scanner<'a> {
    /// Starts at byte `at` of `bytes`, or at their end.
    pub fn new(bytes: &'a [u8], at: usize) -> Self {
        let at = at.min(bytes.len());
        Self { bytes, at, store: None, held: at }
    }

    /// Starts at byte `at` of `store`, and gives the memory of passed lines and words back.
    pub fn releasing(store: Slice<'a>, at: usize) -> Self {
        Self { store: Some(store), ..Self::new(store.bytes(), at) }
    }

    /// Reads a range of `store`, and gives the memory of passed lines and words back.
    pub fn releasing_to(store: Slice<'a>, range: Range<usize>) -> Self {
        Self { store: Some(store), ..Self::new(&store.bytes()[..range.end], range.start) }
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
    pub fn at(&self) -> usize {
        self.at
    }

    /// Returns the bytes that lie ahead.
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
    pub fn number<T: Number>(&mut self) -> Result<T, ReadFault> {
        let start = self.at;
        let word = self.word();
        T::of(word).ok_or_else(|| {
            let found = match (word.is_empty(), start == self.bytes.len()) {
                (true, true) => "the file ends".to_owned(),
                (true, false) => "the line ends".to_owned(),
                _ => format!("{:?} stands", String::from_utf8_lossy(&word[..word.len().min(40)])),
            };
            self.fault(start, format!("{found} where a number should"))
        })
    }

    /// Refuses `count` numbers of `what` that cannot lie ahead, as each but the last takes two
    /// bytes.
    pub fn expect_numbers(&self, count: usize, what: &str) -> Result<(), ReadFault> {
        let needed = count.saturating_mul(2).saturating_sub(1);
        self.clone().skip(needed, what)
    }

    /// A fault of the line that byte `at` is in.
    pub fn fault(&self, at: usize, what: String) -> ReadFault {
        ReadFault::Line { line: 1 + ends(&self.bytes[..at]), what }
    }
}

/// The number of line ends.
fn ends(text: &[u8]) -> u64 {
    text.iter().filter(|&&b| b == b'\n').count() as u64
}

/// A place in a file of lines between blocks of binary data, or before them, moving forward.
#[derive(Debug, Clone)]
pub struct Lines<'a> {
    bytes: View<'a>,
    at: usize,
}

impl<'a> Lines<'a> {
    /// Starts at byte `at` of `bytes`, or at their end.
    pub fn new(bytes: View<'a>, at: usize) -> Self {
        Self { bytes, at: at.min(bytes.len()) }
    }

    /// The place in bytes from the start of the file.
    pub fn at(&self) -> usize {
        self.at
    }

    /// The bytes that lie ahead: `count` of them, or as many as there are.
    ///
    /// # Errors
    /// [`ReadFault::Changed`] and [`ReadFault::Io`] where they cannot be read, as in all that
    /// follow.
    pub fn ahead(&self, count: usize) -> Result<Cow<'a, [u8]>, ReadFault> {
        self.bytes.read(self.at..self.bytes.len().min(self.at.saturating_add(count)))
    }

    /// Passes `count` bytes that hold `what`.
    ///
    /// # Errors
    /// [`ReadFault::Truncated`] where there are fewer.
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

    /// Passes what is before the first byte that `stops`; false at the end of the file.
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

    /// Passes the rest of this line and its end; false at the end of the file.
    pub fn skip_line(&mut self) -> Result<bool, ReadFault> {
        let start = self.at;
        self.at += usize::from(self.skip_to(|byte| byte == b'\n')?);
        Ok(self.at > start)
    }

    /// Passes spaces, tabs and line ends.
    pub fn skip_whitespace(&mut self) -> Result<(), ReadFault> {
        self.skip_to(|byte| !byte.is_ascii_whitespace()).map(|_| ())
    }

    /// The rest of this line, passing its end (LF or CR LF); nothing at the end of the file.
    ///
    /// # Errors
    /// [`ReadFault::Malformed`] if that is no text, or longer than any header's line; and as
    /// [`ahead`](Self::ahead).
    pub fn line(&mut self) -> Result<Option<String>, ReadFault> {
        for looked_at in [SHORT_LINE, LONGEST_LINE] {
            let ahead = self.ahead(looked_at)?;
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

    /// A fault of the line that byte `at` is in, or one of reading the file up to there.
    pub fn fault(&self, at: usize, what: String) -> ReadFault {
        let pieces = (0..at).step_by(LONGEST_LINE).map(|start| start..at.min(start + LONGEST_LINE));
        let counted =
            pieces.map(|piece| Ok(ends(&self.bytes.read(piece)?))).sum::<Result<u64, ReadFault>>();
        counted.map_or_else(|fault| fault, |ends| ReadFault::Line { line: 1 + ends, what })
    }
}

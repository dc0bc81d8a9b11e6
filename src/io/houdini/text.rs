//! Reads the text form of Houdini's JSON.

use std::rc::Rc;

use crate::io::ReadFault;
use crate::io::bytes::Slice;
use crate::io::number::ParseNumber;

use super::json::{Json, JsonEvent, Nesting};

/// Number of bytes that are read before their memory is released.
const RELEASE_STEP: usize = 1 << 20;

/// A document in the text form.
pub struct Text<'a> {
    store: Slice<'a>,
    at: usize,
    /// Position of the first byte whose memory has not been released.
    unreleased: usize,
    /// Position of the last value that was read.
    value_at: usize,
    nesting: Nesting,
}

impl<'a> Text<'a> {
    /// Creates a reader at the start of a text. A byte order mark is skipped.
    pub fn new(store: Slice<'a>) -> Self {
        let at = if store.starts_with(b"\xef\xbb\xbf") { 3 } else { 0 };
        Self { store, at, unreleased: at, value_at: at, nesting: Nesting::default() }
    }

    fn rest(&self) -> &'a [u8] {
        &self.store.bytes()[self.at..]
    }

    /// Skips white space, commas and colons. Commas and colons are optional, because writers may
    /// omit them in lists of keys and values.
    fn skip_blanks(&mut self) {
        let is_blank = |byte: &&u8| byte.is_ascii_whitespace() || matches!(byte, b',' | b':');
        self.at += self.rest().iter().take_while(is_blank).count();
        if self.at - self.unreleased >= RELEASE_STEP {
            self.store.release(self.unreleased..self.at);
            self.unreleased = self.at;
        }
    }

    /// Reads a text in quotes.
    fn quoted(&mut self) -> Result<Rc<str>, ReadFault> {
        let rest = self.rest();
        let mut escaped = false;
        let end = rest.iter().skip(1).position(|&byte| {
            let ends = byte == b'"' && !escaped;
            escaped = byte == b'\\' && !escaped;
            ends
        });
        let end = end.ok_or_else(|| self.fault("a string has no end".to_owned()))? + 2;
        self.at += end;
        let quoted = &rest[..end];
        if !quoted.contains(&b'\\') {
            return Ok(String::from_utf8_lossy(&quoted[1..end - 1]).into());
        }
        serde_json::from_slice::<String>(quoted)
            .map(Rc::from)
            .map_err(|fault| self.fault(format!("invalid JSON text: {fault}")))
    }

    fn word(&mut self) -> Result<JsonEvent, ReadFault> {
        let rest = self.rest();
        let is_part = |byte: &&u8| {
            byte.is_ascii_alphanumeric()
                || matches!(byte, b'+' | b'-' | b'.' | b'#' | b'(' | b')' | b'_')
        };
        let length = rest.iter().take_while(is_part).count();
        self.at += length;
        let word = &rest[..length];
        Ok(match word {
            b"true" => JsonEvent::Bool(true),
            b"false" => JsonEvent::Bool(false),
            b"null" => JsonEvent::Null,
            _ => match (i64::of(word), f64::of(word)) {
                (Some(whole), _) => JsonEvent::Integer(whole),
                (None, Some(real)) => JsonEvent::Real(real),
                (None, None) => {
                    let found = &rest[..length.clamp(1, 40)];
                    let found = String::from_utf8_lossy(found);
                    return Err(self.fault(format!("expected a value, found {found:?}")));
                }
            },
        })
    }
}

impl Json for Text<'_> {
    fn next(&mut self) -> Result<JsonEvent, ReadFault> {
        self.skip_blanks();
        self.value_at = self.at;
        let Some(first) = self.rest().first() else {
            return Err(self.fault("the file ends within the geometry".to_owned()));
        };
        let nested = match first {
            b'"' => return self.quoted().map(JsonEvent::Text),
            b'[' => self.nesting.begin(JsonEvent::List),
            b'{' => self.nesting.begin(JsonEvent::Map),
            b']' => self.nesting.end(&JsonEvent::List),
            b'}' => self.nesting.end(&JsonEvent::Map),
            _ => return self.word(),
        };
        self.at += 1;
        nested.map_err(|what| self.fault(what))
    }

    fn fault(&self, what: String) -> ReadFault {
        let above = self.store.bytes()[..self.value_at].iter().filter(|&&byte| byte == b'\n');
        ReadFault::Line { line: 1 + above.count() as u64, what }
    }

    fn end(&mut self) -> Result<(), ReadFault> {
        self.at += self.rest().iter().take_while(|byte| byte.is_ascii_whitespace()).count();
        self.value_at = self.at;
        match self.rest() {
            [] => Ok(()),
            _ => Err(self.fault("there is more data after the geometry".to_owned())),
        }
    }
}

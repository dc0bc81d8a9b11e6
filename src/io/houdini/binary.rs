//! Reads Houdini's binary JSON. A type byte precedes each value. A document can define a text once
//! and then refer to it by number.

use std::collections::HashMap;
use std::rc::Rc;

use half::f16;

use crate::io::bytes::ByteView;
use crate::io::columns::{Endian, Scalar};
use crate::io::cursor::Cursor;
use crate::io::{ReadFault, malformed};

use super::json::{Json, JsonEvent, JsonNumbers, Nesting, Storage};

/// The first byte of a document.
const MAGIC: u8 = 0x7f;
/// The word after the first byte. The order of its bytes shows the byte order of the document.
const WORD: u32 = u32::from_le_bytes(*b"NSJb");

/// The byte order of a file that starts with `head`. `None` if the file is not binary JSON.
pub fn byte_order(head: &[u8]) -> Option<Endian> {
    let (&MAGIC, rest) = head.split_first()? else { return None };
    let word = *rest.first_chunk()?;
    match (u32::from_le_bytes(word), u32::from_be_bytes(word)) {
        (WORD, _) => Some(Endian::Little),
        (_, WORD) => Some(Endian::Big),
        _ => None,
    }
}

/// A document in binary JSON.
pub struct Binary<'a> {
    cursor: Cursor<'a>,
    len: usize,
    /// Position of the type byte of the last value.
    value_at: usize,
    nesting: Nesting,
    tokens: HashMap<u64, Rc<str>>,
    /// Number of texts that are still to be read in an array of texts. `None` outside such an
    /// array.
    texts: Option<u64>,
}

impl<'a> Binary<'a> {
    /// Creates a reader at the start of a file. [`byte_order`] determines `endian`.
    pub fn new(bytes: ByteView<'a>, endian: Endian) -> Self {
        let start = 1 + size_of_val(&WORD);
        Self {
            cursor: Cursor::new(bytes, start, endian),
            len: bytes.len(),
            value_at: start,
            nesting: Nesting::default(),
            tokens: HashMap::new(),
            texts: None,
        }
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], ReadFault> {
        self.cursor.array("a value")
    }

    fn byte(&mut self) -> Result<u8, ReadFault> {
        self.array().map(u8::from_le_bytes)
    }

    /// Reads a length, or the number of a text.
    fn length(&mut self) -> Result<u64, ReadFault> {
        Ok(match self.byte()? {
            short @ ..=0xf0 => short.into(),
            0xf2 => u16::from_le_bytes(self.array()?).into(),
            0xf4 => u32::from_le_bytes(self.array()?).into(),
            0xf8 => u64::from_le_bytes(self.array()?),
            other => {
                return Err(self.fault(format!("a length begins with the invalid byte {other:#x}")));
            }
        })
    }

    fn text(&mut self) -> Result<Rc<str>, ReadFault> {
        let length = self.length()?;
        let bytes = self.cursor.take("a text", length)?;
        Ok(String::from_utf8_lossy(bytes).into())
    }

    /// Reads the number of a text that was defined earlier, and returns the text.
    fn token(&mut self) -> Result<Rc<str>, ReadFault> {
        let number = self.length()?;
        let known = self.tokens.get(&number).cloned();
        known.ok_or_else(|| self.fault(format!("string number {number} is not defined")))
    }

    fn uniform(&mut self) -> Result<JsonEvent, ReadFault> {
        let kind = self.byte()?;
        let count = self.length()?;
        let storage = match kind {
            0x10 => Storage::Bits,
            0x11 => Storage::Scalar(Scalar::I8),
            0x12 => Storage::Scalar(Scalar::I16),
            0x13 => Storage::Scalar(Scalar::I32),
            0x14 => Storage::Scalar(Scalar::I64),
            0x18 => Storage::Half,
            0x19 => Storage::Scalar(Scalar::F32),
            0x1a => Storage::Scalar(Scalar::F64),
            0x21 => Storage::Scalar(Scalar::U8),
            0x22 => Storage::Scalar(Scalar::U16),
            0x27 => {
                self.texts = Some(count);
                return self.begin(JsonEvent::List);
            }
            other => return Err(self.fault(format!("an array has the unknown type {other:#x}"))),
        };
        let at = self.cursor.skip("an array", storage.bytes(count), 1)?;
        Ok(JsonEvent::Numbers(JsonNumbers { at, storage, count }))
    }

    fn begin(&mut self, event: JsonEvent) -> Result<JsonEvent, ReadFault> {
        self.nesting.begin(event).map_err(|what| malformed(self.value_at, what))
    }

    fn close(&mut self, start: &JsonEvent) -> Result<JsonEvent, ReadFault> {
        self.nesting.end(start).map_err(|what| malformed(self.value_at, what))
    }
}

impl Json for Binary<'_> {
    fn next(&mut self) -> Result<JsonEvent, ReadFault> {
        match self.texts {
            Some(0) => {
                self.texts = None;
                return self.close(&JsonEvent::List);
            }
            Some(left) => {
                self.texts = Some(left - 1);
                return self.text().map(JsonEvent::Text);
            }
            None => {}
        }
        loop {
            self.value_at = self.cursor.at();
            return Ok(match self.byte()? {
                0x2c | 0x3a => continue,
                0x2b => {
                    let (number, text) = (self.length()?, self.text()?);
                    self.tokens.insert(number, text);
                    continue;
                }
                0x2d => {
                    let number = self.length()?;
                    self.tokens.remove(&number);
                    continue;
                }
                0x5b => self.begin(JsonEvent::List)?,
                0x7b => self.begin(JsonEvent::Map)?,
                0x5d => self.close(&JsonEvent::List)?,
                0x7d => self.close(&JsonEvent::Map)?,
                0x00 => JsonEvent::Null,
                0x10 => JsonEvent::Bool(self.byte()? != 0),
                0x30 => JsonEvent::Bool(false),
                0x31 => JsonEvent::Bool(true),
                0x11 => JsonEvent::Integer(i8::from_le_bytes(self.array()?).into()),
                0x12 => JsonEvent::Integer(i16::from_le_bytes(self.array()?).into()),
                0x13 => JsonEvent::Integer(i32::from_le_bytes(self.array()?).into()),
                0x14 => JsonEvent::Integer(i64::from_le_bytes(self.array()?)),
                0x21 => JsonEvent::Integer(self.byte()?.into()),
                0x22 => JsonEvent::Integer(u16::from_le_bytes(self.array()?).into()),
                0x18 => JsonEvent::Real(f16::from_le_bytes(self.array()?).into()),
                0x19 => JsonEvent::Real(f32::from_le_bytes(self.array()?).into()),
                0x1a => JsonEvent::Real(f64::from_le_bytes(self.array()?)),
                0x26 => JsonEvent::Text(self.token()?),
                0x27 => JsonEvent::Text(self.text()?),
                0x40 => self.uniform()?,
                other => return Err(self.fault(format!("a value has the unknown type {other:#x}"))),
            });
        }
    }

    fn fault(&self, what: String) -> ReadFault {
        malformed(self.value_at, what)
    }

    fn end(&mut self) -> Result<(), ReadFault> {
        let at = self.cursor.at();
        if at < self.len {
            return Err(malformed(
                at,
                format!("{} extra bytes follow the geometry", self.len - at),
            ));
        }
        Ok(())
    }
}

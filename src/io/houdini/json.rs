//! Events of Houdini's JSON. The text form and the binary form have the same events.
//!
//! No tree of values is built. Readers process one event after another, and long arrays of numbers
//! are not copied.

use std::fmt;
use std::rc::Rc;

use half::f16;

use crate::io::ReadFault;
use crate::io::bytes::ByteView;
use crate::io::columns::{Endian, Scalar};

/// Maximum depth of nested lists and maps. Each level of nested packed geometry takes about ten
/// levels of lists and maps.
const DEEPEST: usize = 1024;

/// One step in reading a JSON document.
#[derive(Debug, Clone, PartialEq)]
pub enum JsonEvent {
    /// The start of a list.
    List,
    /// The start of a map, in which keys and values alternate.
    Map,
    /// The end of the innermost list or map.
    End,
    Null,
    Bool(bool),
    Integer(i64),
    Real(f64),
    Text(Rc<str>),
    /// A list of numbers of the same type.
    Numbers(JsonNumbers),
}

/// The type of stored numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Storage {
    /// Booleans, 32 in each word.
    Bits,
    /// 16-bit IEEE floating-point numbers.
    Half,
    Scalar(Scalar),
}

impl Storage {
    /// The number type to which the reader converts numbers of this storage.
    pub fn scalar(self) -> Scalar {
        match self {
            Self::Scalar(scalar) => scalar,
            Self::Half => Scalar::F32,
            Self::Bits => Scalar::U8,
        }
    }

    /// Size, in bytes, of `count` numbers.
    pub fn bytes(self, count: u64) -> u64 {
        match self {
            Self::Bits => count.div_ceil(32).saturating_mul(4),
            Self::Half => count.saturating_mul(2),
            Self::Scalar(scalar) => count.saturating_mul(scalar.size() as u64),
        }
    }
}

/// A range of consecutive numbers in a buffer of bytes, such as the document.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct JsonNumbers {
    /// Byte offset of the first number.
    pub at: usize,
    pub storage: Storage,
    pub count: u64,
}

/// A decoded number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum JsonNumber {
    Integer(i64),
    Real(f64),
}

impl fmt::Display for JsonNumber {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Integer(number) => number.fmt(f),
            Self::Real(number) => number.fmt(f),
        }
    }
}

/// A JSON document that is read sequentially.
pub trait Json {
    /// Reads the next event.
    ///
    /// # Errors
    /// If the document is damaged, or if its bytes cannot be read.
    fn next(&mut self) -> Result<JsonEvent, ReadFault>;

    /// An error at the position of the last event.
    fn fault(&self, what: String) -> ReadFault;

    /// Checks that the document ends here.
    ///
    /// # Errors
    /// If bytes remain.
    fn end(&mut self) -> Result<(), ReadFault>;
}

/// The stack of lists and maps that have not ended.
#[derive(Debug, Default)]
pub struct Nesting(Vec<JsonEvent>);

impl Nesting {
    pub fn begin(&mut self, event: JsonEvent) -> Result<JsonEvent, String> {
        if self.0.len() == DEEPEST {
            return Err(format!("lists are nested more than {DEEPEST} levels deep"));
        }
        self.0.push(event.clone());
        Ok(event)
    }

    pub fn end(&mut self, start: &JsonEvent) -> Result<JsonEvent, String> {
        match self.0.pop() {
            Some(open) if open == *start => Ok(JsonEvent::End),
            _ => Err("found the end of a list or map without its start".to_owned()),
        }
    }
}

/// Number of values that are read at once.
const AT_ONCE: u64 = 1 << 12;

impl JsonNumbers {
    /// The range of `count` numbers that starts at number `first`.
    pub fn part(self, first: u64, count: u64) -> Self {
        Self { at: self.at + self.storage.bytes(first) as usize, count, ..self }
    }

    /// Calls `take` with each number, in order.
    ///
    /// # Errors
    /// The errors of `take` and of reading.
    pub fn each(
        self,
        bytes: ByteView,
        endian: Endian,
        mut take: impl FnMut(JsonNumber) -> Result<(), ReadFault>,
    ) -> Result<(), ReadFault> {
        for first in (0..self.count).step_by(AT_ONCE as usize) {
            let part = self.part(first, AT_ONCE.min(self.count - first));
            let end = part.at + part.storage.bytes(part.count) as usize;
            let stored = bytes.read(part.at..end)?;
            for index in 0..part.count as usize {
                take(part.storage.number(&stored, index, endian))?;
            }
        }
        Ok(())
    }
}

macro_rules! numbers {
    ($($scalar:ident $type:ident $number:ident),*) => {
        impl Storage {
            /// The number at `index` in the bytes `stored`.
            #[allow(clippy::cast_lossless)] // Unlike `i64::from`, `as` also converts u64.
            fn number(self, stored: &[u8], index: usize, endian: Endian) -> JsonNumber {
                match self {
                    Self::Bits => {
                        let word = u32::from_bytes(&stored[index / 32 * 4..], endian);
                        JsonNumber::Integer(i64::from(word >> (index % 32) & 1))
                    }
                    Self::Half | Self::Scalar(Scalar::F16) => {
                        let bits = u16::from_bytes(&stored[index * 2..], endian);
                        JsonNumber::Real(f16::from_bits(bits).into())
                    }
                    $(Self::Scalar(Scalar::$scalar) => {
                        let at = index * size_of::<$type>();
                        JsonNumber::$number($type::from_bytes(&stored[at..], endian) as _)
                    })*
                }
            }
        }

        $(impl FromStoredBytes for $type {
            fn from_bytes(bytes: &[u8], endian: Endian) -> Self {
                let mut own = [0; size_of::<Self>()];
                own.copy_from_slice(&bytes[..size_of::<Self>()]);
                match endian {
                    Endian::Little => Self::from_le_bytes(own),
                    Endian::Big => Self::from_be_bytes(own),
                }
            }
        })*

        impl JsonNumber {
            /// Appends the number as little-endian bytes. `None` if the type cannot represent it.
            pub fn put(self, scalar: Scalar, out: &mut Vec<u8>) -> Option<()> {
                match scalar {
                    $(Scalar::$scalar => {
                        let stored = $type::of(self)?;
                        out.extend_from_slice(&stored.to_le_bytes());
                    })*
                    // Half floats are read as f32, so this type does not occur here.
                    Scalar::F16 => return None,
                }
                Some(())
            }
        }
    };
}

/// A number type that can be read from stored bytes.
trait FromStoredBytes: Sized {
    fn from_bytes(bytes: &[u8], endian: Endian) -> Self;
}

numbers!(
    I8 i8 Integer, U8 u8 Integer, I16 i16 Integer, U16 u16 Integer, I32 i32 Integer,
    U32 u32 Integer, I64 i64 Integer, U64 u64 Integer, F32 f32 Real, F64 f64 Real
);

/// A number type to which a [`JsonNumber`] can be converted.
trait FromJsonNumber: Sized {
    fn of(number: JsonNumber) -> Option<Self>;
}

macro_rules! whole {
    ($($type:ident),*) => {
        $(impl FromJsonNumber for $type {
            fn of(number: JsonNumber) -> Option<Self> {
                match number {
                    JsonNumber::Integer(whole) => Self::try_from(whole).ok(),
                    // Accept integers that are stored as floating-point numbers, such as `1.0` or
                    // `1e3`.
                    JsonNumber::Real(real) => {
                        let whole = real as i64;
                        (whole as f64 == real).then(|| Self::try_from(whole).ok())?
                    }
                }
            }
        })*
    };
}

whole!(i8, u8, i16, u16, i32, u32, i64, u64);

impl FromJsonNumber for f32 {
    fn of(number: JsonNumber) -> Option<Self> {
        f64::of(number).map(|wide| wide as Self)
    }
}

impl FromJsonNumber for f64 {
    fn of(number: JsonNumber) -> Option<Self> {
        Some(match number {
            JsonNumber::Integer(whole) => whole as Self,
            JsonNumber::Real(real) => real,
        })
    }
}

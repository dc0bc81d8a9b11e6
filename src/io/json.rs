//! Reads a JSON list of positions, as splashsurf writes it. Each position is a list of x, y and z.

use std::fmt;
use std::io::BufReader;

use serde::de::{DeserializeSeed, Deserializer, Error, SeqAccess, Visitor};

use super::bytes::{Bytes, SequentialReader, UnpackBuffer, Unpacking};
use super::columns::{Column, ColumnStore, Endian, ParticleRows, Scalar};
use super::error::ADD_Z;
use super::scan::mark_length;
use super::{ParticleFile, ReadFault};

/// Size, in bytes, of a position.
const TRIPLE: usize = 3 * size_of::<f64>();
/// Size, in bytes, of the buffer of text. Decoded positions are also collected up to about this
/// size before they are stored.
const CHUNK: usize = 1 << 16;

/// Reads a list of positions.
///
/// # Errors
/// [`ReadFault::Line`] for text that is not JSON or not a list of triples of numbers,
/// [`ReadFault::Changed`] and [`ReadFault::Io`] for a file that has changed or cannot be read, and
/// [`ReadFault::Scratch`] if the scratch file cannot be written.
pub fn read_particles(bytes: Bytes, unpacking: Unpacking) -> Result<ParticleFile, ReadFault> {
    let view = bytes.view();
    let start = mark_length(&view.read(0..view.len().min(3))?);
    let text = BufReader::with_capacity(CHUNK, SequentialReader::new(view, start));
    let mut rows = UnpackBuffer::new(unpacking);
    let mut json = serde_json::Deserializer::from_reader(text);
    let (mut scratch, mut width) = (Ok(()), 3);
    let positions = Positions { rows: &mut rows, scratch: &mut scratch, width: &mut width };
    let read = positions.deserialize(&mut json).and_then(|()| json.end());
    scratch?;
    view.check()?;
    read.map_err(|fault| {
        if fault.is_io() {
            return ReadFault::Io(fault.into());
        }
        let advice = match width {
            2 => format!("; {ADD_Z}"),
            4.. => "; write only x, y and z, or write a .csv file with the names of all columns \
                    in its first line"
                .to_owned(),
            _ => String::new(),
        };
        let what = format!(
            "{fault}; expected a list of positions (x, y and z), such as [[0, 0, 0], [1, 0, 0]]{advice}"
        );
        ReadFault::Line { line: fault.line().max(1) as u64, what }
    })?;
    let rows = rows.finish()?;
    let count = rows.len() / TRIPLE;
    let x = Column { offset: 0, stride: TRIPLE, scalar: Scalar::F64, endian: Endian::Little };
    let position = [0, 1, 2].map(|axis| x.component(axis));
    let store: ColumnStore = ColumnStore::new(rows, ParticleRows::All(count), position, Vec::new());
    Ok(ParticleFile::new(store, "JSON"))
}

/// Decodes positions one by one, without a list of all positions in memory.
struct Positions<'a, 'u> {
    rows: &'a mut UnpackBuffer<'u>,
    /// The result of the last write to `rows`. It is stored here because serde's errors cannot
    /// contain a [`ReadFault`].
    scratch: &'a mut Result<(), ReadFault>,
    /// The count of numbers in the last complete row.
    width: &'a mut usize,
}

impl Positions<'_, '_> {
    fn push<E: Error>(&mut self, chunk: &mut Vec<u8>) -> Result<(), E> {
        *self.scratch = self.rows.push(chunk);
        chunk.clear();
        if self.scratch.is_ok() { Ok(()) } else { Err(E::custom("the scratch file failed")) }
    }
}

impl<'de> DeserializeSeed<'de> for Positions<'_, '_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, list: D) -> Result<(), D::Error> {
        list.deserialize_seq(self)
    }
}

impl<'de> Visitor<'de> for Positions<'_, '_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("a list of positions")
    }

    fn visit_seq<A: SeqAccess<'de>>(mut self, mut list: A) -> Result<(), A::Error> {
        let mut chunk = Vec::new();
        while let Some(position) = list.next_element_seed(Row { width: self.width })? {
            chunk.extend_from_slice(position.map(f64::to_le_bytes).as_flattened());
            if chunk.len() >= CHUNK {
                self.push(&mut chunk)?;
            }
        }
        self.push(&mut chunk)
    }
}

/// Decodes a position, which is a list of three numbers.
struct Row<'a> {
    /// The count of numbers in the row, once the row is complete.
    width: &'a mut usize,
}

impl<'de> DeserializeSeed<'de> for Row<'_> {
    type Value = [f64; 3];

    fn deserialize<D: Deserializer<'de>>(self, row: D) -> Result<[f64; 3], D::Error> {
        row.deserialize_seq(self)
    }
}

impl<'de> Visitor<'de> for Row<'_> {
    type Value = [f64; 3];

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("a list of three numbers")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut row: A) -> Result<[f64; 3], A::Error> {
        let (mut position, mut width) = ([0.0; 3], 0);
        while let Some(number) = row.next_element()? {
            if let Some(coordinate) = position.get_mut(width) {
                *coordinate = number;
            }
            width += 1;
        }
        *self.width = width;
        if width == 3 {
            Ok(position)
        } else {
            Err(A::Error::custom(format!("a row has {width} numbers")))
        }
    }
}

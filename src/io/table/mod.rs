//! Reads text tables with one line per particle. Rows are decoded to little-endian f64 numbers,
//! with the position first.
//!
//! The first rows determine the separator of fields and the decimal separator. A line that names
//! `x`, `y` and `z` (see [`names`]) specifies the columns, even if it is a comment. The lines above
//! it and a line of units below it are skipped. It is an error if a comment seems to name the
//! columns in a notation that the reader does not support.
//!
//! Without such a line, the first three columns are the position, or the three columns after a row
//! number. It is an error if these columns may contain identifiers or types. The other columns are
//! ignored because they have no names. Fields of unused columns are not parsed.
//!
//! [`names`]: super::names

mod fields;
mod header;
mod heading;
mod labels;
mod times;
mod unnamed;

use std::ops::{ControlFlow, Range};
use std::sync::atomic::{AtomicBool, Ordering};

use crate::particles::AttributeInfo;

use super::bytes::{Bytes, PrivateBytes, UnpackBuffer, Unpacking};
use super::columns::{Column, ColumnStore, Endian, ParticleRows, Scalar};
use super::names::Quantity;
use super::number::{Decimal, is_overflow};
use super::text::decode_windows;
use super::wanted::WantedAttributes;
use super::windows::InputBytes;
use super::{ParticleFile, ReadFault};

use fields::{LineFields, is_comment, lines, unquoted};
use heading::Heading;
use labels::{Known, Texts};
use times::Times;

pub(super) use fields::{Separator, Syntax};
pub(super) use header::{columns_in_comment, name_plane, names_of};
pub(super) use heading::{HEAD, TableColumns, unnamed_columns};
pub(super) use unnamed::is_row;

/// Size, in bytes, of a decoded number.
const WIDTH: usize = size_of::<f64>();

/// Minimum number of rows that the first row can announce. In a smaller table, the first row may
/// contain this number by accident.
const FEWEST_ANNOUNCED: u64 = 8;

/// The rows of a table, and the meaning of their fields.
pub(super) struct TextTable {
    /// Byte range of the rows.
    pub rows: Range<usize>,
    pub lines_above: u64,
    pub syntax: Syntax,
    pub columns: TableColumns,
    /// The number of rows, if the file announces it.
    pub count: Option<u64>,
    /// The number at the start of the first row. If this number of rows follows, the first row is
    /// not a particle.
    pub announced: Option<u64>,
    /// The simulation box, if coordinates are fractions of its edges.
    pub cell: Option<Cell>,
}

/// A box: its origin and its three edges.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cell {
    pub origin: [f64; 3],
    pub edges: [[f64; 3]; 3],
}

impl Cell {
    /// The position of a point whose coordinates are `fractions` of the edges.
    fn place(&self, fractions: [f64; 3]) -> [f64; 3] {
        [0, 1, 2].map(|axis| {
            let along = |edge: usize| fractions[edge] * self.edges[edge][axis];
            self.origin[axis] + along(0) + along(1) + along(2)
        })
    }
}

/// Reads a table whose head starts at byte `start`.
///
/// # Errors
/// [`ReadFault::Line`] for a row with a wrong number of fields, for a required number that is
/// invalid, for a header without a position, and for columns whose meaning is unclear.
/// [`ReadFault::Scratch`] if the scratch file cannot be written.
pub(super) fn read(
    bytes: Bytes,
    start: usize,
    wanted: WantedAttributes,
    unpacking: Unpacking,
) -> Result<ParticleFile, ReadFault> {
    let view = bytes.view();
    let Heading { start, lines_above, syntax, columns, announced } = Heading::of(view, start)?;
    let rows = start..view.len();
    let (count, cell) = (None, None);
    let table = TextTable { rows, lines_above, syntax, columns, count, announced, cell };
    table.read(bytes, wanted, unpacking, "text table")
}

/// The index of a field's value in a decoded row, and the treatment of an invalid field.
#[derive(Debug, Clone, Copy)]
struct FieldTarget {
    /// The index of the value in a decoded row.
    place: usize,
    /// The treatment of a field that is not a number.
    if_invalid: BadFieldPolicy,
}

/// The decoded rows of a piece of text.
struct DecodedPiece {
    rows: Vec<u8>,
    /// The number of lines.
    lines: u64,
    /// The number of rows without values at the end of the piece.
    empty: usize,
    /// The numbers in each column of times.
    times: Vec<Times>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum BadFieldPolicy {
    Refuse,
    /// The column contains text, so the attribute is left out.
    Drop,
    /// The field is a text of the label with this number.
    Label(usize),
}

impl TextTable {
    /// Decodes the rows.
    ///
    /// # Errors
    /// The errors of [`read`], and [`ReadFault::Line`] if there are fewer rows than the file
    /// announces.
    pub fn read(
        self,
        bytes: Bytes,
        wanted: WantedAttributes,
        unpacking: Unpacking,
        format: &'static str,
    ) -> Result<ParticleFile, ReadFault> {
        let view = bytes.view();
        let head = view.read(self.rows.start..self.rows.end.min(self.rows.start + HEAD))?;
        let mut columns = self.columns;
        let mut texts = columns.take_texts(&head, self.syntax);
        texts.retain(|text| text.columns.len() == 1 && wanted.includes_label(&text.name));
        drop(head);
        let table = Self { columns, ..self };
        let TableColumns { names, position, attributes } = &table.columns;
        let info = |q: &Quantity| AttributeInfo::new(&q.name, q.columns.len());
        let infos: Vec<_> = attributes.iter().map(info).collect();
        let is_read = wanted.among(&infos);
        let requested = wanted.requested_among(&infos).unwrap_or_else(|| vec![false; infos.len()]);
        let read = || attributes.iter().zip(&is_read).filter_map(|(a, read)| read.then_some(a));
        let if_invalid =
            requested.iter().zip(&is_read).filter(|(_, read)| **read).map(|(requested, _)| {
                if *requested { BadFieldPolicy::Refuse } else { BadFieldPolicy::Drop }
            });
        let attribute_columns = read()
            .zip(if_invalid)
            .flat_map(|(a, if_invalid)| a.columns.iter().map(move |column| (column, if_invalid)));
        let label_columns = texts.iter().enumerate();
        let label_columns = label_columns.map(|(n, t)| (&t.columns[0], BadFieldPolicy::Label(n)));
        let attribute_columns = attribute_columns.chain(label_columns);
        let position_columns =
            position.columns.iter().map(|column| (column, BadFieldPolicy::Refuse));
        let mut slots = vec![None; names.len()];
        let mut width = 0;
        for (&column, if_invalid) in position_columns.chain(attribute_columns) {
            slots[column] = Some(FieldTarget { place: width, if_invalid });
            width += 1;
        }
        let text: Vec<AtomicBool> = (0..width).map(|_| AtomicBool::new(false)).collect();
        let source = InputBytes::from(bytes);
        let labels: Vec<_> = texts.iter().map(|_| Texts::default()).collect();
        let mut times: Vec<_> = attributes.iter().filter(|a| Times::are_in(a)).collect();
        // Do not look for several frames if the header gives the number of rows, because the table
        // is then one frame, or if a condition on the time selects a frame.
        if table.count.is_some() || times.iter().any(|time| wanted.test(&time.name)) {
            times.clear();
        }
        let time_columns: Vec<_> = times.iter().map(|time| time.columns[0]).collect();
        let (rows, empty, found_times) =
            table.decode(&source, (&slots, &time_columns), (&text, &labels), unpacking)?;
        let stride = width * WIDTH;
        let count = rows.len() / stride - empty;
        if let Some(expected) = table.count.filter(|expected| *expected != count as u64) {
            let what = format!("the header announces {expected} rows, but the file has {count}");
            return Err(ReadFault::Line { line: table.lines_above, what });
        }
        let is_announced = |&below: &u64| below >= FEWEST_ANNOUNCED && below + 1 == count as u64;
        let skipped = usize::from(table.announced.as_ref().is_some_and(is_announced));
        let (offset, count) = (skipped * stride, count - skipped);
        let first = Column { offset, stride, scalar: Scalar::F64, endian: Endian::Little };
        let mut places = 3..;
        let attributes = read().filter_map(|attribute| {
            let places: Vec<_> = places.by_ref().take(attribute.columns.len()).collect();
            let is_text = places.iter().any(|&place| text[place].load(Ordering::Relaxed));
            let columns = places.iter().map(|&place| first.component(place)).collect();
            (!is_text).then(|| (info(attribute), columns))
        });
        let attributes = attributes.collect();
        let labels = texts.iter().zip(labels).zip(width - texts.len()..);
        let labels = labels.filter_map(|((text, labels), place)| {
            let (label, places) = labels.label(&text.name)?;
            Some((label, (first.component(place), places)))
        });
        let labels: Vec<_> = labels.collect();
        let position = [0, 1, 2].map(|axis| first.component(axis));
        let store: ColumnStore =
            ColumnStore::new(rows, ParticleRows::All(count), position, attributes);
        let store = store.with_labels(labels);
        let unread = infos.into_iter().zip(is_read).filter(|(_, read)| !read);
        let unread = unread.map(|(info, _)| info).collect();
        let mut times = times.iter().zip(found_times);
        let left_out = times.find_map(|(time, found)| found.frames(&time.name));
        let left_out = left_out.into_iter().collect();
        Ok(ParticleFile { unread, left_out, ..ParticleFile::new(store, format) })
    }

    /// Decodes all rows in order. Also returns the number of rows without values at the end of the
    /// table, which spreadsheets write, and the numbers in each column of times.
    fn decode(
        &self,
        source: &InputBytes,
        columns: (&[Option<FieldTarget>], &[usize]),
        text: (&[AtomicBool], &[Texts]),
        unpacking: Unpacking,
    ) -> Result<(PrivateBytes, usize, Vec<Times>), ReadFault> {
        let mut rows = UnpackBuffer::new(unpacking);
        let mut lines_above = self.lines_above;
        let mut empty = 0;
        let mut times: Vec<_> = columns.1.iter().map(|_| Times::default()).collect();
        decode_windows(
            source,
            self.rows.clone(),
            |byte| byte == b'\n',
            |piece| self.decode_piece(piece, columns, text),
            |piece| {
                let piece = piece
                    .map_err(|(line, what)| ReadFault::Line { line: lines_above + line, what })?;
                let is_empty = piece.empty * text.0.len() * WIDTH == piece.rows.len();
                empty = if is_empty { empty + piece.empty } else { piece.empty };
                lines_above += piece.lines;
                times.iter_mut().zip(piece.times).for_each(|(times, next)| times.append(next));
                rows.push(&piece.rows)?;
                Ok(ControlFlow::Continue(()))
            },
        )?;
        Ok((rows.finish()?, empty, times))
    }

    /// Decodes the rows of a piece of text. Returns the line number and the error of the first
    /// invalid line.
    fn decode_piece(
        &self,
        piece: &[u8],
        (slots, time_columns): (&[Option<FieldTarget>], &[usize]),
        (text, labels): (&[AtomicBool], &[Texts]),
    ) -> Result<DecodedPiece, (u64, String)> {
        let width = text.len() * WIDTH;
        let mut known: Vec<Known> = labels.iter().map(|_| Known::new()).collect();
        let mut rows = Vec::new();
        let mut empty = 0;
        let mut times: Vec<_> = time_columns.iter().map(|_| Times::default()).collect();
        for (line, _, content) in lines(piece) {
            if is_comment(content) {
                continue;
            }
            empty = if is_empty_row(content, self.syntax.separator) { empty + 1 } else { 0 };
            let row = rows.len();
            rows.resize(row + width, 0);
            let mut fields = 0;
            for field in LineFields::new(content, self.syntax.separator, slots.len()) {
                if let Some(&Some(FieldTarget { place, if_invalid })) = slots.get(fields) {
                    let number = match if_invalid {
                        BadFieldPolicy::Label(label) => {
                            let field = unquoted(field);
                            Some(labels[label].number(&mut known[label], field).into())
                        }
                        _ => self.syntax.number(field),
                    };
                    let number = match (number, if_invalid) {
                        (Some(number), _) => number,
                        (None, BadFieldPolicy::Refuse) => {
                            return Err((line, self.not_a_number(field, fields)));
                        }
                        (None, _) => {
                            text[place].store(true, Ordering::Relaxed);
                            f64::NAN
                        }
                    };
                    rows[row + place * WIDTH..][..WIDTH].copy_from_slice(&number.to_le_bytes());
                }
                if let Some(time) = time_columns.iter().position(|&column| column == fields) {
                    times[time].push(self.syntax.number(field).unwrap_or(f64::NAN), 1);
                }
                fields += 1;
            }
            if fields != slots.len() {
                let expected = slots.len();
                let what = format!("expected {expected} fields, found {fields}");
                return Err((line, format!("{what}: {}", excerpt(content))));
            }
            if let Some(cell) = &self.cell {
                let position = &mut rows[row..][..3 * WIDTH];
                let fractions = bytemuck::pod_read_unaligned::<[[u8; WIDTH]; 3]>(position);
                let place = cell.place(fractions.map(f64::from_le_bytes));
                position.copy_from_slice(place.map(f64::to_le_bytes).as_flattened());
            }
        }
        let lines = piece.iter().filter(|&&byte| byte == b'\n').count() as u64;
        Ok(DecodedPiece { rows, lines, empty, times })
    }

    fn not_a_number(&self, field: &[u8], column: usize) -> String {
        let name = &self.columns.names[column];
        let what = format!("{} is not a number (column {name})", excerpt(field));
        if is_overflow(field) {
            return format!("{what}: the field was too narrow when Fortran wrote it");
        }
        match self.syntax {
            Syntax { separator: Separator::Byte(b','), .. } => what,
            Syntax { decimal: Decimal::Comma, .. } if field.contains(&b'.') => {
                format!("{what}: other numbers have decimal commas")
            }
            Syntax { decimal: Decimal::Point, .. } if field.contains(&b',') => {
                format!("{what}: other numbers have decimal points")
            }
            _ => what,
        }
    }
}

/// Whether a row consists only of separators and quotes.
fn is_empty_row(row: &[u8], separator: Separator) -> bool {
    let Separator::Byte(separator) = separator else { return false };
    row.iter().all(|&byte| byte == separator || byte == b'"' || byte.is_ascii_whitespace())
}

/// A quoted excerpt of a field or a line, for a message.
pub(super) fn excerpt(field: &[u8]) -> String {
    format!("{:?}", String::from_utf8_lossy(&field[..field.len().min(40)]))
}

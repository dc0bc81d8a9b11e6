//! Tables: .csv, .txt and .xyz as text, and .xyz as raw f32 triples without any header.
//!
//! A text is decoded to rows of little-endian f64, position first. Fields are separated by `;`,
//! else by `,`, else by blanks, as the first row of numbers shows. A line that names `x`, `y` and
//! `z` (see [`names`]) says what the columns hold, even as a comment; what stands above it is
//! passed over. Without such a line, the first three columns are the position and the others have
//! no name to be carried under.
//!
//! [`names`]: super::names

use std::ops::ControlFlow;

use crate::particles::AttributeInfo;

use super::bytes::{Bytes, Kept, Unpacked, Unpacking};
use super::columns::{Column, ColumnStore, Endian, Rows, Scalar};
use super::names::{Quantity, quantities};
use super::text::decode_windows;
use super::windows::{Source, Windows};
use super::{ParticleFile, ReadFault, malformed};

/// Lines, blank ones and comments not counted, within which the columns must be named.
const HEADER_LINES: usize = 32;

/// Bytes by which text is told from raw numbers.
const SNIFFED: usize = 4 << 10;

/// Bytes in which the names of columns and the first row are looked for, and twice as many where
/// these do not hold as many lines.
const HEAD: usize = 64 << 10;

/// Fields of a line; more are no table of particles.
const MOST_FIELDS: usize = 4096;

/// Reads an .xyz: text where its first 4 KiB are printable, else raw little-endian f32 triples.
///
/// # Errors
/// Those of [`read_text`]; [`ReadFault::Malformed`] for raw bytes that are not whole triples.
pub fn read_particles(bytes: Bytes, unpacking: Unpacking) -> Result<ParticleFile, ReadFault> {
    let source = Source::from(bytes);
    let head = 0..source.count().min(SNIFFED);
    if source.with(head, is_text) { table(source, unpacking) } else { read_raw(source) }
}

fn is_text(start: &[u8]) -> bool {
    let text = match std::str::from_utf8(start) {
        Ok(text) => text,
        // The last character may be cut off.
        Err(e) if e.error_len().is_none() => return is_text(&start[..e.valid_up_to()]),
        Err(_) => return false,
    };
    text.chars().all(|c| !c.is_control() || c.is_ascii_whitespace())
}

fn read_raw(source: Source) -> Result<ParticleFile, ReadFault> {
    const TRIPLE: usize = 12;
    let bytes = source.count();
    let rest = bytes % TRIPLE;
    if rest > 0 {
        let what = format!("{rest} bytes are left over; raw f32 positions take {TRIPLE} each");
        return Err(malformed(bytes - rest, what));
    }
    let rows = Rows::All(bytes / TRIPLE);
    let x = Column { offset: 0, stride: TRIPLE, scalar: Scalar::F32, endian: Endian::Little };
    let particles: ColumnStore =
        ColumnStore::new(source, rows, [0, 1, 2].map(|axis| x.component(axis)), Vec::new());
    Ok(ParticleFile::new(particles, "raw f32 .xyz"))
}

/// Reads a table of text, whatever its extension.
///
/// # Errors
/// [`ReadFault::Line`] for a row with a field too many or too few, for a field that is no number
/// where one is needed, and for a header that names no position; [`ReadFault::Scratch`] where the
/// scratch file fails.
pub fn read_text(bytes: Bytes, unpacking: Unpacking) -> Result<ParticleFile, ReadFault> {
    table(bytes.into(), unpacking)
}

fn table(source: Source, unpacking: Unpacking) -> Result<ParticleFile, ReadFault> {
    let table = Table::of(&source)?;
    let rows = table.rows(&source, unpacking)?;
    let width = table.slots.iter().flatten().count();
    let stride = width * size_of::<f64>();
    let first = Column { offset: 0, stride, scalar: Scalar::F64, endian: Endian::Little };
    let count = rows.len().checked_div(stride).unwrap_or(0);
    let mut slots = 3..;
    let attributes = table
        .attributes
        .into_iter()
        .map(|Quantity { name, columns }| {
            let columns: Vec<_> =
                slots.by_ref().take(columns.len()).map(|slot| first.component(slot)).collect();
            (AttributeInfo { name, components: columns.len() }, columns)
        })
        .collect();
    let position = [0, 1, 2].map(|axis| first.component(axis));
    let particles: ColumnStore = ColumnStore::new(rows, Rows::All(count), position, attributes);
    Ok(ParticleFile::new(particles, "text table"))
}

/// The table that the head of a text describes: where its rows start, and what their fields are.
struct Table {
    /// Bytes and lines above the first row.
    start: usize,
    lines_above: u64,
    separator: Separator,
    /// For every field of a row, its place among the numbers kept.
    slots: Vec<Option<usize>>,
    attributes: Vec<Quantity>,
}

/// A line that is no row of numbers.
struct Heading {
    line: u64,
    names: Vec<String>,
    quantities: Option<(Quantity, Vec<Quantity>)>,
}

impl Table {
    /// Finds the first row and the names of the columns in a text, of which no more is read than
    /// they are in.
    fn of(source: &Source) -> Result<Self, ReadFault> {
        let mut looked_at = HEAD;
        loop {
            let head = source.count().min(looked_at);
            let is_enough = |bytes: &[u8]| {
                // The last line may be cut off, and so may be the mark before the first.
                let known = lines(bytes).filter(|(.., content)| !content.starts_with(b"#"));
                head == source.count() || known.count() > HEADER_LINES + 2
            };
            let found = source.with(0..head, |bytes| is_enough(bytes).then(|| Self::find(bytes)));
            source.check().map_err(ReadFault::from)?;
            if let Some(found) = found {
                return found;
            }
            looked_at = looked_at.saturating_mul(2);
        }
    }

    /// Finds the first row and the names of the columns.
    fn find(bytes: &[u8]) -> Result<Self, ReadFault> {
        let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
        let (mut comment, mut title, mut names) = (None, None, None);
        let mut first = None;
        let mut left = HEADER_LINES;
        for (line, start, content) in lines(text) {
            if let Some(content) = content.strip_prefix(b"#") {
                comment = Some(Heading::read(line, content))
                    .filter(|h| h.quantities.is_some())
                    .or(comment);
                continue;
            }
            let row = is_row(content);
            if names.is_some() || row && title.is_none() {
                first = Some((line, start, content));
                break;
            }
            if row {
                // Under a title that names no position: perhaps the first row, perhaps more of the
                // title.
                first = first.or(Some((line, start, content)));
            } else {
                let heading = Heading::read(line, content);
                if heading.quantities.is_some() {
                    names = Some(heading);
                    first = None;
                } else if first.is_none() {
                    title = Some(heading);
                }
            }
            left -= 1;
            if left == 0 {
                break;
            }
        }
        let (line, start, row) = first.unwrap_or((1, text.len(), b""));
        let separator = Separator::of(row);
        let fields = Fields::new(row, separator).take(MOST_FIELDS + 1).count();
        let comment = comment.filter(|comment| first.is_none() || comment.names.len() == fields);
        let start = bytes.len() - text.len() + start;
        let table =
            |slots, attributes| Self { start, lines_above: line - 1, separator, slots, attributes };
        match names.or(comment).or(title) {
            Some(Heading { names, quantities: Some((position, attributes)), .. }) => {
                let mut slots = vec![None; names.len()];
                let kept =
                    position.columns.iter().chain(attributes.iter().flat_map(|a| &a.columns));
                for (slot, &column) in kept.enumerate() {
                    slots[column] = Some(slot);
                }
                Ok(table(slots, attributes))
            }
            Some(title) if first.is_none() || title.names.len() == fields => Err(title.refused()),
            _ if first.is_some() && !(3..=MOST_FIELDS).contains(&fields) => {
                let what = format!("{fields} fields where x, y and z are expected");
                Err(ReadFault::Line { line, what })
            }
            _ => Ok(table(
                (0..fields.max(3)).map(|field| (field < 3).then_some(field)).collect(),
                Vec::new(),
            )),
        }
    }

    /// Decodes all rows, in their order.
    fn rows(&self, source: &Source, unpacking: Unpacking) -> Result<Kept, ReadFault> {
        let mut rows = Unpacked::new(unpacking);
        let mut lines_above = self.lines_above;
        decode_windows(
            source,
            self.start..source.count(),
            |byte| byte == b'\n',
            |piece| self.decode(piece),
            |piece| {
                let (piece, lines) = piece
                    .map_err(|(line, what)| ReadFault::Line { line: lines_above + line, what })?;
                lines_above += lines;
                rows.push(&piece)?;
                Ok(ControlFlow::Continue(()))
            },
        )?;
        rows.finish()
    }

    /// The numbers of whole lines, and how many lines they were; or the line that is wrong, and
    /// how.
    fn decode(&self, chunk: &[u8]) -> Result<(Vec<u8>, u64), (u64, String)> {
        let width = self.slots.iter().flatten().count() * size_of::<f64>();
        let mut rows = Vec::new();
        for (line, _, content) in lines(chunk) {
            if content.starts_with(b"#") {
                continue;
            }
            let row = rows.len();
            rows.resize(row + width, 0);
            let mut fields = 0;
            for field in Fields::new(content, self.separator) {
                if let Some(&Some(slot)) = self.slots.get(fields) {
                    let number = number(field).ok_or_else(|| (line, not_a_number(field)))?;
                    rows[row + slot * size_of::<f64>()..][..size_of::<f64>()]
                        .copy_from_slice(&number.to_le_bytes());
                }
                fields += 1;
            }
            if fields != self.slots.len() {
                return Err((
                    line,
                    format!("{fields} fields where {} are expected", self.slots.len()),
                ));
            }
        }
        let lines = chunk.iter().filter(|&&byte| byte == b'\n').count();
        Ok((rows, lines as u64))
    }
}

impl Heading {
    fn read(line: u64, content: &[u8]) -> Self {
        let tabs = content.contains(&b'\t');
        let separator = match Separator::of(content) {
            Separator::Blanks if tabs => Separator::Byte(b'\t'),
            separator => separator,
        };
        let names: Vec<_> = Fields::new(content, separator)
            .take(MOST_FIELDS)
            .map(|name| String::from_utf8_lossy(name).into_owned())
            .collect();
        let quantities = quantities(&names);
        Self { line, names, quantities }
    }

    fn refused(&self) -> ReadFault {
        let shown: Vec<_> =
            self.names.iter().take(8).map(|name| excerpt(name.as_bytes())).collect();
        let what = format!(
            "neither three numbers nor the names of columns x, y and z: {}",
            shown.join(", ")
        );
        ReadFault::Line { line: self.line, what }
    }
}

/// The separator between the fields of a row.
#[derive(Clone, Copy)]
enum Separator {
    Byte(u8),
    /// Any number of them.
    Blanks,
}

impl Separator {
    fn of(line: &[u8]) -> Self {
        [b';', b','].into_iter().find(|byte| line.contains(byte)).map_or(Self::Blanks, Self::Byte)
    }
}

/// The fields of a line, trimmed, up to a comment. A separator at the end of the line opens no
/// further field.
struct Fields<'a> {
    rest: &'a [u8],
    separator: Separator,
}

impl<'a> Fields<'a> {
    fn new(line: &'a [u8], separator: Separator) -> Self {
        Self { rest: line.trim_ascii_start(), separator }
    }
}

impl<'a> Iterator for Fields<'a> {
    type Item = &'a [u8];

    fn next(&mut self) -> Option<&'a [u8]> {
        if matches!(self.rest.first(), None | Some(b'#')) {
            return None;
        }
        let ends = |byte: u8| match self.separator {
            Separator::Byte(separator) => byte == separator,
            Separator::Blanks => byte.is_ascii_whitespace(),
        };
        let (field, rest) = match self.rest.iter().position(|&byte| ends(byte) || byte == b'#') {
            Some(end) if self.rest[end] == b'#' => self.rest.split_at(end),
            Some(end) => (&self.rest[..end], &self.rest[end + 1..]),
            None => (self.rest, &[][..]),
        };
        self.rest = rest.trim_ascii_start();
        Some(field.trim_ascii_end())
    }
}

/// The lines that are not blank: number from 1, first byte, trimmed content.
fn lines(text: &[u8]) -> impl Iterator<Item = (u64, usize, &[u8])> {
    let mut start = 0;
    let lines = text.split_inclusive(|&byte| byte == b'\n').zip(1..).map(move |(content, line)| {
        let begin = start;
        start += content.len();
        (line, begin, content.trim_ascii())
    });
    lines.filter(|(.., content)| !content.is_empty())
}

/// Whether a line begins with as many numbers as a position has, or holds nothing but numbers.
fn is_row(line: &[u8]) -> bool {
    Fields::new(line, Separator::of(line)).take(3).all(|field| number(field).is_some())
}

fn number(field: &[u8]) -> Option<f64> {
    std::str::from_utf8(field).ok()?.parse().ok()
}

fn not_a_number(field: &[u8]) -> String {
    format!("{} is not a number", excerpt(field))
}

/// Returns the part of a field that messages show, in quotes.
fn excerpt(field: &[u8]) -> String {
    format!("{:?}", String::from_utf8_lossy(&field[..field.len().min(40)]))
}

//! Reads XYZ text, and raw f32 triples without a header that use the same extension.
//!
//! A frame in text consists of the number of particles, a comment, and a row per particle. The
//! comment may name the columns, either as in extended XYZ (`Properties=species:S:1:pos:R:3`) or in
//! a list of names. Otherwise, the position is the first three numbers of a row. If the row begins
//! with the name or atomic number of an element, the position follows it. `sim.xyz#3` is the fourth
//! frame.

use super::bytes::{ByteView, Bytes, Unpacking};
use super::columns::{Column, ColumnStore, Endian, ParticleRows, Scalar};
use super::names::{Quantity, repeated_position};
use super::number::{ParseNumber, is_length};
use super::table::{
    HEAD, Separator, Syntax, TableColumns, TextTable, columns_in_comment, excerpt, is_row,
    names_of, unnamed_columns,
};
use super::text::{LinePlace, TextLines};
use super::wanted::WantedAttributes;
use super::windows::{InputBytes, Windows};
use super::{ParticleFile, ReadFault, malformed};

/// Number of raw bytes that are sampled to distinguish f64 from f32.
const SAMPLED: usize = 4080;

/// Reads raw little-endian f32 triples.
///
/// # Errors
/// [`ReadFault::Malformed`] for an incomplete triple at the end, and [`ReadFault::Unsupported`] for
/// f64.
pub(super) fn read_raw(bytes: Bytes) -> Result<ParticleFile, ReadFault> {
    const TRIPLE: usize = 12;
    let source = InputBytes::from(bytes);
    let bytes = source.count();
    let rest = bytes % TRIPLE;
    if rest > 0 {
        let what = format!(
            "{rest} extra bytes at the end; each position must have {TRIPLE} bytes (three 32-bit \
             floats)"
        );
        return Err(malformed(bytes - rest, what));
    }
    if bytes.is_multiple_of(2 * TRIPLE) && source.with(0..bytes.min(SAMPLED), are_f64) {
        let what = "the numbers look like 64-bit floats, but a raw .xyz needs 32-bit floats; \
                    convert them";
        return Err(ReadFault::Unsupported(what.to_owned()));
    }
    let rows = ParticleRows::All(bytes / TRIPLE);
    let x = Column { offset: 0, stride: TRIPLE, scalar: Scalar::F32, endian: Endian::Little };
    let particles: ColumnStore =
        ColumnStore::new(source, rows, [0, 1, 2].map(|axis| x.component(axis)), Vec::new());
    Ok(ParticleFile::new(particles, "raw f32 .xyz"))
}

/// Whether raw numbers are probably f64. All of them must be plausible lengths if they are read as
/// f64, and many must be implausible if they are read as f32. The lower half of an f64, read as an
/// f32, has an arbitrary magnitude.
fn are_f64(raw: &[u8]) -> bool {
    let wide = raw.as_chunks().0.iter().map(|&bytes| f64::from_le_bytes(bytes));
    let narrow = raw.as_chunks().0.iter().map(|&bytes| f64::from(f32::from_le_bytes(bytes)));
    let far = narrow.filter(|&number| !is_length(number)).count();
    // Require many implausible numbers, because a few particles may have flown far away.
    wide.into_iter().all(is_length) && far * 8 > raw.len() / size_of::<f32>()
}

/// A frame of a text file.
struct XyzFrame {
    /// The number of particles that the frame announces.
    count: u64,
    comment: String,
    /// The number of rows that the frame contains.
    rows: u64,
    start: usize,
    end: usize,
    lines_above: u64,
}

/// Whether a text starts with the number of its particles, as a frame does.
///
/// In a frame, a comment separates the number from the rows. If instead exactly this number of
/// rows, and nothing else, follows the number directly, the number is the title of a table.
///
/// If a line of column names follows the number, the line may be the comment of a frame. This is
/// the case if exactly this number of rows follows the names, before the next frame or the end of
/// the text. Otherwise, the number is the title of a table.
///
/// # Errors
/// Errors from reading the text.
pub(super) fn has_count(view: ByteView) -> Result<bool, ReadFault> {
    let mut lines = TextLines::new(view)?;
    let count = lines.line().ok().flatten().and_then(|line| count_of(&line));
    let Some(count) = count else { return Ok(false) };
    let Ok(Some(second)) = lines.line() else { return Ok(true) };
    let is_row = is_row(second.as_bytes());
    let names_columns = || TableColumns::of(names_in(&second)).is_some();
    if !is_row && !names_columns() {
        return Ok(true);
    }
    let rows = lines.skip(count)?;
    Ok(match is_row {
        true => rows + 1 != count,
        false => rows == count && lines.line()?.is_none_or(|line| count_of(&line).is_some()),
    })
}

/// Parses the number of particles, in a line that contains nothing else.
fn count_of(line: &str) -> Option<u64> {
    line.bytes().all(|byte| byte.is_ascii_digit()).then(|| line.parse().ok())?
}

/// The names of columns in a frame's comment.
fn names_in(comment: &str) -> Vec<String> {
    let comment = without_marks(comment).as_bytes();
    names_of(comment, Separator::of(comment))
}

fn without_marks(comment: &str) -> &str {
    comment.trim_start_matches(['#', '%', '!', '/'])
}

/// Skips a frame. Returns false at the end of the file.
///
/// # Errors
/// [`ReadFault::Line`] for an invalid line between frames.
pub(super) fn skip_frame(lines: &mut TextLines) -> Result<bool, ReadFault> {
    Ok(XyzFrame::next(lines)?.is_some())
}

/// Reads the frame that starts at `place`.
///
/// # Errors
/// [`ReadFault::Line`] for an invalid line, an incomplete frame, or columns without a position, and
/// [`ReadFault::Unsupported`] for integer columns without names.
pub(super) fn read(
    bytes: Bytes,
    place: LinePlace,
    wanted: WantedAttributes,
    unpacking: Unpacking,
) -> Result<ParticleFile, ReadFault> {
    let view = bytes.view();
    let mut lines = TextLines::at(view, place)?;
    let frame = XyzFrame::next(&mut lines)?;
    let frame = frame.ok_or_else(|| lines.fault("expected the number of particles"))?;
    view.check()?;
    frame.read(bytes, wanted, unpacking)
}

impl XyzFrame {
    /// Reads the header of a frame and skips its rows. `None` at the end of the file.
    fn next(lines: &mut TextLines) -> Result<Option<Self>, ReadFault> {
        let line = loop {
            match lines.line()? {
                None => return Ok(None),
                Some(line) if line.is_empty() => {}
                Some(line) => break line,
            }
        };
        let count = count_of(&line).ok_or_else(|| {
            let found = excerpt(line.as_bytes());
            lines.fault(format!("expected the number of particles, found {found}"))
        })?;
        let comment = lines.line()?.unwrap_or_default();
        let LinePlace { at: start, lines_above } = lines.place();
        let rows = lines.skip(count)?;
        let end = lines.place().at;
        Ok(Some(Self { count, comment, rows, start, end, lines_above }))
    }

    fn read(
        self,
        bytes: Bytes,
        wanted: WantedAttributes,
        unpacking: Unpacking,
    ) -> Result<ParticleFile, ReadFault> {
        let Self { count, comment, rows, start, end, lines_above } = self;
        if rows < count {
            let what = format!("the frame ends after {rows} of {count} particles");
            return Err(ReadFault::Line { line: lines_above + rows, what });
        }
        let head = bytes.view().read(start..end.min(start + HEAD))?.into_owned();
        let (syntax, columns) = match value(&comment, "Properties") {
            Some(properties) => {
                let columns = columns_of(properties)
                    .map_err(|what| ReadFault::Line { line: lines_above, what })?;
                (Syntax::BLANKS, columns)
            }
            None => match unnamed_columns(&head)? {
                Some((syntax, mut columns)) => {
                    if let Some(element) = columns.position.columns[0].checked_sub(1) {
                        let (name, columns_of) = ("element".to_owned(), vec![element]);
                        columns.attributes.push(Quantity { name, columns: columns_of });
                    }
                    let names = names_in(&comment);
                    let named = names.len() == columns.names.len();
                    if let Some(name) = repeated_position(&names).filter(|_| named) {
                        let what = format!("several columns have the name {name:?}; rename them");
                        return Err(ReadFault::Line { line: lines_above, what });
                    }
                    let mut named = columns_in_comment(without_marks(&comment));
                    let named = named.find(|named| named.names.len() == columns.names.len());
                    (syntax, named.unwrap_or(columns))
                }
                None if rows == 0 => (Syntax::BLANKS, TableColumns::unnamed(0, 3)),
                None => {
                    let row = head.split(|&byte| byte == b'\n').next().unwrap_or_default();
                    let what = format!("expected three numbers x, y and z, found {}", excerpt(row));
                    return Err(ReadFault::Line { line: lines_above + 1, what });
                }
            },
        };
        let table = TextTable {
            rows: start..end,
            lines_above,
            syntax,
            columns,
            count: Some(count),
            announced: None,
            cell: None,
        };
        let file = table.read(bytes, wanted, unpacking, "XYZ")?;
        let time = value(&comment, "Time").and_then(|time| f64::of(time.as_bytes()));
        let box_size = value(&comment, "Lattice").and_then(box_of);
        Ok(ParticleFile { time, box_size, ..file })
    }
}

/// The value of `key` in a comment of extended XYZ, such as `Time=0.5` or `Lattice="1 0 0 ..."`.
fn value<'a>(comment: &'a str, key: &str) -> Option<&'a str> {
    let lower = comment.to_ascii_lowercase();
    let start =
        lower.match_indices(&format!("{}=", key.to_ascii_lowercase())).find_map(|(at, _)| {
            let begins = at == 0 || comment.as_bytes()[at - 1].is_ascii_whitespace();
            begins.then_some(at + key.len() + 1)
        })?;
    let rest = &comment[start..];
    match rest.strip_prefix('"') {
        Some(quoted) => quoted.split('"').next(),
        None => rest.split_ascii_whitespace().next(),
    }
}

/// Parses the columns of a property list such as `species:S:1:pos:R:3`.
fn columns_of(properties: &str) -> Result<TableColumns, String> {
    /// Maximum number of columns of a property.
    const MOST: usize = 64;
    let shown = || format!("Properties={}", excerpt(properties.as_bytes()));
    let parts: Vec<&str> = properties.split(':').collect();
    let mut names = Vec::new();
    for part in parts.chunks(3) {
        let &[name, _, count] = part else {
            return Err(format!("{} must be triples of name, type and number", shown()));
        };
        let count = count.parse().ok().filter(|count| (1..=MOST).contains(count));
        let count = count.ok_or_else(|| format!("{}: {name} has no number of columns", shown()))?;
        // ASE calls the velocity `velo`.
        let name = if name == "velo" { "velocity" } else { name };
        match count {
            1 => names.push(name.to_owned()),
            _ => names.extend((0..count).map(|component| format!("{name}:{component}"))),
        }
    }
    TableColumns::of(names).ok_or_else(|| format!("{} does not contain pos:R:3", shown()))
}

/// The edge lengths of the box, from the nine components of its vectors. `None` if the box is not
/// aligned to the axes.
fn box_of(lattice: &str) -> Option<[f64; 3]> {
    let numbers = lattice.split_ascii_whitespace().map(|word| f64::of(word.as_bytes()));
    let vectors: [f64; 9] = numbers.collect::<Option<Vec<f64>>>()?.try_into().ok()?;
    let is_along = (0..9).all(|i| i % 4 == 0 || vectors[i] == 0.0);
    is_along.then_some([vectors[0], vectors[4], vectors[8]])
}

//! Reads Tecplot text files with one zone of points. Values are ordered point by point or variable
//! by variable ("Data Format Guide", Tecplot 360).

use std::ops::{ControlFlow, Range};

use crate::particles::AttributeInfo;

use super::bytes::{Bytes, PrivateBytes, UnpackBuffer, Unpacking};
use super::columns::{Column, ColumnStore, Endian, ParticleRows, Scalar};
use super::error::ADD_Z;
use super::names::repeated_position;
use super::number::ParseNumber;
use super::table::{TableColumns, excerpt, name_plane};
use super::text::{LinePlace, TextLines, decode_windows};
use super::windows::{InputBytes, Windows};
use super::{ParticleFile, ReadFault};

/// Size of a number in bytes.
const WIDTH: usize = size_of::<f64>();

/// Maximum number of zones that a message lists.
const ZONES_SHOWN: usize = 8;
/// Number of bytes of a zone's first line that are examined.
const LONGEST_RECORD: usize = 1 << 10;

/// First words of the records in a header.
const KEYWORDS: [&str; 11] = [
    "TITLE",
    "VARIABLES",
    "ZONE",
    "FILETYPE",
    "DATASETAUXDATA",
    "VARAUXDATA",
    "AUXDATA",
    "VARIABLE",
    "TEXT",
    GEOMETRY,
    "CUSTOMLABELS",
];
/// First word of a record that contains lines of numbers.
const GEOMETRY: &str = "GEOMETRY";

/// The order of a zone's values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ZonePacking {
    Point,
    Block,
}

/// A zone, with the properties that its header gives.
#[derive(Debug, Default)]
struct Zone {
    /// Numbers of points along I, J and K.
    points: [Option<usize>; 3],
    packing: Option<ZonePacking>,
    time: Option<f64>,
}

/// Whether the start of a text consists of Tecplot records.
pub(super) fn is_tecplot(head: &[u8]) -> bool {
    let head = String::from_utf8_lossy(head);
    let mut lines = head.lines().map(str::trim).filter(|line| !line.is_empty());
    let mut records = lines.by_ref().take_while(|line| {
        let is_known = keyword(line).is_some();
        is_known || line.starts_with(['#', '"'])
    });
    records.any(|line| match keyword(line) {
        Some(("VARIABLES", rest)) => rest.starts_with('='),
        Some(("ZONE", rest)) => rest.is_empty() || rest.contains('='),
        _ => false,
    })
}

/// Splits a line into the keyword at its start and the rest. `None` for other lines.
fn keyword(line: &str) -> Option<(&'static str, &str)> {
    let line = line.trim_start_matches('\u{feff}');
    let word = line.split(|c: char| c == '=' || c.is_ascii_whitespace()).next()?;
    let known = KEYWORDS.into_iter().find(|known| word.eq_ignore_ascii_case(known))?;
    Some((known, line[word.len()..].trim_start()))
}

/// Reads the only zone of a file.
///
/// # Errors
/// [`ReadFault::Unsupported`] if the order of values is not specified. [`ReadFault::Line`] for
/// several zones, for elements or shared variables, for an invalid line, and for a wrong number of
/// values.
pub(super) fn read(bytes: Bytes, unpacking: Unpacking) -> Result<ParticleFile, ReadFault> {
    let mut lines = TextLines::new(bytes.view())?;
    let mut names = Vec::new();
    let mut zone = Zone::default();
    let mut record = "";
    let (start, lines_above) = loop {
        let LinePlace { at: start, lines_above } = lines.place();
        let Some(line) = lines.line()? else {
            return Err(lines.fault("the file ends within its header"));
        };
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let rest = match keyword(&line) {
            Some((keyword, rest)) => {
                record = keyword;
                rest
            }
            None if record != GEOMETRY
                && line.split([' ', '\t', ',']).next().is_some_and(is_number) =>
            {
                break (start, lines_above);
            }
            None => line.as_str(),
        };
        let result = match record {
            "VARIABLES" => {
                names.extend(variables(rest.strip_prefix('=').unwrap_or(rest)));
                Ok(())
            }
            "ZONE" => zone.parse_header_line(rest),
            _ => Ok(()),
        };
        result.map_err(|what| lines.fault(what))?;
    };
    let shown = names.join(", ");
    let repeated = repeated_position(&names).map(str::to_owned);
    let is_plane = name_plane(&names);
    let Some(columns) = TableColumns::of(names) else {
        let what = match repeated {
            Some(name) => format!("several VARIABLES are named {name:?}; rename all but one"),
            None if is_plane => format!("no VARIABLES x, y and z among {shown:?}; {ADD_Z}"),
            None => format!("no VARIABLES x, y and z among {shown:?}"),
        };
        return Err(ReadFault::Line { line: lines_above.max(1), what });
    };
    let width = columns.names.len();
    let end = bytes.view().len();
    let source = InputBytes::from(bytes);
    let numbers = decode(&source, start..end, lines_above, unpacking)?;
    let numbers = match numbers {
        Ok(numbers) => numbers,
        Err(line) => {
            let zones = zones_of(&source)?;
            let shown: Vec<_> = zones.iter().take(ZONES_SHOWN).map(|zone| zone.as_str()).collect();
            let more = if zones.len() > ZONES_SHOWN { " and more" } else { "" };
            let what = format!(
                "another zone begins here; the file has {} zones: {}{more}. Write each zone of \
                 particles to its own file",
                zones.len(),
                shown.join(", ")
            );
            return Err(ReadFault::Line { line, what });
        }
    };
    let count = numbers.len() / WIDTH;
    let wrong = |what| Err(ReadFault::Line { line: lines_above.max(1), what });
    let points = match zone.points {
        [None, None, None] if count.is_multiple_of(width) => count / width,
        [None, None, None] => {
            return wrong(format!(
                "the zone has {count} values, which is not a multiple of its {width} variables"
            ));
        }
        points => {
            let product = points.iter().flatten().try_fold(1_usize, |all, n| all.checked_mul(*n));
            match product.filter(|points| points.checked_mul(width) == Some(count)) {
                Some(points) => points,
                None => {
                    let sizes: Vec<_> = points.iter().flatten().map(usize::to_string).collect();
                    let points = sizes.join(" x ");
                    return wrong(format!(
                        "the zone has {count} values, but announces {points} points of {width} \
                         variables"
                    ));
                }
            }
        }
    };
    // If the header gives neither the order of the values nor the number of points along I, the
    // reader assumes that the values are ordered point by point.
    let packing = match (zone.packing, zone.points[0]) {
        (Some(packing), _) => packing,
        (None, None) => ZonePacking::Point,
        (None, Some(_)) => {
            let what = "the zone does not define the order of its values; add DATAPACKING=POINT \
                        or DATAPACKING=BLOCK";
            return Err(ReadFault::Unsupported(what.to_owned()));
        }
    };
    let column = |variable: &usize| {
        let (offset, stride) = match packing {
            ZonePacking::Point => (variable * WIDTH, width * WIDTH),
            ZonePacking::Block => (variable * points * WIDTH, WIDTH),
        };
        Column { offset, stride, scalar: Scalar::F64, endian: Endian::Little }
    };
    let position = [0, 1, 2].map(|axis| column(&columns.position.columns[axis]));
    let attributes = columns.attributes.iter().map(|attribute| {
        let components = attribute.columns.len();
        let info = AttributeInfo::new(&attribute.name, components);
        (info, attribute.columns.iter().map(column).collect())
    });
    let attributes = attributes.collect();
    let store: ColumnStore =
        ColumnStore::new(numbers, ParticleRows::All(points), position, attributes);
    Ok(ParticleFile { time: zone.time, ..ParticleFile::new(store, "Tecplot") })
}

fn is_number(word: &str) -> bool {
    f64::of(word.as_bytes()).is_some()
}

/// Parses the names of variables, which are quoted or separated by spaces, tabs or commas.
fn variables(text: &str) -> Vec<String> {
    let mut names = Vec::new();
    let mut rest = text;
    loop {
        rest = rest.trim_start_matches([' ', '\t', ',']);
        let (name, after) = match rest.chars().next() {
            None => return names,
            Some(quote @ ('"' | '\'')) => rest[1..].split_once(quote).unwrap_or((&rest[1..], "")),
            Some(_) => {
                let end = rest.find([' ', '\t', ',']).unwrap_or(rest.len());
                rest.split_at(end)
            }
        };
        names.push(name.to_owned());
        rest = after;
    }
}

impl Zone {
    /// Parses a line of the zone's header.
    fn parse_header_line(&mut self, text: &str) -> Result<(), String> {
        let mut rest = text;
        loop {
            rest = rest.trim_start_matches([' ', '\t', ',']);
            let Some((key, after)) = rest.split_once('=') else {
                return if rest.is_empty() {
                    Ok(())
                } else {
                    Err(format!("{} is not a valid zone property", excerpt(rest.as_bytes())))
                };
            };
            let after = after.trim_start();
            let (value, after) = match after.chars().next() {
                Some('"') => after[1..].split_once('"').unwrap_or((&after[1..], "")),
                Some('(') => after[1..].split_once(')').unwrap_or((&after[1..], "")),
                _ => after.split_at(after.find([' ', '\t', ',']).unwrap_or(after.len())),
            };
            self.set_property(&key.trim().to_ascii_uppercase(), value)?;
            rest = after;
        }
    }

    fn set_property(&mut self, key: &str, value: &str) -> Result<(), String> {
        let upper = value.to_ascii_uppercase();
        match (key, &*upper) {
            ("I" | "J" | "K", _) => {
                let axis = usize::from(key.as_bytes()[0] - b'I');
                let points = value.parse().map_err(|_| format!("{key}={value} is not a number"))?;
                self.points[axis] = Some(points);
            }
            ("F" | "DATAPACKING", "POINT") => self.packing = Some(ZonePacking::Point),
            ("F" | "DATAPACKING", "BLOCK") => self.packing = Some(ZonePacking::Block),
            ("ZONETYPE", "ORDERED") => {}
            ("F" | "DATAPACKING" | "ZONETYPE" | "N" | "NODES" | "E" | "ELEMENTS", _) => {
                return Err(format!(
                    "the zone has {key}={value}, but only zones of points are supported"
                ));
            }
            ("VARLOCATION" | "VARSHARELIST" | "PASSIVEVARLIST", _) => {
                return Err(format!(
                    "the zone has {key}, but each variable needs a value at each point"
                ));
            }
            ("SOLUTIONTIME", _) => self.time = f64::of(value.as_bytes()),
            _ => {}
        }
        Ok(())
    }
}

/// The titles of all zones, with a replacement for missing titles.
fn zones_of(source: &InputBytes) -> Result<Vec<String>, ReadFault> {
    let title = |line: &[u8]| {
        let line = String::from_utf8_lossy(line.get(..LONGEST_RECORD).unwrap_or(line));
        let (_, rest) = keyword(line.trim()).filter(|(keyword, _)| *keyword == "ZONE")?;
        let upper = rest.to_ascii_uppercase();
        let begin = ["T=", "T ="].iter().find_map(|key| Some(upper.find(key)? + key.len()));
        let quoted = begin.and_then(|begin| rest[begin..].trim_start().strip_prefix('"'));
        let title = quoted.and_then(|title| title.split('"').next());
        Some(title.map_or("one without a title".to_owned(), |title| format!("{title:?}")))
    };
    let mut zones = Vec::new();
    let lines = |piece: &[u8]| piece.split(|&b| b == b'\n').filter_map(title).collect::<Vec<_>>();
    decode_windows(
        source,
        0..source.count(),
        |byte| byte == b'\n',
        lines,
        |titles| {
            zones.extend(titles);
            Ok(ControlFlow::Continue(()))
        },
    )?;
    Ok(zones)
}

/// Decodes the numbers of a range. If another zone starts within the range, returns the number of
/// its first line as the inner error.
fn decode(
    source: &InputBytes,
    range: Range<usize>,
    lines_above: u64,
    unpacking: Unpacking,
) -> Result<Result<PrivateBytes, u64>, ReadFault> {
    let is_end = |byte: u8| byte.is_ascii_whitespace() || byte == b',';
    let decode = |piece: &[u8]| {
        let mut numbers = Vec::new();
        let mut words = piece.split(|&byte| is_end(byte)).filter(|word| !word.is_empty());
        let wrong = words.find(|word| {
            let number = f64::of(word);
            numbers.extend(number.unwrap_or_default().to_le_bytes());
            number.is_none()
        });
        let lines = |text: &[u8]| text.iter().filter(|&&byte| byte == b'\n').count() as u64;
        match wrong {
            None => Ok((numbers, lines(piece))),
            Some(word) => {
                let at = word.as_ptr() as usize - piece.as_ptr() as usize;
                Err((1 + lines(&piece[..at]), word.to_vec()))
            }
        }
    };
    let mut lines_decoded = lines_above;
    let mut numbers = UnpackBuffer::new(unpacking);
    let mut other_zone = None;
    /// First words of the records with which another zone can begin.
    const ZONE_STARTS: [&[u8]; 6] =
        [b"ZONE", b"TITLE", b"TITLE=", b"VARIABLES", b"VARIABLES=", b"DATASETAUXDATA"];
    decode_windows(source, range, is_end, decode, |piece| {
        if let Err((line, word)) = &piece
            && ZONE_STARTS.contains(&&*word.to_ascii_uppercase())
        {
            other_zone = Some(lines_decoded + line);
            return Ok(ControlFlow::Break(()));
        }
        let (piece, lines) = piece.map_err(|(line, word)| {
            let what = match &*word.to_ascii_uppercase() {
                repeated if repeated.contains(&b'*') && f64::of(repeated).is_none() => {
                    format!("{}: repeated values are not supported", excerpt(&word))
                }
                _ => format!("{} is not a number", excerpt(&word)),
            };
            ReadFault::Line { line: lines_decoded + line, what }
        })?;
        lines_decoded += lines;
        numbers.push(&piece)?;
        Ok(ControlFlow::Continue(()))
    })?;
    other_zone.map_or_else(|| numbers.finish().map(Ok), |line| Ok(Err(line)))
}

//! Text files of particles: the format of one by its content, and its frames.
//!
//! | format | recognised by | frames |
//! |---|---|---|
//! | LAMMPS dump | a first line that begins with `ITEM:` | its steps |
//! | Tecplot | lines that begin with `VARIABLES` or `ZONE` | one |
//! | XYZ | the number of particles alone on the first line | its frames, from 0 |
//! | table | anything else | one |
//!
//! UTF-16 with a byte order mark is decoded first.

use std::path::Path;

use super::bytes::{Bytes, Unpacking, View};
use super::input_format::InputFormat;
use super::text::{TextLines, utf8};
use super::wanted::{Wanted, WantedAttributes};
use super::{ParticleFile, ReadError, ReadFault, lammps, table, tecplot, xyz};

/// Bytes by which formats are told apart.
const SNIFFED: usize = 4 << 10;

enum TextFormat {
    Lammps,
    Tecplot,
    Xyz,
    Raw,
    Table,
}

impl TextFormat {
    fn of(bytes: View, named: Option<InputFormat>) -> Result<Self, ReadFault> {
        let head = bytes.read(0..bytes.len().min(SNIFFED))?;
        if is_text(&head) && head.contains(&b'\r') && !head.contains(&b'\n') {
            let what = "its lines end in CR alone, as on old Macs; convert their ends to LF";
            return Err(ReadFault::Unsupported(what.to_owned()));
        }
        Ok(if named == Some(InputFormat::Xyz) && !is_text(&head) {
            Self::Raw
        } else if named == Some(InputFormat::Lammps) || lammps::is_dump(&head) {
            Self::Lammps
        } else if tecplot::is_tecplot(&head) {
            Self::Tecplot
        } else if xyz::has_count(bytes)? {
            Self::Xyz
        } else {
            Self::Table
        })
    }
}

/// Whether bytes are text, of which the last character may be cut off.
fn is_text(start: &[u8]) -> bool {
    let text = match std::str::from_utf8(start) {
        Ok(text) => text,
        Err(e) if e.error_len().is_none() => return is_text(&start[..e.valid_up_to()]),
        Err(_) => return false,
    };
    text.chars().all(|c| !c.is_control() || c.is_ascii_whitespace())
}

/// Decodes UTF-16, unless a file that may hold raw numbers looks like them.
fn decoded(
    bytes: Bytes,
    named: Option<InputFormat>,
    unpacking: Unpacking,
) -> Result<Bytes, ReadFault> {
    if named == Some(InputFormat::Xyz) {
        let view = bytes.view();
        let head = view.read(0..view.len().min(SNIFFED) / 2 * 2)?.into_owned();
        let head = utf8(head.into(), Unpacking::in_memory())?;
        if !is_text(&head.view().read(0..head.view().len())?) {
            return Ok(bytes);
        }
    }
    utf8(bytes, unpacking)
}

/// Reads a frame of a text file, or its only one. In an .xyz, bytes that are no text are raw
/// little-endian f32 triples.
///
/// # Errors
/// [`ReadFault::Line`] for a line that does not parse; [`ReadFault::Unsupported`] where a frame has
/// to be chosen or is not there; [`ReadFault::Malformed`] for raw bytes that are not whole triples;
/// [`ReadFault::Scratch`] where the scratch file fails.
pub fn read_particles(
    bytes: Bytes,
    format: Option<InputFormat>,
    step: Option<u64>,
    wanted: WantedAttributes,
    unpacking: Unpacking,
) -> Result<ParticleFile, ReadFault> {
    let bytes = decoded(bytes, format, unpacking)?;
    match (TextFormat::of(bytes.view(), format)?, step) {
        (TextFormat::Lammps, step) => lammps::read(bytes, step, wanted, unpacking),
        (TextFormat::Xyz, step) => xyz::read(bytes, step, wanted, unpacking),
        (TextFormat::Tecplot | TextFormat::Raw | TextFormat::Table, Some(step)) => {
            Err(ReadFault::Unsupported(format!("it holds one frame, and no step {step}")))
        }
        (TextFormat::Tecplot, None) => tecplot::read(bytes, unpacking),
        (TextFormat::Raw, None) => xyz::read_raw(bytes),
        (TextFormat::Table, None) => {
            let start = TextLines::new(bytes.view())?.at();
            table::read(bytes, start, wanted, unpacking)
        }
    }
}

/// Reads a frame of the file at `path`, like [`read_particles`].
///
/// # Errors
/// As [`read_particles`].
pub(super) fn open_particles(
    path: &Path,
    bytes: Bytes,
    step: Option<u64>,
    wanted: Wanted,
    unpacking: Unpacking,
) -> Result<ParticleFile, ReadError> {
    let format = wanted.format.or_else(|| InputFormat::of(path));
    read_particles(bytes, format, step, wanted.attributes, unpacking)
        .map_err(|fault| ReadError::new(path, fault))
}

/// The numbers of the frames in a file, in order; none in a file that is one frame.
///
/// # Errors
/// [`ReadFault::Line`] for a file of several that does not parse.
pub fn steps(bytes: Bytes, format: InputFormat) -> Result<Vec<u64>, ReadFault> {
    let bytes = decoded(bytes, Some(format), Unpacking::in_memory())?;
    match TextFormat::of(bytes.view(), Some(format))? {
        TextFormat::Lammps => lammps::steps(bytes.view()),
        TextFormat::Xyz => xyz::steps(bytes.view()),
        TextFormat::Tecplot | TextFormat::Raw | TextFormat::Table => Ok(Vec::new()),
    }
}

//! Reads text files of particles. Detects the format from the content, and finds the frames.
//!
//! | format | recognised by | frames |
//! |---|---|---|
//! | LAMMPS dump | a first line that begins with `ITEM:` | its steps, by their numbers |
//! | Tecplot | lines that begin with `VARIABLES` or `ZONE` | one |
//! | XYZ | a first line that contains only the number of particles | its frames, numbered from 0 |
//! | table | anything else | one |
//!
//! If the caller names a format, the reader uses this format. As an exception, a file that the
//! caller names as XYZ may turn out to be a table or raw numbers. UTF-16 with a byte order mark is
//! decoded first.

use std::path::Path;
use std::sync::Arc;

use crate::system::reopened::FileStamp;

use super::bytes::{ByteView, Bytes, LastFile, Unpacking};
use super::error::{no_step, several_steps};
use super::input_format::InputFormat;
use super::text::{LinePlace, TextLines, utf8};
use super::wanted::WantedAttributes;
use super::{ParticleFile, ReadFault, UnreadPart, lammps, table, tecplot, xyz};

/// Number of bytes at the start of a file from which the format is detected.
const SNIFFED: usize = 4 << 10;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum TextFormat {
    Lammps,
    Tecplot,
    Xyz,
    Raw,
    Table,
}

/// The expected format of a text file, before its content is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TextHint {
    /// The format that the file's extension implies. The content may turn out to be in another
    /// format.
    Extension(Option<InputFormat>),
    /// The format that the caller named.
    Named(InputFormat),
}

impl TextHint {
    /// The format that the caller named, or else the format that the extension implies.
    pub fn of(path: &Path, named: Option<InputFormat>) -> Self {
        named.map_or_else(|| Self::Extension(InputFormat::of(path)), Self::Named)
    }

    /// Whether the file may contain raw numbers instead of text.
    fn may_be_raw(self) -> bool {
        matches!(self, Self::Extension(Some(InputFormat::Xyz)) | Self::Named(InputFormat::Xyz))
    }
}

impl TextFormat {
    fn of(bytes: ByteView, hint: TextHint) -> Result<Self, ReadFault> {
        let head = bytes.read(0..bytes.len().min(SNIFFED))?;
        if is_text(&head) && head.contains(&b'\r') && !head.contains(&b'\n') {
            let what = "lines end in CR only, as on old Macs; convert them to LF";
            return Err(ReadFault::Unsupported(what.to_owned()));
        }
        if hint.may_be_raw() && !is_text(&head) {
            return Ok(Self::Raw);
        }
        use InputFormat::{Csv, Lammps, Tecplot, Xyz};
        let (by_extension, named) = match hint {
            TextHint::Extension(format) => (format, None),
            TextHint::Named(format) => (None, Some(format)),
        };
        Ok(match named {
            Some(Csv) => Self::Table,
            Some(Lammps) => Self::Lammps,
            Some(Tecplot) => Self::Tecplot,
            None if by_extension == Some(Lammps) || lammps::is_dump(&head) => Self::Lammps,
            None if tecplot::is_tecplot(&head) => Self::Tecplot,
            // An .xyz may also be a table of positions, without the number of particles on the
            // first line.
            None | Some(Xyz) if xyz::has_count(bytes)? => Self::Xyz,
            _ => Self::Table,
        })
    }

    /// Skips one frame and returns its number. `before` is the number of frames above it. Returns
    /// `None` at the end of the text.
    fn skip_frame(self, lines: &mut TextLines, before: u64) -> Result<Option<u64>, ReadFault> {
        match self {
            Self::Lammps => lammps::skip_step(lines),
            Self::Xyz => Ok(xyz::skip_frame(lines)?.then_some(before)),
            Self::Tecplot | Self::Raw | Self::Table => Ok(None),
        }
    }
}

/// The starts of all frames in a text.
#[derive(Debug)]
struct Frames {
    format: TextFormat,
    /// Number and start of each frame, in file order.
    all: Vec<(u64, LinePlace)>,
    /// The start of the first invalid frame. `None` if all frames are valid.
    broken: Option<LinePlace>,
}

impl Frames {
    /// Scans a text for frames, up to its end or the first invalid line.
    fn of(view: ByteView, hint: TextHint) -> Result<Self, ReadFault> {
        let format = TextFormat::of(view, hint)?;
        let mut frames = Self { format, all: Vec::new(), broken: None };
        let mut lines = TextLines::new(view)?;
        loop {
            let place = lines.place();
            match format.skip_frame(&mut lines, frames.all.len() as u64) {
                Ok(Some(number)) => frames.all.push((number, place)),
                Ok(None) => break,
                Err(ReadFault::Line { .. } | ReadFault::Unsupported(_)) => {
                    frames.broken = Some(place);
                    break;
                }
                Err(fault) => return Err(fault),
            }
        }
        view.check()?;
        Ok(frames)
    }

    /// Whether several frames have the number `step`.
    fn repeats(&self, step: u64) -> bool {
        self.all.iter().filter(|(number, _)| *number == step).count() > 1
    }

    /// Returns the error of the first invalid frame, if there is one.
    fn check(&self, view: ByteView) -> Result<(), ReadFault> {
        let Some(place) = self.broken else { return Ok(()) };
        let count = self.all.len() as u64;
        let skipped = self.format.skip_frame(&mut TextLines::at(view, place)?, count);
        // If this frame is valid now, the file has changed since it was scanned.
        skipped.and(Err(ReadFault::Changed))
    }

    /// The numbers of the frames in ascending order. A number that occurs several times, for
    /// example after a restart, is listed once.
    fn numbers(&self) -> Vec<u64> {
        let mut numbers: Vec<u64> = self.all.iter().map(|(number, _)| *number).collect();
        numbers.sort_unstable();
        numbers.dedup();
        numbers
    }

    /// The start of frame number `step`. Without `step`, the text must have a single frame. If the
    /// text has an invalid line, only frames above this line can be found, and only by their
    /// numbers.
    ///
    /// If several frames have this number, finds the last one, because a simulator that restarts
    /// from an earlier step appends the repeated steps to the file.
    fn find(&self, view: ByteView, step: Option<u64>) -> Result<LinePlace, ReadFault> {
        let found = match step {
            Some(step) => self.all.iter().rfind(|(number, _)| *number == step),
            None => None,
        };
        if let Some((_, place)) = found {
            return Ok(*place);
        }
        self.check(view)?;
        match (step, &*self.all) {
            (Some(step), _) => Err(no_step(step)),
            (None, []) => Err(ReadFault::Unsupported("the file contains no frame".to_owned())),
            (None, [(_, only)]) => Ok(*only),
            (None, _) => {
                let numbers = self.numbers();
                Err(several_steps(numbers[0], numbers[numbers.len() - 1]))
            }
        }
    }
}

/// Whether the start of a file is text. The last character may be incomplete.
fn is_text(start: &[u8]) -> bool {
    let text = match std::str::from_utf8(start) {
        Ok(text) => text,
        Err(e) if e.error_len().is_none() => return is_text(&start[..e.valid_up_to()]),
        Err(_) => return false,
    };
    text.chars().all(|c| !c.is_control() || c.is_ascii_whitespace())
}

/// Decodes UTF-16, except in a file of raw numbers, which can look like UTF-16.
fn decoded(bytes: Bytes, hint: TextHint, unpacking: Unpacking) -> Result<Bytes, ReadFault> {
    if hint.may_be_raw() {
        let view = bytes.view();
        let head = view.read(0..view.len().min(SNIFFED) / 2 * 2)?.into_owned();
        let head = utf8(head.into(), Unpacking::in_memory())?;
        if !is_text(&head.view().read(0..head.view().len())?) {
            return Ok(bytes);
        }
    }
    utf8(bytes, unpacking)
}

/// Reads frame number `step` of a text file. Without `step`, the file must have a single frame. In
/// an .xyz, bytes that are not text are read as raw little-endian f32 triples.
///
/// The starts of frames are cached by the file's path and stamp, so that a later call can read a
/// frame without scanning the frames above it.
///
/// # Errors
/// [`ReadFault::Line`] for an invalid line, [`ReadFault::Unsupported`] if there are several frames
/// but no step is given, and for a step that does not exist, [`ReadFault::Malformed`] for raw bytes
/// that are not complete triples, and [`ReadFault::Scratch`] if the scratch file cannot be written.
pub fn read_particles(
    bytes: Bytes,
    hint: TextHint,
    (file, step): (Option<(&Path, FileStamp)>, Option<u64>),
    wanted: WantedAttributes,
    unpacking: Unpacking,
) -> Result<ParticleFile, ReadFault> {
    static LAST: LastFile<(TextHint, Arc<Frames>)> = LastFile::new();
    let bytes = decoded(bytes, hint, unpacking)?;
    let view = bytes.view();
    let file = file.filter(|_| step.is_some());
    let known = file.and_then(|(path, stamp)| LAST.get(path, stamp));
    let frames = match known.filter(|(of, _)| *of == hint) {
        Some((_, frames)) => frames,
        None => {
            let frames = Arc::new(Frames::of(view, hint)?);
            if let Some((path, stamp)) = file {
                LAST.keep(path, stamp, (hint, Arc::clone(&frames)));
            }
            frames
        }
    };
    match (frames.format, step) {
        (TextFormat::Lammps, step) => {
            let place = frames.find(view, step)?;
            let mut file = lammps::read(bytes, place, wanted, unpacking)?;
            file.left_out.extend(
                step.filter(|&step| frames.repeats(step)).map(|_| UnreadPart::RepeatedStep),
            );
            Ok(file)
        }
        (TextFormat::Xyz, step) => {
            let place = frames.find(view, step)?;
            xyz::read(bytes, place, wanted, unpacking)
        }
        (TextFormat::Tecplot | TextFormat::Raw | TextFormat::Table, Some(step)) => {
            Err(ReadFault::Unsupported(format!(
                "the file contains a single frame, so there is no step {step}"
            )))
        }
        (TextFormat::Tecplot, None) => tecplot::read(bytes, unpacking),
        (TextFormat::Raw, None) => xyz::read_raw(bytes),
        (TextFormat::Table, None) => {
            let start = TextLines::new(view)?.place().at;
            table::read(bytes, start, wanted, unpacking)
        }
    }
}

/// The numbers of the frames in a file, in ascending order. Empty if files of the format contain a
/// single frame.
///
/// # Errors
/// [`ReadFault::Line`] for an invalid line in a format with several frames.
pub fn steps(bytes: Bytes, hint: TextHint) -> Result<Vec<u64>, ReadFault> {
    let bytes = decoded(bytes, hint, Unpacking::for_inspection())?;
    let frames = Frames::of(bytes.view(), hint)?;
    frames.check(bytes.view())?;
    Ok(frames.numbers())
}

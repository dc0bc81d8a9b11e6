//! Errors of reading and writing files.

use std::fmt;
use std::path::{Path, PathBuf};

use thiserror::Error;

use crate::particles::Unread;
use crate::particles::selection::SelectionFault;
use crate::system::reopened::Lost;

/// A file that could not be read.
#[derive(Debug, Error)]
#[error("{}: {fault}", path.display())]
pub struct ReadError {
    /// Path of the file.
    pub path: PathBuf,
    /// The fault that was found.
    #[source]
    pub fault: ReadFault,
}

impl ReadError {
    /// Names the file.
    pub fn new(path: impl Into<PathBuf>, fault: ReadFault) -> Self {
        Self { path: path.into(), fault }
    }
}

/// A reason why an input file cannot be read.
#[derive(Debug, Error)]
pub enum ReadFault {
    /// The system's own refusal: missing, forbidden, a folder.
    #[error("{0}")]
    Io(#[from] std::io::Error),
    /// No bytes at all.
    #[error("the file is empty")]
    Empty,
    /// The scratch file that the input is unpacked or decoded into failed.
    #[error("scratch file for its contents: {0}")]
    Scratch(#[source] std::io::Error),
    /// A compressed stream that does not unpack.
    #[error("damaged compressed data: {0}")]
    Compression(String),
    /// The file ends before its header says that it should.
    #[error("truncated: {what} needs {needed} bytes, the file has {have}")]
    Truncated {
        /// Name of the part that was being read.
        what: String,
        /// Where it would end, in bytes from the start of the (unpacked) file.
        needed: u64,
        /// Where the file ends.
        have: u64,
    },
    /// Something that the format does not allow.
    #[error("at byte {at}: {what}")]
    Malformed {
        /// In bytes from the start of the (unpacked) file.
        at: u64,
        /// Description of the fault: the bytes that were found, or the ones expected.
        what: String,
    },
    /// A line of a text file that does not parse.
    #[error("line {line}: {what}")]
    Line {
        /// Counted from 1.
        line: u64,
        /// Description of the fault: the text that was found, or the one expected.
        what: String,
    },
    /// The file was written to while it was read.
    #[error("changed while it was read")]
    Changed,
    /// A mesh where particles are asked for, whose vertices nobody means by that.
    #[error("holds a mesh ({faces} faces), not particles")]
    Mesh {
        /// The number of cells that have an area or a volume.
        faces: u64,
    },
    /// A file that is among the joined ones twice.
    #[error("is the same input as {}; name each input once", other.display())]
    Twice {
        /// The file as it was named before.
        other: PathBuf,
    },
    /// A colour in another scale than in a file that is joined with this one.
    #[error(
        "colour {attribute} has {scale}, but in {} {of_other}; store it in the same way in \
         both, or leave the attribute out",
        other.display()
    )]
    ColourScale {
        /// The name of the attribute.
        attribute: String,
        /// The scale of its numbers in this file.
        scale: ColourScale,
        /// The other file.
        other: PathBuf,
        /// The scale of its numbers in the other file.
        of_other: ColourScale,
    },
    /// A condition that cannot be applied to these particles.
    #[error("{0}")]
    Selection(SelectionFault),
    /// Valid perhaps, but not something that we read; says what to do instead.
    #[error("{0}")]
    Unsupported(String),
    /// The extension names no format that we read.
    #[error("unknown extension; supported: {known}")]
    UnknownExtension {
        /// List of the known extensions.
        known: &'static str,
    },
}

/// The scale of a colour's numbers in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ColourScale {
    /// Floating-point numbers from 0 to 1.
    Shares,
    /// Bytes from 0 to 255.
    Bytes,
    /// Floating-point numbers from 0 to 255.
    LargeShares,
    /// Whole numbers that are no bytes.
    Whole,
}

impl fmt::Display for ColourScale {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Shares => "floating-point numbers from 0 to 1",
            Self::Bytes => "bytes from 0 to 255",
            Self::LargeShares => "floating-point numbers from 0 to 255",
            Self::Whole => "integers of unknown scale",
        })
    }
}

impl From<Lost> for ReadFault {
    fn from(lost: Lost) -> Self {
        match lost {
            Lost::Changed => Self::Changed,
            Lost::Io(fault) => Self::Io(fault),
        }
    }
}

impl From<Unread> for ReadFault {
    fn from(unread: Unread) -> Self {
        match unread {
            Unread::Changed => Self::Changed,
            Unread::Io(kind) => Self::Io(kind.into()),
        }
    }
}

/// A fault at byte `at`.
pub(super) fn malformed(at: usize, what: impl Into<String>) -> ReadFault {
    ReadFault::Malformed { at: at as u64, what: what.into() }
}

/// Refuses to take several steps for one frame.
pub(super) fn several_steps(first: u64, last: u64) -> ReadFault {
    let what = format!(
        "contains several frames, steps {first} to {last}; append #{first} to the name to \
         choose one"
    );
    ReadFault::Unsupported(what)
}

/// Refuses a step that a file does not hold.
pub(super) fn no_step(step: u64) -> ReadFault {
    ReadFault::Unsupported(format!("there is no step {step}"))
}

/// A file that could not be written. Nothing is left of it.
#[derive(Debug, Error)]
#[error("{}: {fault}", path.display())]
pub struct WriteError {
    /// Path of the file.
    pub path: PathBuf,
    /// The fault that prevented it.
    #[source]
    pub fault: WriteFault,
}

impl WriteError {
    /// Names the file.
    pub fn new(path: &Path, fault: impl Into<WriteFault>) -> Self {
        Self { path: path.to_owned(), fault: fault.into() }
    }
}

/// A reason why an output cannot be written.
#[derive(Debug, Error)]
pub enum WriteFault {
    /// The system's own refusal.
    #[error("{0}")]
    Io(#[from] std::io::Error),
    /// The output is there already, and may not be replaced.
    #[error("exists already")]
    Exists,
    /// The output of a frame is there already, and may not be replaced.
    #[error("exists already")]
    ExistsInSimulation,
    /// The extension names no format that we write.
    #[error("unknown extension; supported: {known}")]
    UnknownExtension {
        /// List of the known extensions.
        known: &'static str,
    },
    /// The format has no place for something that was asked for, or for so much.
    #[error("{0}")]
    Unsupported(String),
}

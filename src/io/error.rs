//! Errors that occur when files are read or written.

use std::fmt;
use std::path::{Path, PathBuf};

use thiserror::Error;

use crate::particles::RereadError;
use crate::particles::selection::SelectionFault;
use crate::system::reopened::ReopenedError;

use super::houdini::Primitives;

/// An error that occurred while reading a file.
#[derive(Debug, Error)]
#[error("{}: {fault}", path.display())]
pub struct ReadError {
    /// Path of the input file.
    pub path: PathBuf,
    /// The cause of the failure, with details.
    #[source]
    pub fault: ReadFault,
}

impl ReadError {
    /// Combines an error with the path of its file.
    pub fn new(path: impl Into<PathBuf>, fault: ReadFault) -> Self {
        Self { path: path.into(), fault }
    }
}

/// The cause of a failure to read an input file.
#[derive(Debug, Error)]
pub enum ReadFault {
    /// An error of the system, such as a missing file.
    #[error("{0}")]
    Io(#[from] std::io::Error),
    /// An empty file.
    #[error("the file is empty")]
    Empty,
    /// The scratch file, into which the input is unpacked or decoded, cannot be written or mapped.
    #[error("cannot write the decoded input to a scratch file: {0}")]
    Scratch(#[source] std::io::Error),
    /// A damaged compressed stream, or one whose compression ratio is too high.
    #[error("cannot decompress the file: {0}")]
    Compression(String),
    /// The file is shorter than its header implies.
    #[error(
        "the file is truncated: it has {have} bytes, but needs at least {needed} for {what}; copy \
         or export it again"
    )]
    Truncated {
        /// Name of the part of the file that needs these bytes.
        what: String,
        /// Minimum size, in bytes, that the (unpacked) file must have.
        needed: u64,
        /// Actual size, in bytes, of the (unpacked) file.
        have: u64,
    },
    /// The file violates its format.
    #[error("at byte {at}: {what}")]
    Malformed {
        /// Byte offset in the (unpacked) file.
        at: u64,
        /// Description of the violation, with the bytes that were found or expected.
        what: String,
    },
    /// A line of a text file that cannot be parsed.
    #[error("line {line}: {what}")]
    Line {
        /// Number of the line, counted from 1.
        line: u64,
        /// Description of the error, with the text that was found or expected.
        what: String,
    },
    /// The file was changed while it was read.
    #[error("the file changed while it was being read; try again when it is complete")]
    Changed,
    /// The file contains a mesh instead of particles. Vertices of a mesh are not used as particles.
    #[error(
        "the file contains a mesh ({faces} faces or cells), not particles; to use its vertices as \
         particles, remove the faces or cells"
    )]
    Mesh {
        /// Number of cells with an area or a volume.
        faces: u64,
    },
    /// A Houdini geometry without particles, because primitives use all of its points.
    #[error("the file contains {0}, but no other points; {remedy}", remedy = .0.remedy())]
    OnlyPrimitives(Primitives),
    /// A file that occurs twice in a list of files to join.
    #[error("this is the same input as {}; list each input only once", other.display())]
    Twice {
        /// The other name of the file in the list.
        other: PathBuf,
    },
    /// A frame of a simulation that lacks a file that other frames have. The text names the file.
    #[error("{0}")]
    Incomplete(String),
    /// A colour whose numbers have different scales in two joined files.
    #[error(
        "colour {attribute} is stored as {scale} in this file, but as {of_other} in {}; store it \
         in the same way in both files, or do not transfer the attribute",
        other.display()
    )]
    ColourScale {
        /// The name of the attribute.
        attribute: String,
        /// The scale in this file.
        scale: ColourScale,
        /// The other file.
        other: PathBuf,
        /// The scale in the other file.
        of_other: ColourScale,
    },
    /// A condition cannot be applied to these particles, or every particle fails a condition.
    #[error("{0}")]
    Selection(SelectionFault),
    /// A valid file that this library does not support. The text says what to do.
    #[error("{0}")]
    Unsupported(String),
    /// An unknown extension.
    #[error("unknown extension; supported: {known}")]
    UnknownExtension {
        /// List of the known extensions.
        known: &'static str,
    },
}

/// The scale of the numbers that store a colour in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ColourScale {
    /// Floating-point numbers from 0 to 1.
    Shares,
    /// Bytes from 0 to 255.
    Bytes,
    /// Floating-point numbers from 0 to 255.
    LargeShares,
    /// Integers wider than a byte, whose scale is unknown.
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

impl From<ReopenedError> for ReadFault {
    fn from(error: ReopenedError) -> Self {
        match error {
            ReopenedError::Changed => Self::Changed,
            ReopenedError::Io(fault) => Self::Io(fault),
        }
    }
}

impl From<RereadError> for ReadFault {
    fn from(error: RereadError) -> Self {
        match error {
            RereadError::Changed => Self::Changed,
            RereadError::Io(kind) => Self::Io(kind.into()),
        }
    }
}

/// A violation of the format at byte `at`.
pub(super) fn malformed(at: usize, what: impl Into<String>) -> ReadFault {
    ReadFault::Malformed { at: at as u64, what: what.into() }
}

/// The error for a file with several steps, if the caller chose none of them.
pub(super) fn several_steps(first: u64, last: u64) -> ReadFault {
    let what = format!(
        "the file contains several frames (steps {first} to {last}); to choose one, append its \
         step to the name, such as #{first}"
    );
    ReadFault::Unsupported(what)
}

/// Advice for positions that have only two coordinates.
pub(super) const ADD_Z: &str = "for particles in a plane, add a coordinate z that is 0";

/// The error for a step that does not exist.
pub(super) fn no_step(step: u64) -> ReadFault {
    ReadFault::Unsupported(format!("the file has no step {step}"))
}

/// An error that occurred while writing a file. No part of the file remains.
#[derive(Debug, Error)]
#[error("{}: {fault}", path.display())]
pub struct WriteError {
    /// Path of the output.
    pub path: PathBuf,
    /// The cause of the failure, with details.
    #[source]
    pub fault: WriteFault,
}

impl WriteError {
    /// Combines an error with the path of its file.
    pub fn new(path: &Path, fault: impl Into<WriteFault>) -> Self {
        Self { path: path.to_owned(), fault: fault.into() }
    }
}

/// A reason why an output cannot be written.
#[derive(Debug, Error)]
pub enum WriteFault {
    /// An error of the system.
    #[error("{0}")]
    Io(#[from] std::io::Error),
    /// The output already exists, and may not be replaced.
    #[error("the file already exists")]
    Exists,
    /// The output of a frame already exists, and may not be replaced.
    #[error("the mesh of a frame already exists")]
    ExistsInSimulation,
    /// An unknown extension.
    #[error("unknown extension; supported: {known}")]
    UnknownExtension {
        /// List of the known extensions.
        known: &'static str,
    },
    /// Data that the format cannot store, or more data than it can store.
    #[error("{0}")]
    Unsupported(String),
}

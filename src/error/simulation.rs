//! Errors while converting a simulation.

use std::fmt;
use std::ops::RangeInclusive;
use std::path::PathBuf;

use thiserror::Error;

use super::shown;

/// Valid frame rates, in frames per second. Within this range, programs can distinguish the times
/// of neighbouring frames.
pub const FPS: RangeInclusive<f64> = 1e-9..=1e9;

/// A simulation that cannot be converted.
#[derive(Debug, Error)]
pub enum SimulationError {
    /// The inputs contain no frame.
    #[error("{0}: no frames found; check the path and the file names")]
    NoFrames(String),
    /// A pattern that matches no file.
    #[error("{0}: no file matches this pattern")]
    NoMatch(String),
    /// A folder or glob without matching files.
    #[error("{0}: no files in a supported format found")]
    NoFiles(String),
    /// A folder of inputs that does not exist.
    #[error("{}: the folder does not exist", .0.display())]
    NoFolder(PathBuf),
    /// An input, or a folder of inputs, that cannot be read.
    #[error("{}: {fault}", path.display())]
    Unreadable {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        #[source]
        fault: std::io::Error,
    },
    /// No existing frame matches the selection.
    #[error("{0}: no frame matches the selection")]
    NoFrameSelected(String),
    /// An invalid frame rate.
    #[error(
        "fps must be from {:e} to {:e} frames per second, got {}",
        range.start(), range.end(), shown(*rate)
    )]
    Rate {
        /// The requested rate.
        rate: f64,
        /// The valid rates.
        range: RangeInclusive<f64>,
    },
    /// An invalid timeout.
    #[error("watch must be at least 0 seconds, got {0}")]
    Timeout(f64),
    /// Steps inside one file, which cannot be watched.
    #[error(
        "{0}: cannot watch for new frames inside one file; convert the file when the simulation \
         has ended"
    )]
    Steps(String),
    /// Frames in several files. They cannot be watched, because no file shows that a frame is
    /// complete.
    #[error(
        "{0}: cannot watch frames that are split into several files, because meniscus cannot tell \
         when all files of a frame have been written; convert the frames when the simulation has \
         ended"
    )]
    Joined(String),
    /// Frames of another simulation, which appeared while one simulation was watched.
    #[error(
        "{0}: these frames appeared while another simulation was watched, and were not converted; \
         convert them separately"
    )]
    Unwatched(String),
    /// A first frame after the last.
    #[error("the first frame ({first}) is after the last ({last})")]
    Range {
        /// The first number.
        first: i64,
        /// The last number.
        last: i64,
    },
    /// A step of 0.
    #[error("the step between frames must be at least 1")]
    Step,
    /// File names that do not determine the frame numbers.
    #[error("{0}")]
    Names(String),
    /// Files of several simulations, although only one simulation is possible.
    #[error(
        "{from}: there are several simulations: {families}; name one of these simulations{why}"
    )]
    Several {
        /// The folder or pattern.
        from: String,
        /// The simulations, each with its number of frames.
        families: String,
        /// The reason why only one is possible.
        why: WhyOne,
    },
    /// A folder, a state file or a record that cannot be read or written.
    #[error("{}: {fault}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        #[source]
        fault: std::io::Error,
    },
    /// A state file that is damaged, or was written by another version of meniscus.
    #[error(
        "{}: cannot use this state file ({what}); it may be damaged, or another version of \
         meniscus may have written it",
        path.display()
    )]
    State {
        /// The file.
        path: PathBuf,
        /// The damage.
        what: String,
    },
    /// A second conversion, with other settings, that writes to the same outputs.
    #[error(
        "{}: another conversion, with different settings, uses this output; wait until it ends, or \
         choose another output",
        .0.display()
    )]
    Busy(PathBuf),
    /// Meshes of other inputs, which a resumed conversion would replace.
    #[error(
        "{}: the existing meshes were made from {recorded}, but {inputs} has a different frame {frame}; \
         write the new meshes to another output",
        path.display()
    )]
    OtherInputs {
        /// The state file.
        path: PathBuf,
        /// The folder or file with the inputs of the existing meshes.
        recorded: String,
        /// The folder or file with the inputs of this request.
        inputs: String,
        /// The number of a frame that differs.
        frame: i64,
    },
    /// The state is from a run with other settings, or its calibration frame has changed since that
    /// run.
    #[error(
        "{}: the existing frames do not match this request; changed: {differing}",
        path.display()
    )]
    Settings {
        /// The state file.
        path: PathBuf,
        /// The names of the settings that differ, and the calibration frame if it has changed.
        differing: String,
    },
}

/// The reason why only one simulation is possible.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WhyOne {
    /// The request is for one simulation.
    Request,
    /// The output is a pattern, which would give the meshes of all simulations the same names.
    Pattern,
    /// In one folder, the meshes of the simulations would have the same names.
    Names,
}

impl fmt::Display for WhyOne {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Request => "",
            Self::Pattern => ", or write the meshes of all simulations into a folder",
            Self::Names => {
                ", because the meshes of different simulations would have the same file names in \
                 one folder"
            }
        })
    }
}

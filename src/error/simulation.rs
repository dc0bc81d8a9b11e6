//! Why a simulation cannot be begun.

use std::ops::RangeInclusive;
use std::path::PathBuf;

use thiserror::Error;

/// Rates of frames whose times programs can tell apart.
pub const FPS: RangeInclusive<f64> = 1e-9..=1e9;

/// A simulation that cannot be begun.
#[derive(Debug, Error)]
pub enum SimulationError {
    /// The request names no frame.
    #[error("{0}: no frames found")]
    NoFrames(String),
    /// A folder or a pattern of files that names none that can be read.
    #[error("{0}: no matching files")]
    NoFiles(String),
    /// A folder of inputs that does not exist.
    #[error("{}: the folder does not exist", .0.display())]
    NoFolder(PathBuf),
    /// A folder of inputs that cannot be read.
    #[error("{}: {fault}", path.display())]
    Unreadable {
        /// The folder.
        path: PathBuf,
        /// The system's own refusal.
        #[source]
        fault: std::io::Error,
    },
    /// Frames that are asked for, of which none is there.
    #[error("{0}: no frame matches the selection")]
    NoneWanted(String),
    /// A rate of frames whose times programs could not tell apart.
    #[error("fps must be from {} to {} frames per second, got {rate:?}", range.start(), range.end())]
    Rate {
        /// The rate that was asked for.
        rate: f64,
        /// The rates that can be.
        range: RangeInclusive<f64>,
    },
    /// A time to wait that is none.
    #[error("watch must be a number of seconds, got {0}")]
    Wait(f64),
    /// Steps of one file, which cannot be followed while they are written.
    #[error("{0}: cannot watch the steps inside one file")]
    Steps(String),
    /// Frames in several files, of which nothing says when all are there.
    #[error(
        "{0}: cannot watch frames that are in several files, because no file tells when a frame \
         is complete; convert them once the simulation is over"
    )]
    Joined(String),
    /// A first number after the last.
    #[error("the first frame ({first}) is after the last ({last})")]
    Range {
        /// The first number.
        first: i64,
        /// The last number.
        last: i64,
    },
    /// A step that leads nowhere.
    #[error("the step between frames must be at least 1")]
    Step,
    /// The names do not say which frame is which.
    #[error("{0}")]
    Names(String),
    /// The files are of several simulations, and what is asked for goes with one.
    #[error(
        "{from}: contains several simulations: {families}; name one of them, or write the \
         meshes into a folder"
    )]
    Several {
        /// Where they were found.
        from: String,
        /// The names of the simulations, and how many frames each has.
        families: String,
    },
    /// A folder or the state that cannot be read.
    #[error("{}: {fault}", path.display())]
    Io {
        /// Where.
        path: PathBuf,
        /// The system's own refusal.
        #[source]
        fault: std::io::Error,
    },
    /// A state file that is damaged, or of another version.
    #[error("{}: {what}", path.display())]
    State {
        /// The file.
        path: PathBuf,
        /// The damage.
        what: String,
    },
    /// A folder that another conversion writes to, with other settings.
    #[error("{}: another conversion with other settings is running there; wait for it, or \
             choose another output", .0.display())]
    Busy(PathBuf),
    /// The state is of a run with other settings.
    #[error("{}: the existing frames were made with other settings ({differing})", path.display())]
    Settings {
        /// The state file.
        path: PathBuf,
        /// The names of the settings that differ.
        differing: String,
    },
}

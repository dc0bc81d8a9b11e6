//! The frames of a simulation: which files they are, what is measured once for all of them, and what is known of
//! each that is done.
//!
//! What the surface depends on besides a frame's own particles is measured on the first frame that can tell,
//! frozen, and kept in a state file beside the outputs. From then on frames are independent: whoever converts one,
//! when and where, gets the same bytes. A frame that is done leaves a record beside the state; the record is
//! written after the output has got its name, so an output with a record is whole.

pub mod frozen;
pub mod inputs;
pub mod naming;
pub mod series;
pub mod state;

use std::path::PathBuf;

use thiserror::Error;

/// A sequence that cannot be begun.
#[derive(Debug, Error)]
pub enum SequenceError {
    /// The request names no frame.
    #[error("{0}: there are no frames")]
    NoFrames(String),
    /// The names do not say which frame is which.
    #[error("{0}")]
    Names(String),
    /// A folder or the state that cannot be read.
    #[error("{}: {fault}", path.display())]
    Io {
        /// Where.
        path: PathBuf,
        /// The system's own refusal.
        fault: std::io::Error,
    },
    /// A state file that is damaged, or of another version.
    #[error("{}: {what}; --overwrite begins anew", path.display())]
    State {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        what: String,
    },
    /// The state is of a run with other settings.
    #[error(
        "{}: the frames there are made with other settings ({differing}); --resume makes them again, --overwrite \
         begins anew",
        path.display()
    )]
    Settings {
        /// The state file.
        path: PathBuf,
        /// Which.
        differing: String,
    },
}

//! Why a simulation cannot be begun.

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
    /// The files are of several sequences, and what is asked for goes with one.
    #[error("{from}: several sequences: {families}; name one of them, or a folder for the meshes of each")]
    Several {
        /// Where they were found.
        from: String,
        /// Their names, and how many frames each has.
        families: String,
    },
    /// A folder or the state that cannot be read.
    #[error("{}: {fault}", path.display())]
    Io {
        /// Where.
        path: PathBuf,
        /// The system's own refusal.
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
    /// The state is of a run with other settings.
    #[error("{}: the frames there are made with other settings ({differing})", path.display())]
    Settings {
        /// The state file.
        path: PathBuf,
        /// Which.
        differing: String,
    },
}

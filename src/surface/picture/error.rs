//! The faults of pictures.

use std::io;

use thiserror::Error;

use crate::surface::mesh::compare::CompareError;

/// Pixels along an edge, at the most.
pub(super) const MOST_PIXELS: usize = 1 << 15;

/// A picture that cannot be drawn.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PictureError {
    /// A size that no picture can have.
    #[error("a picture of {0} x {1} pixels: 1 to {MOST_PIXELS} can be along an edge")]
    Size(usize, usize),
    /// A view that shows nothing.
    #[error("{0}")]
    View(&'static str),
    /// A colour map that is not known.
    #[error("no colour map {name:?}; there are: {known}")]
    Map {
        /// The name that was asked for.
        name: String,
        /// The names of those that there are.
        known: String,
    },
    /// An attribute that the vertices do not have.
    #[error("no attribute {name:?} on the vertices; there are: {known}")]
    NoAttribute {
        /// The attribute that was asked for.
        name: String,
        /// The names of those that there are.
        known: String,
    },
    /// A mesh from which there is no distance.
    #[error("{0}")]
    Reference(CompareError),
    /// More memory than may be used.
    #[error("a picture of this mesh takes {needed} bytes of memory; {allowed} may be used")]
    Memory {
        /// Bytes that it takes.
        needed: u64,
        /// Bytes that may be used.
        allowed: u64,
    },
    /// A mesh that cannot be read from where it is kept.
    #[error("{0}")]
    Io(#[from] io::Error),
}

//! Files: one format each, readers and writers side by side, chosen by extension.
//!
//! All formats are in `formats.md`, and how to add one in `../contributing.md`: both are pages of
//! the docs.

mod beside;
pub mod bgeo;
pub mod bi4;
pub mod bytes;
pub mod collection;
pub mod columns;
pub mod compression;
pub mod cursor;
pub mod encode;
pub(crate) mod error;
mod fields;
pub mod frame_files;
mod ghosts;
pub mod glb;
#[cfg(feature = "hdf5")]
pub mod h5;
pub mod houdini;
pub mod input;
mod input_format;
pub mod joined;
pub mod json;
pub mod lammps;
mod listed;
pub mod mnf;
pub mod names;
pub mod npy;
pub mod npz;
mod number;
pub mod obj;
pub mod output;
mod pieces;
pub mod ply;
pub mod scan;
pub mod scene;
pub mod series;
pub mod stamp;
pub mod stl;
pub mod table;
pub mod tecplot;
mod text;
pub mod text_format;
pub mod up;
pub mod usd;
mod vertices;
pub mod vtk;
mod vtkhdf;
pub mod vtp;
pub mod wanted;
pub mod whole;
pub mod windows;
pub mod xyz;

use std::fmt;

use crate::particles::AttributeInfo;
use crate::particles::selection::SelectionFault;

pub use crate::surface::mesh::up::UpAxis;
use error::malformed;
pub use error::{ColourScale, ReadError, ReadFault, WriteError, WriteFault};
pub use pieces::{PieceChunk, Pieces};

/// A particle file, its header understood and its counts checked against its size.
#[derive(Debug)]
pub struct ParticleFile {
    /// The numbers, read on demand.
    pub particles: Pieces,
    /// The file's format, in the words of `info`.
    pub format: &'static str,
    /// The spacing of the particles, where the file says it.
    pub spacing: Option<f64>,
    /// The simulation's time in seconds, where the file says it.
    pub time: Option<f64>,
    /// Edges of the simulation's box, where the file says them: whether it is periodic they do not
    /// say.
    pub box_size: Option<[f64; 3]>,
    /// The file's unit of length in metres, where the file says it; coordinates are in that unit.
    pub unit_metres: Option<f64>,
    /// Types of particles that the file holds, the one that was read first; none where it holds
    /// but one without a name.
    pub particle_types: Vec<String>,
    /// Number of particles that were left out as copies of those of other pieces.
    pub ghosts: usize,
    /// Number of particles that were left out as they fail a condition.
    pub unselected: usize,
    /// The reason why there are none, if all fail a condition.
    pub none_selected: Option<SelectionFault>,
    /// Attributes that the file has, and that were not read as nobody wanted them.
    pub unread: Vec<AttributeInfo>,
    /// Names of arrays of text, which the format's reader passes over.
    pub texts: Vec<String>,
    /// Parts of the input that cannot be read with the others.
    pub left_out: Vec<LeftOut>,
}

/// A part of an input that cannot be read with the others.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum LeftOut {
    /// An attribute that some pieces with particles lack.
    Attribute(AttributeInfo),
    /// A block that holds no particles.
    Block {
        /// The block's name or file.
        name: String,
        /// Contents of the block.
        holds: String,
    },
    /// Polygons and other primitives among particles, with the points that they connect.
    Primitives {
        /// Each kind, and how many there are.
        kinds: Vec<(String, u64)>,
        /// The number of their points.
        points: u64,
    },
}

impl fmt::Display for LeftOut {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Attribute(AttributeInfo { name, components, .. }) => {
                write!(f, "attribute {name} ({components}), which is not in all pieces")
            }
            Self::Block { name, holds } => write!(f, "block {name}, which holds {holds}"),
            Self::Primitives { kinds, points } => {
                let kinds = kinds.iter().map(|(kind, count)| format!("{count} {kind}"));
                let kinds = kinds.collect::<Vec<_>>().join(", ");
                write!(f, "{kinds} and their {points} points")
            }
        }
    }
}

impl ParticleFile {
    /// Puts particles in a file that says nothing else of them.
    #[must_use]
    pub fn new(particles: impl Into<Pieces>, format: &'static str) -> Self {
        Self {
            particles: particles.into(),
            format,
            spacing: None,
            time: None,
            box_size: None,
            unit_metres: None,
            particle_types: Vec::new(),
            ghosts: 0,
            unselected: 0,
            none_selected: None,
            unread: Vec::new(),
            texts: Vec::new(),
            left_out: Vec::new(),
        }
    }
}

/// How wide a mesh file's coordinates are, where its format leaves the choice.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CoordinateWidth {
    /// Coordinates in f32, which every program reads.
    F32,
    /// For surfaces so far from the origin that f32 would crumple them.
    F64,
}

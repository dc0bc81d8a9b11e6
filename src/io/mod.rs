//! Readers and writers of files. Each format has its own module, and the extension selects the
//! format.
//!
//! `formats.md` describes all formats, and `../contributing.md` explains how to add one. Both are
//! pages of the docs.

pub mod alembic;
mod beside;
pub mod bgeo;
pub mod bi4;
mod blocks;
pub mod bytes;
mod cell_types;
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
pub(crate) mod time_codes;
pub mod up;
pub mod usd;
pub mod vdb;
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
use crate::particles::mixture::is_material_name;
use crate::particles::selection::SelectionFault;
use crate::particles::velocity::velocity_rank;

pub use crate::surface::mesh::up::UpAxis;
use error::malformed;
pub use error::{ColourScale, ReadError, ReadFault, WriteError, WriteFault};
use houdini::Primitives;
pub use pieces::{PieceChunk, Pieces};

/// An opened particle file. The reader has parsed its header, and has checked the counts in the
/// header against the size of the file.
#[derive(Debug)]
pub struct ParticleFile {
    /// Positions and attributes of the particles, read on demand.
    pub particles: Pieces,
    /// The format's name, for messages.
    pub format: &'static str,
    /// The spacing of the particles, if the file contains it.
    pub spacing: Option<f64>,
    /// The simulation's time in seconds, if the file contains it.
    pub time: Option<f64>,
    /// Lengths of the edges of the simulation's box along x, y and z, if the file contains them.
    /// The box need not be periodic.
    pub box_size: Option<[f64; 3]>,
    /// The file's unit of length in metres, if the file contains it. Coordinates are in this unit.
    pub unit_metres: Option<f64>,
    /// Names of the particle types in the file. The first is the type that was read. Empty if the
    /// file has a single type without a name.
    pub particle_types: Vec<String>,
    /// Number of ghost particles (copies of particles of other pieces) that were left out.
    pub ghosts: usize,
    /// Number of particles that were left out because they fail a condition.
    pub unselected: usize,
    /// The error to report if every particle fails a condition. Otherwise `None`.
    pub none_selected: Option<SelectionFault>,
    /// Attributes of the file that were not requested.
    pub unread: Vec<AttributeInfo>,
    /// Names of text arrays, which the reader skips.
    pub texts: Vec<String>,
    /// Parts of the input that are not read.
    pub left_out: Vec<UnreadPart>,
    /// Whether the input has cells and all of them are lines, such as the paths of particles.
    pub only_lines: bool,
}

/// A part of an input that is not read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum UnreadPart {
    /// An attribute that is missing from at least one piece that contains particles.
    Attribute(AttributeInfo),
    /// A block that holds no particles.
    Block {
        /// The block's name or file.
        name: String,
        /// Description of the block's contents, for a message.
        holds: String,
    },
    /// The different names of blocks whose particles are joined.
    Names(Vec<String>),
    /// Polygons and other primitives in a Houdini geometry, and the points that they use.
    Primitives(Primitives),
    /// The times of several frames in a table, whose rows are read as one frame.
    Times {
        /// The name of the column of times.
        column: String,
        /// Number of different times.
        count: usize,
        /// The earliest time.
        first: String,
        /// The latest time.
        last: String,
    },
    /// Earlier frames that have the same number as the frame that is read.
    RepeatedStep,
    /// An array with more numbers per particle than an attribute can have.
    WideArray {
        /// The array's name.
        name: String,
        /// Number of values per particle.
        numbers: u64,
    },
    /// An array whose shape does not match the number of particles or frames.
    OtherShape {
        /// The array's name.
        name: String,
        /// Sizes of the array's axes.
        shape: Vec<u64>,
        /// Number of particles in each frame.
        particles: u64,
        /// Number of frames, if the positions have an axis for frames.
        frames: Option<u64>,
    },
    /// The name of an array of cell data that the reader does not use as point data.
    CellData(String),
    /// Arrays `x`, `y` and `z` whose length is not the number of particles.
    Coordinates {
        /// The names of the arrays.
        names: [String; 3],
        /// The name of the array that contains the positions.
        position: String,
    },
}

impl UnreadPart {
    /// The attribute's name if this part is an attribute or an array.
    #[must_use]
    pub fn attribute(&self) -> Option<&str> {
        match self {
            Self::Attribute(info) => Some(&info.name),
            Self::WideArray { name, .. } | Self::OtherShape { name, .. } | Self::CellData(name) => {
                Some(name)
            }
            Self::Block { .. }
            | Self::Names(_)
            | Self::Primitives(_)
            | Self::Times { .. }
            | Self::RepeatedStep
            | Self::Coordinates { .. } => None,
        }
    }

    /// Whether a warning should name this part. An array of another shape usually does not belong
    /// to the particles, so a warning names it only if its name is common among their attributes.
    #[must_use]
    pub fn is_unexpected(&self) -> bool {
        match self {
            Self::OtherShape { name, shape, .. } => {
                let is_grid = shape.len() > 2;
                let is_common = names::names_other_column(name)
                    || names::is_other_component(name)
                    || velocity_rank(name).is_some();
                is_common && !is_grid && !is_material_name(name)
            }
            _ => true,
        }
    }
}

impl fmt::Display for UnreadPart {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Attribute(AttributeInfo { name, components, .. }) => {
                write!(
                    f,
                    "attribute {name:?} (components: {components}), which some pieces of the frame \
                     lack"
                )
            }
            Self::Block { name, holds } => write!(f, "block {name:?}, which contains {holds}"),
            Self::Names(names) => {
                let names = names.iter().map(|name| format!("{name:?}"));
                let names = names.collect::<Vec<_>>().join(", ");
                write!(
                    f,
                    "the names of the blocks ({names}), because the particles of all blocks are \
                     joined; a condition cannot select one of these blocks"
                )
            }
            Self::Primitives(primitives) => write!(f, "{primitives}"),
            Self::Times { column, count, first, last } => write!(
                f,
                "the times in column {column:?} ({count} different values from {first} to \
                 {last}), because meniscus reads all rows of a table as one frame; to select the \
                 rows of one time, use the condition {column}={first}"
            ),
            Self::RepeatedStep => write!(
                f,
                "earlier frames with the same step number as this frame, because a restarted \
                 simulation repeats steps, and only the last frame with a given number counts"
            ),
            Self::WideArray { name, numbers } => write!(
                f,
                "array {name:?}, which has {numbers} numbers per particle (at most {} are \
                 supported)",
                fields::MOST_COMPONENTS
            ),
            Self::OtherShape { name, shape, particles, frames } => {
                let shape = fields::shown(shape);
                let of_each =
                    frames.map_or(String::new(), |frames| format!(" in each of {frames} frames"));
                write!(
                    f,
                    "array {name:?} of shape {shape}, which does not match the number of particles \
                     ({particles}{of_each})"
                )
            }
            Self::CellData(name) => write!(f, "cell data {name:?}; convert it to point data"),
            Self::Coordinates { names: [x, y, z], position } => write!(
                f,
                "arrays {x:?}, {y:?} and {z:?}, because {position:?} contains the positions"
            ),
        }
    }
}

impl ParticleFile {
    /// Creates a particle file with `particles`, but without types, times or other data.
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
            only_lines: false,
        }
    }
}

/// Number type of the coordinates in a mesh file, for formats that support f32 and f64.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CoordinateWidth {
    /// f32, which all programs support.
    F32,
    /// f64, for surfaces so far from the origin that f32 would distort them.
    F64,
}

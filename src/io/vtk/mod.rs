//! Legacy .vtk, versions 2.0 to 5.1: particles or surfaces, in text or in big-endian binary.
//!
//! After three lines of greeting, sections follow in nearly any order, each a line of words and the
//! array that it announces: `POINTS`, cells by several names, and under `POINT_DATA` or `CELL_DATA`
//! the attributes. A file without cells that have an area holds particles.

mod layout;
mod read;
mod write;

pub use layout::is_text;
pub(super) use read::unless_text;
pub use read::{has_faces, read_mesh, read_particles, read_points};
pub(in crate::io) use write::attribute_names;
pub use write::write_mesh;

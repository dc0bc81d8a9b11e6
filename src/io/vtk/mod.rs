//! Reads legacy .vtk files of versions 2.0 to 5.1, and writes version 3.0. A file contains
//! particles or a surface, in text or in big-endian binary.
//!
//! A header of three lines is followed by sections in almost any order. A section consists of a
//! line of words, followed by an array. After `POINTS`, sections such as `VERTICES`, `POLYGONS` or
//! `CELLS` contain cells, and `POINT_DATA` or `CELL_DATA` contain attributes. A file contains
//! particles if no cell has an area or a volume.

mod layout;
mod read;
mod write;

pub use layout::is_text;
pub(super) use read::whole_file_if_text;
pub use read::{has_faces, read_mesh, read_particles, read_points};
pub(in crate::io) use write::attribute_names;
pub use write::write_mesh;

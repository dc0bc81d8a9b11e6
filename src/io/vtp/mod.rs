//! Reads and writes VTK's XML formats. A .vtp file (PolyData) contains particles or a mesh. A .vtu
//! file (UnstructuredGrid) must contain particles.
//!
//! The XML contains each array's name, type and location. The numbers are in the XML as text or
//! base64, or after `<AppendedData>` and an underscore as raw bytes or base64. Data other than text
//! may be compressed, block by block. The writer stores the numbers of a mesh as uncompressed raw
//! bytes.

pub(super) mod arrays;
mod data;
pub(super) mod divided;
mod layout;
pub mod parallel;
mod read;
mod write;

pub(super) use layout::each_tag;
pub(super) use read::whole_file_if_inline;
pub use read::{has_faces, is_text, read_mesh, read_particles};
pub(super) use write::escaped;
pub use write::write_mesh;

/// Name of the array of normals.
pub(super) const NORMALS: &str = "Normals";

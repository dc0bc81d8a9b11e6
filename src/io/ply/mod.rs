//! .ply, the Stanford format: particles or meshes, in text or in binary with either byte order.
//!
//! A header lists the elements in the order of their data, each with a count and its properties.
//! The element `vertex` contains particles or the vertices of a mesh. The element `face` contains
//! polygons. A file in which no face has an area is a particle file, because some programs also
//! write a face with one corner for each particle.

mod header;
mod read;
mod stream;
mod write;

pub use read::{has_faces, read_mesh, read_particles, read_points};
pub use stream::StreamedMesh;
pub(in crate::io) use write::attribute_names;
pub use write::write_mesh;

/// Attributes that are stored as three properties. Each entry has the name of the attribute and the
/// names of the properties.
const GROUPS: [(&str, [&str; 3]); 4] = [
    ("velocity", ["vx", "vy", "vz"]),
    ("velocity", ["velocity_x", "velocity_y", "velocity_z"]),
    ("velocity", ["vel_x", "vel_y", "vel_z"]),
    (NORMAL, ["nx", "ny", "nz"]),
];

/// Name of the attribute that nx, ny and nz form.
const NORMAL: &str = "normal";

//! .ply, the Stanford format: particles or meshes, in text or in binary with either byte order.
//!
//! A header lists elements in the order of their data, each with a count and its properties.
//! `vertex` contains particles or the vertices of a mesh; `face` contains polygons, and a file
//! without any is a particle file.

mod header;
mod read;
mod stream;
mod write;

pub use read::{has_faces, read_mesh, read_particles, read_points};
pub use stream::StreamedMesh;
pub(in crate::io) use write::attribute_names;
pub use write::write_mesh;

/// Properties that form an attribute with three components.
const GROUPS: [(&str, [&str; 3]); 4] = [
    ("velocity", ["vx", "vy", "vz"]),
    ("velocity", ["velocity_x", "velocity_y", "velocity_z"]),
    ("velocity", ["vel_x", "vel_y", "vel_z"]),
    (NORMAL, ["nx", "ny", "nz"]),
];

/// Name of the attribute of nx, ny and nz.
const NORMAL: &str = "normal";

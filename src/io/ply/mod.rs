//! .ply, the Stanford format: particles or meshes, in text or in binary of either byte order.
//!
//! A header lists elements in the order of their data, each with a count and its properties.
//! `vertex` holds particles or the vertices of a mesh; `face` holds polygons, and a file without
//! any is a particle file.

mod header;
mod read;
mod stream;
mod write;

pub use read::{has_faces, read_mesh, read_particles, read_points};
pub use stream::StreamedMesh;
pub(in crate::io) use write::attribute_names;
pub use write::write_mesh;

/// Properties that together are one attribute of three components.
const GROUPS: [(&str, [&str; 3]); 4] = [
    ("velocity", ["vx", "vy", "vz"]),
    ("velocity", ["velocity_x", "velocity_y", "velocity_z"]),
    ("velocity", ["vel_x", "vel_y", "vel_z"]),
    (NORMAL, ["nx", "ny", "nz"]),
];

/// Name of the attribute that nx, ny and nz are read as.
const NORMAL: &str = "normal";

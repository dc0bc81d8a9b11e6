//! Alembic in its Ogawa form. An archive contains one polygon mesh, whose topology may change from
//! frame to frame.
//!
//! The archive has a transform `/fluid`, which is the identity, and the mesh `/fluid/fluidShape`.
//! In Alembic, y points up, polygons are clockwise as seen from outside, and velocities are in
//! units of length per second. If the topology changes, readers show the mesh of the nearest frame
//! at times between frames. Readers may also move the vertices of this mesh by their velocities.
//!
//! `ogawa.rs` implements groups and data blocks, `archive.rs` the objects and properties in them,
//! and `geometry.rs` the properties of a mesh. Alembic has no specification. The sources of Alembic
//! 1.8 define the format (`Ogawa/OGroup.cpp`, `AbcCoreOgawa` and `AbcGeom/OPolyMesh.cpp`).

mod archive;
pub mod content_hash;
pub mod frame_archive;
mod geometry;
mod ogawa;
mod write;

pub use geometry::attribute_names;
pub use write::write_mesh;

/// The time of a mesh in seconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SampleTime {
    /// The bits of the time as an f64. Unlike f64, bits implement `Eq`.
    bits: u64,
}

impl SampleTime {
    /// Time 0.
    pub const ZERO: Self = Self { bits: 0 };

    /// A time in seconds. NaN and infinity count as 0.
    #[must_use]
    pub fn of(seconds: f64) -> Self {
        Self { bits: if seconds.is_finite() { seconds.to_bits() } else { 0 } }
    }

    /// The time in seconds.
    #[must_use]
    pub fn seconds(self) -> f64 {
        f64::from_bits(self.bits)
    }
}

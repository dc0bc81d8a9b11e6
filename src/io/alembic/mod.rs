//! Alembic in its Ogawa form: an archive with one polygon mesh, whose topology may change from
//! frame to frame.
//!
//! The archive has a transform `/fluid`, which is the identity, and the mesh `/fluid/fluidShape`.
//! In Alembic, y points up, polygons are clockwise as seen from outside, and velocities are in units
//! of length per second. Readers take a mesh whose topology changes from the nearest frame, and may
//! move it by its velocities.
//!
//! `ogawa.rs` has groups and data blocks, `archive.rs` objects and properties in them, and
//! `geometry.rs` the properties of a mesh. There is no specification: the sources of Alembic 1.8
//! define the format (`Ogawa/OGroup.cpp`, `AbcCoreOgawa` and `AbcGeom/OPolyMesh.cpp`).

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
    /// The bits of an f64, which can be compared.
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

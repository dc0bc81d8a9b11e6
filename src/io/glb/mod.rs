//! glTF 2.0 in one binary file. The scene has one node with one mesh of one primitive.
//!
//! Positions, NORMAL, `_VELOCITY`, other attributes, and u32 indices each have their own buffer
//! view. Vertices and triangles have an order that suits vertex caches. In glTF, y points up. If z
//! points up in the input, the node rotates the mesh.
//!
//! With compression, vertex data is quantized (KHR_mesh_quantization), and all data is encoded
//! (EXT_meshopt_compression, which requires version 0 of the vertex codec):
//!
//! | data | stored as | maximum error |
//! |---|---|---|
//! | positions | u16 on a grid, whose step is the least power of two for which the mesh fits into 16 bits | half a step |
//! | normals | 8-bit octahedral | about a degree |
//! | other values | 15-bit mantissas, and one exponent per vertex | 2^-14 of the vertex's largest component |
//! | triangles | unchanged | |
//!
//! Grid points are at integer multiples of the step, so that resting fluid does not flicker between
//! frames.

mod document;
mod view;
mod write;

pub use view::{can_store, renamed};
pub use write::write_mesh;

use super::UpAxis;

/// The layout of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GlbLayout {
    /// The axis that points up in the coordinates of the particles.
    pub up: UpAxis,
    /// The encoding of the numbers.
    pub compression: GlbCompression,
}

impl GlbLayout {
    /// The layout that most programs expect: y up, not compressed.
    pub const PLAIN: Self = Self { up: UpAxis::Y, compression: GlbCompression::None };
}

/// The encoding of the numbers of a mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GlbCompression {
    /// f32 and u32 numbers, without compression.
    None,
    /// Quantized and encoded by meshoptimizer's codecs.
    Meshopt,
}

/// The grid step of compressed positions. It is the smallest power of two for which 2^16 - 2 steps
/// span `extent`.
pub fn grid_step(extent: f64) -> f64 {
    // The mesh's box is not aligned to the grid, so positions may span one more step than `extent`.
    let least = extent.max(f64::MIN_POSITIVE) / f64::from(u16::MAX - 1);
    2f64.powi(libm::log2(least).ceil() as i32)
}

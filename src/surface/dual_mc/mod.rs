//! Marching cubes on the dual grid (section 4.3).
//!
//! Samples are at the centres of cells; 2^3 of them are the corners of a dual cell. A sample is
//! inside when it is greater than the isovalue's threshold. On a dual edge (i, j) with one end
//! inside, the vertex is v = (1 - a) p_i + a p_j with a = phi_i / (phi_i - phi_j), phi = c - theta
//! (eq. 8).
//!
//! At the walls of a domain, ghost points mirror the outermost centres with phi = |phi_i|, so the
//! ghost points are outside. Where the mirrored cell is inside, the vertex is half-way between that
//! cell's centre and the ghost point, exactly on the wall.
//!
//! Meshing a block needs the field on the block and one cell beyond its upper faces; normals need
//! one more cell on all sides.

pub mod cases;
mod cpu;
mod level;
pub mod levels;
pub mod vulkan;

pub use cpu::{block_mesh, contour, normal};
pub use level::{Crossings, Level, ZeroLevel};

use crate::grid::CellBox;

/// Estimated number of vertices in a block that contains a lot of surface. If the filters keep
/// details, the estimate is for a block full of spray.
pub fn block_vertices(keeps_details: bool) -> u64 {
    if keeps_details { 20_000 } else { 6_000 }
}

/// Whether normals are computed for the vertices.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Normals {
    None,
    Gradient,
}

impl Normals {
    /// The cells whose field is needed for the surface through a region.
    #[must_use]
    pub fn cells(self, region: CellBox) -> CellBox {
        match self {
            Self::None => dual_cells(region),
            Self::Gradient => dual_cells(region).grown(1, 1),
        }
    }

    /// The region of whole tiles for which [cells](Self::cells) returns `cells`.
    #[must_use]
    pub fn region(self, cells: CellBox) -> CellBox {
        match self {
            Self::None => cells.grown(0, -1),
            Self::Gradient => cells.grown(-1, -2),
        }
    }
}

/// The cells at the corners of the dual cells of a region.
pub fn dual_cells(region: CellBox) -> CellBox {
    region.tiled().grown(0, 1)
}

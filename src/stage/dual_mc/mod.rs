//! Marching cubes on the dual grid (section 4.3).
//!
//! Samples are the cells' centres; a dual cell joins 2^3 of them. A sample is inside when it is greater
//! than the isovalue's threshold. On a dual edge (i, j) whose ends differ, the vertex is
//! v = (1 - a) p_i + a p_j with a = phi_i / (phi_i - phi_j), phi = c - theta (eq. 8).
//!
//! At the walls of a domain, ghost points mirror the outermost centres with phi = |phi_i|: outside. Where
//! the cell is inside, the vertex is half-way between centre and ghost, which is exactly on the wall.
//!
//! Needs the field on the block and one cell beyond its upper faces; normals need one cell more all round.

mod cpu;
mod level;
pub mod table;
pub mod vulkan;

pub use cpu::{contour, normal, normals};
pub use level::{Crossings, Level, Zero};

/// Whether vertices get normals.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Normals {
    None,
    Gradient,
}

//! Chooses f32 or f64 for the coordinates of a mesh.

use crate::surface::stitch::StitchedSurface;

/// Maximum distance, in cells, by which rounding to f32 may move a vertex.
const COARSEST: f64 = 1.0 / 256.0;

/// The effect of f32 on a surface's coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SinglePrecision {
    /// Rounding moves no vertex by more than 1 / 256 of a cell.
    Enough,
    /// Rounding may move vertices by more than 1 / 256 of a cell.
    TooCoarse,
    /// Some coordinates are too large for f32, or the cells are too small for f32.
    Exceeded,
}

impl SinglePrecision {
    /// Determines the effect from the cell size and from the largest coordinate of the surface's
    /// blocks.
    pub fn of(surface: &StitchedSurface) -> Self {
        let farthest = surface.farthest_coordinate();
        let step = surface.grid().cell_size() * COARSEST;
        if farthest > f64::from(f32::MAX) || step < f64::from(f32::MIN_POSITIVE) {
            Self::Exceeded
        } else if farthest * f64::from(f32::EPSILON) <= step {
            Self::Enough
        } else {
            Self::TooCoarse
        }
    }
}

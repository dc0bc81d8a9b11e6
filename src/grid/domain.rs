//! Tanks: walls that the fluid cannot leave.

use glam::{DVec3, IVec3};
use thiserror::Error;

use super::{CELL_LIMIT, CellBox, FRACTIONS, Grid};

/// Cells from the origin to where the cells of an axis without walls end: beyond all that the grid
/// has.
const OPEN: i32 = 1 << 24;

/// A box with walls that the fluid cannot leave.
///
/// Its cells are those whose centre lies inside. Walls need not fall on cell faces: the outermost
/// layer of cells reaches to the wall, from half a cell up to one and a half. An axis without walls
/// goes from -inf to inf.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Domain {
    lo: DVec3,
    hi: DVec3,
    cells: CellBox,
}

/// A box that cannot be a domain.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum DomainError {
    /// The corners are not in order, or not finite.
    #[error("the domain's corners must be finite, and the second above the first along every axis")]
    Corners,
    /// Too thin for a single layer of cells.
    #[error("the domain holds no cell centre along {axis}; use a smaller cell size")]
    Thin {
        /// x, y or z.
        axis: char,
    },
    /// Beyond the grid.
    #[error(
        "the domain reaches more than {CELL_LIMIT} cells from the origin; use a larger cell size"
    )]
    TooFar,
}

impl Domain {
    /// The box from `lo` to `hi` in world coordinates, on `grid`; an axis from -inf to inf has no
    /// walls.
    ///
    /// # Errors
    /// [`DomainError`] where the box is empty, thinner than a cell or beyond the grid.
    pub fn new(grid: &Grid, lo: DVec3, hi: DVec3) -> Result<Self, DomainError> {
        let is_open = |a: usize| lo[a] == f64::NEG_INFINITY && hi[a] == f64::INFINITY;
        let is_walled = |a: usize| lo[a].is_finite() && hi[a].is_finite() && lo[a] < hi[a];
        if !(0..3).all(|a| is_open(a) || is_walled(a)) {
            return Err(DomainError::Corners);
        }
        let lo_cells = DVec3::from(grid.cells_from_world(lo.to_array()));
        let hi_cells = DVec3::from(grid.cells_from_world(hi.to_array()));
        let mut cells = CellBox { lo: IVec3::splat(-OPEN), hi: IVec3::splat(OPEN) };
        for axis in (0..3).filter(|&a| !is_open(a)) {
            let limit = f64::from(CELL_LIMIT);
            if lo_cells[axis] < -limit || hi_cells[axis] >= limit {
                return Err(DomainError::TooFar);
            }
            // Cell k is in when lo < k + 1/2 < hi.
            cells.lo[axis] = ((lo_cells[axis] - 0.5).floor() + 1.0) as i32;
            cells.hi[axis] = (hi_cells[axis] - 0.5).ceil() as i32;
        }
        let thin = cells.lo.cmpge(cells.hi);
        match (0..3).find(|&axis| thin.test(axis)) {
            Some(axis) => Err(DomainError::Thin { axis: ['x', 'y', 'z'][axis] }),
            None => Ok(Self { lo, hi, cells }),
        }
    }

    /// Returns the cells of the domain.
    #[must_use]
    pub fn cells(&self) -> CellBox {
        self.cells
    }

    /// Returns the domain's lower and upper corner, in world coordinates.
    #[must_use]
    pub fn walls(&self) -> [DVec3; 2] {
        [self.lo, self.hi]
    }

    /// Whether a particle counts: walls belong to the domain.
    #[must_use]
    #[inline(always)]
    pub fn contains(&self, world: [f64; 3]) -> bool {
        (0..3).all(|a| world[a] >= self.lo[a] && world[a] <= self.hi[a])
    }

    /// The first and the last step of its cells, along each axis: particles between the outermost
    /// cells and a wall are put on the nearest of them.
    #[must_use]
    pub fn step_range(&self) -> [[i64; 3]; 2] {
        let first = |cells: IVec3| cells.to_array().map(|c| i64::from(c) * i64::from(FRACTIONS));
        [first(self.cells.lo), first(self.cells.hi).map(|end| end - 1)]
    }

    /// The walls of both, of which no axis has any in both.
    #[must_use]
    pub(super) fn joined(&self, other: &Self) -> Self {
        Self {
            lo: self.lo.max(other.lo),
            hi: self.hi.min(other.hi),
            cells: self.cells.intersection(&other.cells),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_domains_cells_are_those_with_their_centre_inside() {
        let grid = Grid::new(DVec3::ZERO, 0.1).unwrap();
        let aligned = Domain::new(&grid, DVec3::ZERO, DVec3::new(0.3, 0.7, 1.0)).unwrap();
        assert_eq!(aligned.cells(), CellBox { lo: IVec3::ZERO, hi: IVec3::new(3, 7, 10) });
        let off = Domain::new(&grid, DVec3::splat(-0.04), DVec3::splat(0.26)).unwrap();
        assert_eq!(off.cells(), CellBox { lo: IVec3::ZERO, hi: IVec3::splat(3) });
        assert_eq!(
            Domain::new(&grid, DVec3::ZERO, DVec3::new(1.0, 0.04, 1.0)),
            Err(DomainError::Thin { axis: 'y' })
        );
    }

    #[test]
    fn an_axis_has_two_walls_or_none() {
        let grid = Grid::new(DVec3::ZERO, 0.1).unwrap();
        let of_y = |lo: f64, hi: f64| {
            Domain::new(&grid, DVec3::new(0.0, lo, 0.0), DVec3::new(1.0, hi, 1.0))
        };
        let open = of_y(f64::NEG_INFINITY, f64::INFINITY).unwrap();
        assert!(open.contains([0.5, 1e300, 0.5]) && !open.contains([1.5, 0.5, 0.5]));
        assert!(open.cells().contains(IVec3::new(5, CELL_LIMIT, 5)));
        for (lo, hi) in
            [(f64::NEG_INFINITY, 1.0), (0.0, f64::INFINITY), (f64::INFINITY, f64::NEG_INFINITY)]
        {
            assert_eq!(of_y(lo, hi), Err(DomainError::Corners), "{lo} to {hi}");
        }
    }
}

//! Tanks: walls that the fluid cannot leave.

use std::fmt;

use glam::{DVec3, IVec3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{CELL_LIMIT, CellBox, FRACTIONS, Grid, Mirror};

/// The distance, in cells, from the origin to the end of a domain's cells at an open side. It is
/// greater than the distance to the end of the grid.
const OPEN: i32 = 1 << 24;

/// The coordinates of the lower and the upper wall along each axis; `None` for an open side.
///
/// Walls are displayed as x0,y0,z0,x1,y1,z1, with `-` for an open side.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(into = "[Option<f64>; 6]", from = "[Option<f64>; 6]")]
pub struct Walls(pub [[Option<f64>; 2]; 3]);

impl Walls {
    /// The lowest and the highest corner; open sides are at -inf and inf.
    #[must_use]
    pub fn corners(&self) -> [DVec3; 2] {
        [(0, f64::NEG_INFINITY), (1, f64::INFINITY)]
            .map(|(side, open)| DVec3::from(self.0.map(|walls| walls[side].unwrap_or(open))))
    }

    /// The walls of a box with these corners; a coordinate of -inf or inf makes its side open.
    #[must_use]
    pub fn from_corners([lowest, highest]: [[f64; 3]; 2]) -> Self {
        let wall = |at: f64, open: f64| Some(at).filter(|_| at != open);
        Self([0, 1, 2].map(|axis| {
            [wall(lowest[axis], f64::NEG_INFINITY), wall(highest[axis], f64::INFINITY)]
        }))
    }

    /// Whether no side has a wall.
    #[must_use]
    pub fn is_open(&self) -> bool {
        self.0.iter().flatten().all(Option::is_none)
    }
}

impl From<Walls> for [Option<f64>; 6] {
    fn from(Walls([x, y, z]): Walls) -> Self {
        [x[0], y[0], z[0], x[1], y[1], z[1]]
    }
}

impl From<[Option<f64>; 6]> for Walls {
    fn from([x0, y0, z0, x1, y1, z1]: [Option<f64>; 6]) -> Self {
        Self([[x0, x1], [y0, y1], [z0, z1]])
    }
}

impl fmt::Display for Walls {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ends: [Option<f64>; 6] = (*self).into();
        let shown = ends.map(|end| end.map_or("-".to_owned(), |at| at.to_string()));
        f.write_str(&shown.join(","))
    }
}

/// A box with walls that the fluid cannot leave.
///
/// A cell belongs to the domain if its centre lies inside the walls. Walls need not lie on cell
/// faces. The outermost layer of cells extends to the wall, so this layer is between 0.5 and 1.5
/// cells thick. An open side is at -inf or inf.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Domain {
    lo: DVec3,
    hi: DVec3,
    mirror: Mirror,
}

/// A box that cannot be a domain.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum DomainError {
    /// The corners are not in order, or not numbers.
    #[error(
        "invalid domain: every coordinate must be a number, and along an axis with two walls, the \
         second wall must have the larger coordinate"
    )]
    Corners,
    /// No cell's centre lies between the two walls along an axis.
    #[error(
        "the domain is too thin along {axis}: it contains no cell centre; use a smaller cell size"
    )]
    Thin {
        /// The axis: x, y or z.
        axis: char,
    },
    /// The domain extends too far from the grid's origin.
    #[error(
        "the domain extends more than {CELL_LIMIT} cells from the origin; use a larger cell \
         size"
    )]
    TooFar,
}

impl Domain {
    /// The box from `lo` to `hi` in world coordinates, on `grid`. A side at -inf or inf is open.
    ///
    /// # Errors
    /// [`DomainError`] if the corners are not in order, if the box contains no cell centre along
    /// an axis, or if it extends too far from the grid's origin.
    pub fn new(grid: &Grid, lo: DVec3, hi: DVec3) -> Result<Self, DomainError> {
        // These comparisons are false for NaN, so NaN corners are an error.
        let is_in_order =
            |a: usize| lo[a] < hi[a] && lo[a] != f64::INFINITY && hi[a] != f64::NEG_INFINITY;
        if !(0..3).all(is_in_order) {
            return Err(DomainError::Corners);
        }
        let lo_cells = DVec3::from(grid.cells_from_world(lo.to_array()));
        let hi_cells = DVec3::from(grid.cells_from_world(hi.to_array()));
        let mut cells = CellBox { lo: IVec3::splat(-OPEN), hi: IVec3::splat(OPEN) };
        let limit = f64::from(CELL_LIMIT);
        let is_far = |cells: f64| !(-limit..limit).contains(&cells);
        for axis in 0..3 {
            // Cell k is in the domain if lo < k + 1/2 < hi.
            if lo[axis].is_finite() {
                cells.lo[axis] = ((lo_cells[axis] - 0.5).floor() + 1.0) as i32;
            }
            if hi[axis].is_finite() {
                cells.hi[axis] = (hi_cells[axis] - 0.5).ceil() as i32;
            }
            if lo[axis].is_finite() && is_far(lo_cells[axis])
                || hi[axis].is_finite() && is_far(hi_cells[axis])
            {
                return Err(DomainError::TooFar);
            }
        }
        let thin = cells.lo.cmpge(cells.hi);
        match (0..3).find(|&axis| thin.test(axis)) {
            Some(axis) => Err(DomainError::Thin { axis: ['x', 'y', 'z'][axis] }),
            None => Ok(Self { lo, hi, mirror: Mirror::new(cells) }),
        }
    }

    /// Returns the cells of the domain.
    #[must_use]
    pub fn cells(&self) -> CellBox {
        self.mirror.cells()
    }

    /// The mirror at the faces of the domain's cells.
    #[must_use]
    pub fn mirror(&self) -> Mirror {
        self.mirror
    }

    /// The thickness, in cells, of the outermost layers: for each axis, at the lower and at the
    /// upper wall. `grid` is the grid to which the domain belongs. The thickness is 1 at an open
    /// side. If the domain is one cell thick between two walls, the first number is its thickness,
    /// and the second is 1.
    #[must_use]
    pub fn layers(&self, grid: &Grid) -> [[f64; 2]; 3] {
        let [lo, hi] = [self.lo, self.hi].map(|wall| grid.cells_from_world(wall.to_array()));
        let cells = self.cells();
        [0, 1, 2].map(|axis: usize| {
            let (first, end) = (f64::from(cells.lo[axis]), f64::from(cells.hi[axis]));
            if end - first == 1.0 && (hi[axis] - lo[axis]).is_finite() {
                return [hi[axis] - lo[axis], 1.0];
            }
            [first + 1.0 - lo[axis], hi[axis] - (end - 1.0)]
                .map(|cells| if cells.is_finite() { cells } else { 1.0 })
        })
    }

    /// Returns the domain's lower and upper corner, in world coordinates.
    #[must_use]
    pub fn walls(&self) -> [DVec3; 2] {
        [self.lo, self.hi]
    }

    /// Whether the domain contains a position; walls belong to the domain.
    #[must_use]
    #[inline(always)]
    pub fn contains(&self, world: [f64; 3]) -> bool {
        (0..3).all(|a| world[a] >= self.lo[a] && world[a] <= self.hi[a])
    }

    /// The first and the last fixed-point step of the domain's cells along each axis. A particle
    /// between the outermost cells and a wall moves to the nearest of these steps.
    #[must_use]
    pub fn step_range(&self) -> [[i64; 3]; 2] {
        let first = |cells: IVec3| cells.to_array().map(|c| i64::from(c) * i64::from(FRACTIONS));
        let CellBox { lo, hi } = self.cells();
        [first(lo), first(hi).map(|end| end - 1)]
    }

    /// Converts the walls to a grid whose cells are 2^`octaves` times as wide. The domain then
    /// consists of all wide cells that contain at least one cell of this domain.
    #[must_use]
    pub fn in_wider_cells(self, octaves: u32) -> Self {
        Self { mirror: self.mirror.in_wider_cells(octaves), ..self }
    }

    /// Combines the walls of both domains. No axis may have walls in both domains.
    #[must_use]
    pub(super) fn joined(&self, other: &Self) -> Self {
        Self {
            lo: self.lo.max(other.lo),
            hi: self.hi.min(other.hi),
            mirror: self.mirror.joined(other.mirror),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cells_of_a_domain_have_their_centre_inside() {
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
    fn the_outermost_layers_extend_to_the_walls() {
        let grid = Grid::new(DVec3::ZERO, 0.5).unwrap();
        let (lo, hi) = (DVec3::new(-0.1, 0.3, f64::NEG_INFINITY), DVec3::new(1.9, 0.8, 2.0));
        let domain = Domain::new(&grid, lo, hi).unwrap();
        let found =
            domain.layers(&grid).map(|layers| layers.map(|cells| (cells * 1e9).round() / 1e9));
        // Along y, the domain is one cell thick.
        assert_eq!(found, [[1.2, 0.8], [1.0, 1.0], [1.0, 1.0]]);
        let thin = Domain::new(&grid, DVec3::ZERO, DVec3::new(1.0, 0.6, 1.0)).unwrap();
        assert!((thin.layers(&grid)[1][0] - 1.2).abs() < 1e-9);
    }

    #[test]
    fn each_side_of_an_axis_is_a_wall_or_open() {
        let grid = Grid::new(DVec3::ZERO, 0.1).unwrap();
        let of_y = |lo: f64, hi: f64| {
            Domain::new(&grid, DVec3::new(0.0, lo, 0.0), DVec3::new(1.0, hi, 1.0))
        };
        let open = of_y(f64::NEG_INFINITY, f64::INFINITY).unwrap();
        assert!(open.contains([0.5, 1e300, 0.5]) && !open.contains([1.5, 0.5, 0.5]));
        assert!(open.cells().contains(IVec3::new(5, CELL_LIMIT, 5)));
        let floor = of_y(0.0, f64::INFINITY).unwrap();
        assert!(floor.contains([0.5, 1e300, 0.5]) && !floor.contains([0.5, -0.1, 0.5]));
        assert_eq!((floor.cells().lo.y, floor.cells().hi.y), (0, OPEN));
        let lid = of_y(f64::NEG_INFINITY, 1.0).unwrap();
        assert_eq!((lid.cells().lo.y, lid.cells().hi.y), (-OPEN, 10));
        let none = [f64::INFINITY, f64::NEG_INFINITY, f64::NAN];
        for (lo, hi) in [(none[0], none[1]), (none[0], none[0]), (none[2], 1.0), (1.0, 0.0)] {
            assert_eq!(of_y(lo, hi), Err(DomainError::Corners), "{lo} to {hi}");
        }
    }
}

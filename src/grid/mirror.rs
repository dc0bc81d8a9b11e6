//! Mirror images of the cells of a tank beyond its walls.

use glam::IVec3;

use super::CellBox;

/// The planes at which a field is mirrored: the walls of a tank, in cells of one width. Beyond each
/// wall, filters use the mirror image of the fluid. They therefore treat a film on a wall as a free
/// sheet twice as thick, and the surface meets the wall at a right angle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Mirror {
    /// The lower planes, in halves of a cell. A plane passes between two cells, or through the
    /// middle of a cell.
    lo: IVec3,
    /// The upper planes, in halves of a cell.
    hi: IVec3,
}

impl Mirror {
    /// Mirrors the cells of `walls` at their outer faces.
    #[must_use]
    pub fn new(walls: CellBox) -> Self {
        Self { lo: walls.lo * 2, hi: walls.hi * 2 }
    }

    /// Converts the planes to cells 2^`levels` times as wide. A plane moves outwards to the nearest
    /// boundary or middle of a wide cell, unless it already lies there.
    #[must_use]
    pub fn in_wider_cells(self, levels: u32) -> Self {
        let CellBox { lo, hi } = CellBox { lo: self.lo, hi: self.hi }.in_wider_cells(levels);
        Self { lo, hi }
    }

    /// Combines the planes of both mirrors. On each side, the inner one of the two planes applies.
    #[must_use]
    pub(super) fn joined(self, other: Self) -> Self {
        Self { lo: self.lo.max(other.lo), hi: self.hi.min(other.hi) }
    }

    /// The lower and the upper planes, in halves of a cell.
    #[must_use]
    pub fn planes(&self) -> [IVec3; 2] {
        [self.lo, self.hi]
    }

    /// The cells between the planes, including the cells through whose middle a plane passes.
    #[must_use]
    pub fn cells(&self) -> CellBox {
        CellBox { lo: self.lo >> 1, hi: (self.hi + 1) >> 1 }
    }

    /// The smallest box that contains `cells` and every cell whose mirror image lies in `cells`.
    #[must_use]
    pub fn with_sources(&self, cells: CellBox) -> CellBox {
        let mut all = cells;
        for axis in 0..3 {
            for cell in cells.lo[axis]..cells.hi[axis] {
                let source = self.source(axis, cell);
                all.lo[axis] = all.lo[axis].min(source);
                all.hi[axis] = all.hi[axis].max(source + 1);
            }
        }
        all
    }

    /// The coordinate along `axis` of the cell whose mirror image lies at the coordinate `cell`.
    /// If `cell` is farther beyond a wall than the planes are apart, the source is mirrored more
    /// than once. Between the planes, a cell is its own source.
    #[must_use]
    pub fn source(&self, axis: usize, cell: i32) -> i32 {
        let (lo, length) = (self.lo[axis], self.hi[axis] - self.lo[axis]);
        let at = (2 * cell + 1 - lo).abs() % (2 * length);
        (at.min(2 * length - at) + lo - 1) >> 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sources(mirror: Mirror, cells: std::ops::Range<i32>) -> Vec<i32> {
        cells.map(|cell| mirror.source(0, cell)).collect()
    }

    #[test]
    fn a_plane_lies_between_two_cells_or_in_the_middle_of_a_wide_cell() {
        let mirror = Mirror::new(CellBox { lo: IVec3::splat(-1), hi: IVec3::splat(4) });
        assert_eq!(sources(mirror, -6..-1), [3, 2, 1, 0, -1]);
        assert_eq!(sources(mirror, -1..4), [-1, 0, 1, 2, 3]);
        assert_eq!(sources(mirror, 4..9), [3, 2, 1, 0, -1]);

        let wide = mirror.in_wider_cells(1);
        assert_eq!(wide.cells(), CellBox { lo: IVec3::splat(-1), hi: IVec3::splat(2) });
        assert_eq!(sources(wide, -4..-1), [1, 1, 0]);
        assert_eq!(sources(wide, -1..2), [-1, 0, 1]);
        assert_eq!(sources(wide, 2..6), [1, 0, -1, 0]);
    }
}

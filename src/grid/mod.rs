//! Positions: the world-anchored cell grid, boxes of cells, Morton keys, the walls of a tank and
//! periodic boxes.
//!
//! A cell index is floor((x - origin) / h) per axis, computed in f64; cells are half-open.
//! Positions within a cell are fixed-point offsets with [`FRACTION_BITS`] bits, so sums over
//! particles are integers and do not depend on the order of the particles.

mod domain;
mod levels;
mod mirror;
mod periodic;
pub mod stretch;
pub mod units;

pub use domain::{Domain, DomainError, Walls};
pub use levels::{BlockLevel, LevelRegion};
pub use mirror::Mirror;
pub(crate) use periodic::InBox;
pub use periodic::{Periodic, PeriodicError, PeriodicMesh};

use glam::{DVec3, IVec3};
use hashbrown::HashMap;

use crate::grid::units::{UnitError, positive_length};

/// Number of bits, along each axis, of a particle's offset in its cell.
pub const FRACTION_BITS: u32 = 13;
/// Fixed-point steps per cell edge: `F` in the integer formulas of the indicators.
pub const FRACTIONS: u32 = 1 << FRACTION_BITS;

/// Edge of a tile, in cells. A tile has 64 cells, so one bit per cell fits in a machine word.
pub const TILE: i32 = 4;
/// Edge of a bin, in cells. A bin is the unit in which particles are sorted and samples are stored
/// (in pages).
pub const BIN: i32 = 16;
/// Edge of a block, in cells. A block is the unit in which the field is smoothed and meshed.
pub const BLOCK: i32 = 32;
/// Number of tiles in a block.
pub const BLOCK_TILES: u32 = (BLOCK / TILE).pow(3) as u32;

/// Maximum number of levels of cells in a frame. The cells of each level are twice as wide as the
/// cells of the previous level.
pub const MOST_LEVELS: usize = 7;

/// Number of cells from the origin to the end of the grid, in both directions of each axis. It
/// follows from the 21 bits per axis of a tile's Morton key, minus a margin for the reach of the
/// widest filter.
pub const CELL_LIMIT: i32 = (TILE << 20) - 4 * BLOCK;

/// [`CELL_LIMIT`] in fixed-point steps.
pub const STEP_LIMIT: f64 = CELL_LIMIT as f64 * FRACTIONS as f64;

/// The sampling grid: cubic cells with edge `cell`, anchored at `origin`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    origin: DVec3,
    cell: f64,
}

/// The reason why the grid cannot hold a position.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlacementError {
    /// A coordinate is NaN or infinite.
    NotFinite,
    /// A coordinate is more than [`CELL_LIMIT`] cells from the origin.
    TooFar,
}

impl Grid {
    /// A grid of cells with edge `cell` whose cell (0, 0, 0) has its lowest corner at `origin`.
    ///
    /// # Errors
    /// [`UnitError::Length`] unless the edge is positive and finite, [`UnitError::NotFinite`]
    /// unless the origin is finite.
    pub fn new(origin: DVec3, cell: f64) -> Result<Self, UnitError> {
        positive_length("cell-size", cell)?;
        match origin.to_array().iter().find(|x| !x.is_finite()) {
            Some(&value) => Err(UnitError::NotFinite { name: "origin", value }),
            None => Ok(Self { origin, cell }),
        }
    }

    /// The grid with the same origin whose cells are 2^`octaves` times as wide.
    #[must_use]
    pub fn in_wider_cells(self, octaves: u32) -> Self {
        Self { cell: self.cell * f64::from(1_u32 << octaves), ..self }
    }

    /// Edge of a cell, in the particles' unit of length.
    #[must_use]
    pub fn cell_size(&self) -> f64 {
        self.cell
    }

    /// The lowest corner of cell (0, 0, 0).
    #[must_use]
    pub fn origin(&self) -> DVec3 {
        self.origin
    }

    /// Converts a world position to units of cells; integer coordinates are cell faces.
    #[must_use]
    #[inline(always)]
    pub fn cells_from_world(&self, world: [f64; 3]) -> [f64; 3] {
        [
            (world[0] - self.origin.x) / self.cell,
            (world[1] - self.origin.y) / self.cell,
            (world[2] - self.origin.z) / self.cell,
        ]
    }

    /// The inverse of [`cells_from_world`](Self::cells_from_world).
    #[must_use]
    pub fn world_from_cells(&self, cells: DVec3) -> DVec3 {
        self.origin + self.cell * cells
    }

    /// Converts a position to steps of 1 / [`FRACTIONS`] of a cell from the origin, rounded down.
    /// The bits of a coordinate are the cell index, followed by [`FRACTION_BITS`] bits of the
    /// offset in the cell.
    ///
    /// # Errors
    /// [`PlacementError`] if the grid does not reach the position.
    pub fn place(&self, world: [f64; 3]) -> Result<[i64; 3], PlacementError> {
        // Multiplication by a power of two is exact, and f64 represents every step up to the limit
        // exactly.
        let steps = self.cells_from_world(world).map(|c| (c * f64::from(FRACTIONS)).floor());
        // These comparisons are false for NaN, so NaN coordinates are an error.
        if !steps.iter().all(|s| (-STEP_LIMIT..STEP_LIMIT).contains(s)) {
            let finite = world.iter().all(|x| x.is_finite());
            return Err(if finite { PlacementError::TooFar } else { PlacementError::NotFinite });
        }
        Ok(steps.map(|s| s as i64))
    }
}

/// A box of cells, from `lo` up to but not including `hi`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CellBox {
    /// Lowest cell.
    pub lo: IVec3,
    /// One past the highest cell.
    pub hi: IVec3,
}

impl CellBox {
    /// An empty box; its union with another box is the other box.
    pub const EMPTY: Self = Self { lo: IVec3::MAX, hi: IVec3::MIN };

    /// The cube at `coord` with edges of `edge` cells. `coord` is in units of such cubes.
    pub fn cube(coord: IVec3, edge: i32) -> Self {
        Self { lo: coord * edge, hi: (coord + 1) * edge }
    }

    /// Whether the box contains no cells.
    pub fn is_empty(&self) -> bool {
        self.lo.cmpge(self.hi).any()
    }

    /// Edge lengths in cells.
    pub fn size(&self) -> IVec3 {
        self.hi - self.lo
    }

    /// Number of cells.
    pub fn volume(&self) -> usize {
        if self.is_empty() { 0 } else { self.size().as_usizevec3().element_product() }
    }

    /// Whether the box contains `cell`.
    pub fn contains(&self, cell: IVec3) -> bool {
        cell.cmpge(self.lo).all() && cell.cmplt(self.hi).all()
    }

    /// Whether the box contains all cells of `other`.
    pub fn covers(&self, other: &Self) -> bool {
        other.lo.cmpge(self.lo).all() && other.hi.cmple(self.hi).all()
    }

    /// The box, extended by `below` cells at every lower face and by `above` cells at every upper
    /// face.
    pub fn grown(&self, below: i32, above: i32) -> Self {
        Self { lo: self.lo - below, hi: self.hi + above }
    }

    /// Returns the box of cells that both boxes contain.
    pub fn intersection(&self, other: &Self) -> Self {
        Self { lo: self.lo.max(other.lo), hi: self.hi.min(other.hi) }
    }

    /// The smallest box that contains both boxes.
    pub fn union(&self, other: &Self) -> Self {
        Self { lo: self.lo.min(other.lo), hi: self.hi.max(other.hi) }
    }

    /// The smallest box that contains this one, in cells that are 2^`levels` times as wide.
    pub fn in_wider_cells(&self, levels: u32) -> Self {
        let last = (1 << levels) - 1;
        Self { lo: self.lo >> levels, hi: (self.hi + last) >> levels }
    }

    /// Converts the box to narrower cells: each cell becomes 2^`levels` cells along each axis.
    pub fn in_narrower_cells(&self, levels: u32) -> Self {
        Self { lo: self.lo << levels, hi: self.hi << levels }
    }

    /// The smallest box that contains this box and the cells of `other` that are nearest to this
    /// box.
    pub fn with_nearest(&self, other: &Self) -> Self {
        let nearest = |cell: IVec3| cell.clamp(other.lo, other.hi - 1);
        self.union(&Self { lo: nearest(self.lo), hi: nearest(self.hi - 1) + 1 })
    }

    /// This box [with the nearest cells](Self::with_nearest) of `walls`; this box itself if there
    /// are no walls.
    pub fn with_nearest_of(&self, walls: Option<Self>) -> Self {
        walls.map_or(*self, |walls| self.with_nearest(&walls))
    }

    /// The smallest box of whole tiles that contains this one.
    pub fn tiled(&self) -> Self {
        let tile = IVec3::splat(TILE);
        Self {
            lo: self.lo.div_euclid(tile) * TILE,
            hi: (self.hi + (TILE - 1)).div_euclid(tile) * TILE,
        }
    }

    /// The coordinates of the cubes with edges of `edge` cells that overlap the box. x varies
    /// fastest.
    pub fn cubes(&self, edge: i32) -> impl Iterator<Item = IVec3> + use<> {
        let edge = IVec3::splat(edge);
        let lo = self.lo.div_euclid(edge);
        let hi = if self.is_empty() { lo } else { (self.hi - 1).div_euclid(edge) + 1 };
        (lo.z..hi.z).flat_map(move |z| {
            (lo.y..hi.y).flat_map(move |y| (lo.x..hi.x).map(move |x| IVec3::new(x, y, z)))
        })
    }
}

/// For each block that overlaps any of `boxes`, the smallest box that contains the overlaps. The
/// returned boxes are in the Morton order of the blocks.
pub fn block_parts(boxes: impl Iterator<Item = CellBox>) -> Vec<CellBox> {
    let mut parts: HashMap<IVec3, CellBox> = HashMap::new();
    for cells in boxes {
        for block in cells.cubes(BLOCK) {
            let part = parts.entry(block).or_insert(CellBox::EMPTY);
            *part = part.union(&cells.intersection(&CellBox::cube(block, BLOCK)));
        }
    }
    let mut parts: Vec<_> = parts.into_iter().collect();
    parts.sort_unstable_by_key(|&(block, _)| MortonKey::of(block));
    parts.into_iter().map(|(_, cells)| cells).collect()
}

/// The offset (x, y, z) of corner number x + 2 y + 4 z of a cube.
pub fn corner_offset(corner: i32) -> IVec3 {
    IVec3::new(corner & 1, corner >> 1 & 1, corner >> 2)
}

/// The position of a cube on the Morton curve: 21 bits per axis, biased so that negative
/// coordinates come first.
///
/// The order of keys is the order on the curve, for cubes of any size. The keys of a cube's
/// children are consecutive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct MortonKey(pub u64);

impl MortonKey {
    /// Number of bits per coordinate.
    pub const AXIS_BITS: u32 = 21;
    const BIAS: i32 = 1 << (Self::AXIS_BITS - 1);

    /// The key of the cube at `coord`, in units of cubes.
    ///
    /// # Panics
    /// If a coordinate is more than 2^20 cubes from the origin. Tiles within [`CELL_LIMIT`] are
    /// closer than that.
    pub fn of(coord: IVec3) -> Self {
        let biased = (coord + Self::BIAS).as_uvec3();
        assert!(biased.max_element() < 1 << Self::AXIS_BITS, "{coord} is beyond the Morton range");
        Self(spread(biased.x) | spread(biased.y) << 1 | spread(biased.z) << 2)
    }

    /// The inverse of [`of`](Self::of).
    pub fn coord(self) -> IVec3 {
        let axis = |shift: u32| gather(self.0 >> shift) as i32;
        IVec3::new(axis(0), axis(1), axis(2)) - Self::BIAS
    }
}

/// The coordinates of the block that contains `bin`. They are in units of blocks; `bin` is in units
/// of bins.
pub fn block_of_bin(bin: IVec3) -> IVec3 {
    bin.div_euclid(IVec3::splat(BLOCK / BIN))
}

/// The Morton index of a cube among its siblings in a parent of at most 2^10 cubes per axis.
pub fn local_morton(local: IVec3) -> usize {
    let local = local.as_uvec3();
    (spread(local.x) | spread(local.y) << 1 | spread(local.z) << 2) as usize
}

/// The inverse of [`local_morton`].
pub fn local_from_morton(index: usize) -> IVec3 {
    let axis = |shift: u32| gather(index as u64 >> shift) as i32;
    IVec3::new(axis(0), axis(1), axis(2))
}

/// Moves bit i to bit 3 i, for each of the lowest 21 bits.
fn spread(bits: u32) -> u64 {
    let mut x = u64::from(bits);
    for (shift, mask) in [
        (32, 0x001f_0000_0000_ffff),
        (16, 0x001f_0000_ff00_00ff),
        (8, 0x100f_00f0_0f00_f00f),
        (4, 0x10c3_0c30_c30c_30c3),
        (2, 0x1249_2492_4924_9249),
    ] {
        x = (x | x << shift) & mask;
    }
    x
}

/// Moves bit 3 i to bit i, and drops all other bits.
fn gather(bits: u64) -> u32 {
    let mut x = bits & 0x1249_2492_4924_9249;
    for (shift, mask) in [
        (2, 0x10c3_0c30_c30c_30c3),
        (4, 0x100f_00f0_0f00_f00f),
        (8, 0x001f_0000_ff00_00ff),
        (16, 0x001f_0000_0000_ffff),
        (32, 0x0000_0000_001f_ffff),
    ] {
        x = (x | x >> shift) & mask;
    }
    x as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn morton_keys_round_trip_and_sort_negative_coordinates_first() {
        for coord in [
            IVec3::ZERO,
            IVec3::new(-1, 5, 77),
            IVec3::splat(-(1 << 20)),
            IVec3::splat((1 << 20) - 1),
        ] {
            assert_eq!(MortonKey::of(coord).coord(), coord);
        }
        assert!(MortonKey::of(IVec3::NEG_ONE) < MortonKey::of(IVec3::ZERO));
        for index in 0..512 {
            assert_eq!(local_morton(local_from_morton(index)), index);
        }
    }

    #[test]
    fn a_position_is_rounded_down_to_its_cell_and_offset() {
        let grid = Grid::new(DVec3::ZERO, 0.5).unwrap();
        let steps = grid.place([-0.125, 0.5, 0.749_999_9]).unwrap();
        assert_eq!(steps, [-8192 + 6144, 8192, 8192 + 4095]);
        assert_eq!(grid.place([f64::NAN, 0.0, 0.0]), Err(PlacementError::NotFinite));
        assert_eq!(grid.place([0.0, f64::INFINITY, 0.0]), Err(PlacementError::NotFinite));
        assert_eq!(grid.place([0.0, 0.0, 1e30]), Err(PlacementError::TooFar));
    }

    #[test]
    fn a_tiny_negative_coordinate_stays_in_the_cell_below() {
        let grid = Grid::new(DVec3::ZERO, 1.0).unwrap();
        assert_eq!(grid.place([-1e-20, 0.0, 0.0]), Ok([-1, 0, 0]));
    }
}

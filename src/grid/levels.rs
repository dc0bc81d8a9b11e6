//! Blocks whose cells have different levels: cells of level k are 2^k times as wide as the finest.

use glam::IVec3;

use super::{BLOCK, CellBox, MOST_LEVELS};

/// The part of a block through which a surface can pass.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LevelRegion {
    /// The level of the block's cells.
    pub level: u8,
    /// The cells of the part, on the lattice of `level`.
    pub cells: CellBox,
}

impl LevelRegion {
    /// Creates a region of level 0, which has the finest cells.
    #[must_use]
    pub fn finest(cells: CellBox) -> Self {
        Self { level: 0, cells }
    }

    /// The coordinates of the first block of level 0 in the region's block.
    #[must_use]
    pub fn first_block(&self) -> IVec3 {
        self.block() << i32::from(self.level)
    }

    /// The coordinates of the region's block, in units of blocks of its level.
    #[must_use]
    pub fn block(&self) -> IVec3 {
        self.cells.lo.div_euclid(IVec3::splat(BLOCK))
    }
}

/// The level of a block's cells, and which neighbouring blocks have wider or narrower cells.
///
/// Cells of level k are 2^k times as wide as the finest. Cells of levels k and k + 1 can touch. The
/// seam between them is meshed in a block of level k, on the lattice of that level, in which each
/// wide cell counts as 2^3 cells with the same sample. Such a block can itself lie inside a block
/// of wide cells. A vertex between two wide cells belongs to the block of those cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct BlockLevel {
    /// The level of the block's lattice.
    pub level: u8,
    /// The blocks with wider cells: bit 0 for the block itself, bit x + 2 y + 4 z for the upper
    /// neighbour at offset (x, y, z).
    pub wider: u8,
    /// The blocks with narrower cells, in the same bits.
    pub narrower: u8,
}

impl BlockLevel {
    /// Packs all fields into one number.
    #[must_use]
    pub fn packed(self) -> u32 {
        u32::from_le_bytes([self.level, self.wider, self.narrower, 0])
    }

    /// The inverse of [`packed`](Self::packed); `None` for a number that `packed` never returns.
    #[must_use]
    pub fn unpacked(packed: u32) -> Option<Self> {
        let [level, wider, narrower, unused] = packed.to_le_bytes();
        let valid = unused == 0 && wider & narrower == 0 && usize::from(level) < MOST_LEVELS;
        valid.then_some(Self { level, wider, narrower })
    }

    /// Whether all cells of the block and of its upper neighbours have the block's level.
    #[must_use]
    pub fn is_uniform(self) -> bool {
        self.wider == 0 && self.narrower == 0
    }

    /// The first block of level 0 in `block`, which is a block of this level.
    #[must_use]
    pub fn first_block(self, block: IVec3) -> IVec3 {
        block << i32::from(self.level)
    }

    /// The first block of level 0 in `block` or, if `block` lies in a block with wider cells, in
    /// that wider block. A block in a seam is meshed together with the wider block that contains
    /// it.
    #[must_use]
    pub fn home(self, block: IVec3) -> IVec3 {
        let wider = i32::from(self.wider & 1);
        (block >> wider) << (i32::from(self.level) + wider)
    }

    /// Whether `cell` is part of a wider cell. `cell` is in the block's lattice, at most one cell
    /// beyond the upper faces of `block`.
    #[must_use]
    pub fn is_wider(self, block: IVec3, cell: IVec3) -> bool {
        let beyond = cell.cmpge((block + 1) * BLOCK);
        self.wider >> beyond.bitmask() & 1 == 1
    }
}

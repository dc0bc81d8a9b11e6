//! Blocks of cells of several levels: cells of level k are 2^k times as wide as the finest.

use glam::IVec3;

use super::{BLOCK, CellBox, MOST_LEVELS};

/// Part of a block in which there can be a surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LevelRegion {
    /// The level of the block's cells.
    pub level: u8,
    /// The part, in cells of that level.
    pub cells: CellBox,
}

impl LevelRegion {
    /// A part of one of the finest blocks.
    #[must_use]
    pub fn finest(cells: CellBox) -> Self {
        Self { level: 0, cells }
    }

    /// The first of the finest blocks in the block.
    #[must_use]
    pub fn first_block(&self) -> IVec3 {
        self.block() << i32::from(self.level)
    }

    /// The block, in blocks of its level.
    #[must_use]
    pub fn block(&self) -> IVec3 {
        self.cells.lo.div_euclid(IVec3::splat(BLOCK))
    }
}

/// The level of a block's cells, and which neighbouring blocks have wider or narrower cells.
///
/// Cells of level k are 2^k times as wide as the finest. Cells of levels k and k + 1 can touch. The
/// surface between them is made on the lattice of level k, by a block of that level, where a wide
/// cell counts as 2^3 cells with one sample. Such a block can itself lie among wide cells. A vertex
/// between two wide cells belongs to their block.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct BlockLevel {
    /// The level of the block's lattice.
    pub level: u8,
    /// The blocks with wider cells: bit 0 for the block itself, bit x + 2 y + 4 z for an upper
    /// neighbour.
    pub wider: u8,
    /// The blocks with narrower cells, by the same bits.
    pub narrower: u8,
}

impl BlockLevel {
    /// The number in which all fields are packed.
    #[must_use]
    pub fn packed(self) -> u32 {
        u32::from_le_bytes([self.level, self.wider, self.narrower, 0])
    }

    /// The inverse of [`packed`](Self::packed); `None` for a number that it never returns.
    #[must_use]
    pub fn unpacked(packed: u32) -> Option<Self> {
        let [level, wider, narrower, nothing] = packed.to_le_bytes();
        let valid = nothing == 0 && wider & narrower == 0 && usize::from(level) < MOST_LEVELS;
        valid.then_some(Self { level, wider, narrower })
    }

    /// Whether all cells of the block and of its upper neighbours have its level.
    #[must_use]
    pub fn is_uniform(self) -> bool {
        self.wider == 0 && self.narrower == 0
    }

    /// The first of the finest blocks that a block of this level contains.
    #[must_use]
    pub fn first_block(self, block: IVec3) -> IVec3 {
        block << i32::from(self.level)
    }

    /// The first of the finest blocks in `block` or, if `block` lies in a block with wider cells,
    /// in that wider block. A seam is made together with the wide cells in which it lies.
    #[must_use]
    pub fn home(self, block: IVec3) -> IVec3 {
        let wider = i32::from(self.wider & 1);
        (block >> wider) << (i32::from(self.level) + wider)
    }

    /// Whether a cell of the block's lattice, at most one beyond the upper faces of `block`, is
    /// part of a wider cell.
    #[must_use]
    pub fn is_wider(self, block: IVec3, cell: IVec3) -> bool {
        let beyond = cell.cmpge((block + 1) * BLOCK);
        self.wider >> beyond.bitmask() & 1 == 1
    }
}

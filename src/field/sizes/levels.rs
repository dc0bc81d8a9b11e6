//! The level of the cells in each block, which follows the sizes of nearby particles.
//!
//! Blocks form an octree: a block of level k has 32^3 cells, and each is 2^k times as wide as the
//! finest. A block is divided into blocks of level k - 1 in two cases: particles of octave k - 1
//! are near it, or it touches a divided child of a block next to it. So the levels of blocks that
//! touch differ by at most one.

use glam::IVec3;
use hashbrown::{HashMap, HashSet};

use crate::grid::{BLOCK, BlockLevel, CellBox, LevelRegion, MortonKey};

use super::{SizedClouds, averaging};

/// The blocks of each level from 1 that are near particles of the octave below.
pub type FinerBlocks = Vec<Vec<[i32; 3]>>;

/// The level of the cells of each block.
#[derive(Debug, Clone, Default)]
pub struct BlockLevels {
    /// The blocks of each level from 1 that are divided into blocks of the level below.
    divided: Vec<HashSet<IVec3>>,
}

impl SizedClouds {
    /// The blocks of each level from 1 that are near particles of the octave below, in Morton
    /// order.
    #[must_use]
    pub fn finer_blocks(&self) -> FinerBlocks {
        // The reach of the filter that averages sizes, in cells of an octave, which is more than
        // that of drops. In cells of the next octave, this is twice as far.
        let wide = self.wide_cells();
        let margin = (averaging(wide).reach() + 1) << wide.level;
        let of_level = |level: usize| {
            let boxes = self.octave(level - 1).dif.infos().iter().map(|info| {
                let CellBox { lo, hi } = info.full;
                CellBox { lo: lo >> 1, hi: ((hi - 1) >> 1) + 1 }.grown(margin, margin)
            });
            let mut blocks: Vec<IVec3> = boxes.flat_map(|cells| cells.cubes(BLOCK)).collect();
            blocks.sort_unstable_by_key(|&block| MortonKey::of(block));
            blocks.dedup();
            blocks.iter().map(IVec3::to_array).collect()
        };
        (1..self.octaves()).map(of_level).collect()
    }
}

impl BlockLevels {
    /// From the blocks of each level that are near particles of the octave below.
    #[must_use]
    pub fn new(finer: &FinerBlocks) -> Self {
        let mut divided: Vec<HashSet<IVec3>> = Vec::new();
        for blocks in finer {
            let mut of_level: HashSet<IVec3> = blocks.iter().map(|&block| block.into()).collect();
            for &block in divided.last().into_iter().flatten() {
                let around = CellBox { lo: block - 1, hi: block + 2 };
                of_level.extend(around.cubes(1).map(|block| block >> 1));
            }
            divided.push(of_level);
        }
        Self { divided }
    }

    /// The number of levels.
    #[must_use]
    pub fn count(&self) -> usize {
        self.divided.len() + 1
    }

    /// Whether a block of a level is divided into narrower ones.
    fn is_divided(&self, level: u8, block: IVec3) -> bool {
        let of_level = usize::from(level).checked_sub(1).and_then(|i| self.divided.get(i));
        of_level.is_some_and(|divided| divided.contains(&block))
    }

    /// Whether a block of a level is part of a wider one that is not divided.
    fn is_in_wider(&self, level: u8, block: IVec3) -> bool {
        usize::from(level) + 1 < self.count() && !self.is_divided(level + 1, block >> 1)
    }

    /// A block on the lattice of a level, with the levels of its cells and of its upper neighbours'.
    #[must_use]
    pub fn of(&self, level: u8, block: IVec3) -> BlockLevel {
        let mut of_block = BlockLevel { level, ..BlockLevel::default() };
        if self.count() == 1 {
            return of_block;
        }
        for upper in 0..8 {
            let block = block + IVec3::new(upper & 1, upper >> 1 & 1, upper >> 2);
            of_block.wider |= u8::from(self.is_in_wider(level, block)) << upper;
            of_block.narrower |= u8::from(self.is_divided(level, block)) << upper;
        }
        of_block
    }

    /// The parts of blocks that overlap some boxes of the finest cells, as one box per block, in
    /// the Morton order of their first cells.
    #[must_use]
    pub fn regions(&self, boxes: impl Iterator<Item = CellBox>) -> Vec<LevelRegion> {
        let widest = self.count() as u8 - 1;
        let mut parts: HashMap<(u8, IVec3), CellBox> = HashMap::new();
        for cells in boxes {
            let mut blocks: Vec<(u8, IVec3)> =
                cells.cubes(BLOCK << widest).map(|block| (widest, block)).collect();
            while let Some((level, block)) = blocks.pop() {
                let own = CellBox::cube(block, BLOCK << level);
                let part = own.intersection(&cells);
                if part.is_empty() {
                    continue;
                }
                if self.is_divided(level, block) {
                    let children = CellBox { lo: 2 * block, hi: 2 * block + 2 };
                    blocks.extend(children.cubes(1).map(|block| (level - 1, block)));
                    continue;
                }
                let CellBox { lo, hi } = part;
                let shift = i32::from(level);
                let part = CellBox { lo: lo >> shift, hi: ((hi - 1) >> shift) + 1 };
                let of_block = parts.entry((level, block)).or_insert(CellBox::EMPTY);
                *of_block = of_block.union(&part);
            }
        }
        let mut regions: Vec<LevelRegion> =
            parts.into_iter().map(|((level, _), cells)| LevelRegion { level, cells }).collect();
        regions.sort_unstable_by_key(|region| MortonKey::of(region.first_block()));
        regions
    }

    /// The blocks of the level below in a block that lie at narrower cells, with the parts of them
    /// in which cells of both levels meet, in Morton order.
    #[must_use]
    pub fn seams(&self, region: LevelRegion) -> Vec<LevelRegion> {
        let LevelRegion { level, cells } = region;
        let (Some(below), true) = (level.checked_sub(1), self.count() > 1) else {
            return Vec::new();
        };
        // A cell further on each side, because the wide ones are rounded.
        let near = CellBox { lo: 2 * cells.lo, hi: 2 * cells.hi }.grown(2, 2);
        let mut children: Vec<IVec3> = CellBox::cube(region.block(), 2).cubes(1).collect();
        children.sort_unstable_by_key(|&block| MortonKey::of(block));
        let seam = |block: IVec3| {
            let BlockLevel { wider, .. } = self.of(below, block);
            let part = (1..8_u8).filter(|upper| wider >> upper & 1 == 0).fold(
                CellBox::EMPTY,
                |all, upper| {
                    // The last layer of cells along each axis on which the blocks differ.
                    let own = CellBox::cube(block, BLOCK);
                    let is_last = |axis: usize| upper >> axis & 1 == 1;
                    let lo = [0, 1, 2]
                        .map(|axis| if is_last(axis) { own.hi[axis] - 1 } else { own.lo[axis] });
                    all.union(&CellBox { lo: lo.into(), hi: own.hi })
                },
            );
            let cells = part.intersection(&near);
            (!cells.is_empty()).then_some(LevelRegion { level: below, cells })
        };
        children.into_iter().filter_map(seam).collect()
    }
}

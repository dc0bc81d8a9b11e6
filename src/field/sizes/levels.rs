//! The level of the cells in each block, which follows the sizes of nearby particles.
//!
//! Blocks form an octree: a block of level k has 32^3 cells, each 2^k times as wide as the finest
//! cells. A block is divided into blocks of level k - 1 in two cases: particles of octave k - 1 are
//! near it, or a block of level k - 1 in it or next to it is divided. Therefore, the levels of
//! blocks that touch differ by at most one.

use glam::IVec3;
use hashbrown::{HashMap, HashSet};

use crate::grid::{BLOCK, BlockLevel, CellBox, LevelRegion, MortonKey, corner_offset};

use super::{SizedClouds, averaging};

/// For each level from 1 up, the blocks that are near particles of the next finer octave.
pub type FinerBlocks = Vec<Vec<[i32; 3]>>;

/// The level of the cells of each block.
#[derive(Debug, Clone, Default)]
pub struct BlockLevels {
    /// For each level from 1 up, the blocks that are divided into blocks of the level below.
    divided: Vec<HashSet<IVec3>>,
}

impl SizedClouds {
    /// For each level from 1 up, the blocks that are near particles of the next finer octave, in
    /// Morton order.
    #[must_use]
    pub fn finer_blocks(&self) -> FinerBlocks {
        // `margin` is the reach of the filter that averages sizes, plus one wide cell, in cells of
        // an octave. This reach is larger than the reach of drops. Below, the margin is counted in
        // cells of the next coarser octave, so it is twice as wide.
        let wide = self.wide_cells();
        let margin = (averaging(wide).reach() + 1) << wide.level;
        let of_level = |level: usize| {
            let boxes = self
                .octave(level - 1)
                .dif
                .infos()
                .iter()
                .map(|info| info.full.in_wider_cells(1).grown(margin, margin));
            let mut blocks: Vec<IVec3> = boxes.flat_map(|cells| cells.cubes(BLOCK)).collect();
            blocks.sort_unstable_by_key(|&block| MortonKey::of(block));
            blocks.dedup();
            blocks.iter().map(IVec3::to_array).collect()
        };
        (1..self.octaves()).map(of_level).collect()
    }
}

impl BlockLevels {
    /// Memory, in bytes, for each bin of particles. In cells of half a spacing, the surroundings of
    /// a bin touch up to eight blocks, and each block is stored in a list and in a hash table.
    pub const BIN_BYTES: u64 = 8 * 3 * size_of::<IVec3>() as u64;

    /// Makes the levels from the blocks of each level that are near particles of the next finer
    /// octave.
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

    /// A block on the lattice of a level, with the levels of its own cells and of the cells of its
    /// upper neighbours.
    #[must_use]
    pub fn of(&self, level: u8, block: IVec3) -> BlockLevel {
        let mut of_block = BlockLevel { level, ..BlockLevel::default() };
        if self.count() == 1 {
            return of_block;
        }
        for upper in 0..8 {
            let block = block + corner_offset(upper);
            of_block.wider |= u8::from(self.is_in_wider(level, block)) << upper;
            of_block.narrower |= u8::from(self.is_divided(level, block)) << upper;
        }
        of_block
    }

    /// The parts of blocks that overlap `boxes`, which are in the finest cells. There is one box
    /// per block, in the Morton order of the blocks' first cells.
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
                let part = part.in_wider_cells(level.into());
                let of_block = parts.entry((level, block)).or_insert(CellBox::EMPTY);
                *of_block = of_block.union(&part);
            }
        }
        let mut regions: Vec<LevelRegion> =
            parts.into_iter().map(|((level, _), cells)| LevelRegion { level, cells }).collect();
        regions.sort_unstable_by_key(|region| MortonKey::of(region.first_block()));
        regions
    }

    /// The seams between a region and its neighbours with narrower cells, in Morton order. The
    /// level below has narrower cells. A block of that level in the region's block has a seam if
    /// narrower cells adjoin one of its upper faces, edges or corners. The seam is the part of that
    /// block in which cells of both levels meet.
    #[must_use]
    pub fn seams(&self, region: LevelRegion) -> Vec<LevelRegion> {
        let LevelRegion { level, cells } = region;
        let (Some(below), true) = (level.checked_sub(1), self.count() > 1) else {
            return Vec::new();
        };
        // The box is extended by one wide cell on each side, because the region was rounded to wide
        // cells.
        let near = cells.in_narrower_cells(1).grown(2, 2);
        let mut children: Vec<IVec3> = CellBox::cube(region.block(), 2).cubes(1).collect();
        children.sort_unstable_by_key(|&block| MortonKey::of(block));
        let seam = |block: IVec3| {
            let BlockLevel { wider, .. } = self.of(below, block);
            let part = (1..8_u8).filter(|upper| wider >> upper & 1 == 0).fold(
                CellBox::EMPTY,
                |all, upper| {
                    // Cells of both levels meet in the last layer of the block's cells along each
                    // axis on which the two blocks differ.
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Levels of blocks near a few places.
    fn levels() -> BlockLevels {
        let near = |blocks: &[[i32; 3]]| blocks.to_vec();
        BlockLevels::new(&vec![
            near(&[[3, 1, 0], [-2, 5, 1], [-2, 4, 1]]),
            near(&[[4, 4, 4]]),
            near(&[[-3, 0, 0]]),
        ])
    }

    /// The level of the cells in one of the finest blocks.
    fn level_of(levels: &BlockLevels, block: IVec3) -> i32 {
        let is_leaf = |&level: &u8| {
            let BlockLevel { wider, narrower, .. } = levels.of(level, block >> i32::from(level));
            (wider | narrower) & 1 == 0
        };
        let found: Vec<u8> = (0..levels.count() as u8).filter(is_leaf).collect();
        assert_eq!(found.len(), 1, "{block} has cells of one level");
        i32::from(found[0])
    }

    #[test]
    fn blocks_that_touch_differ_by_at_most_one_level() {
        let levels = levels();
        let all = CellBox { lo: IVec3::splat(-40), hi: IVec3::splat(40) };
        let mut blocks_of_level = [0; 4];
        for block in all.cubes(1) {
            let own = level_of(&levels, block);
            blocks_of_level[own as usize] += 1;
            for axis in IVec3::AXES {
                let other = level_of(&levels, block + axis);
                assert!((own - other).abs() <= 1, "{block}: {own} beside {other}");
            }
            let other = level_of(&levels, block + 1);
            assert!((own - other).abs() <= 1, "{block}: {own} at a corner of {other}");
        }
        assert_eq!(blocks_of_level[0], 3 * 8, "three blocks are divided");
        assert!(blocks_of_level.iter().all(|&blocks| blocks > 20), "{blocks_of_level:?}");
        assert_eq!(level_of(&levels, IVec3::new(6, 2, 0)), 0, "particles of the finest octave");
    }

    #[test]
    fn every_block_in_a_box_has_one_region_and_seams_lie_at_narrower_blocks() {
        let levels = levels();
        let cells = CellBox { lo: IVec3::splat(-700), hi: IVec3::splat(900) };
        let regions = levels.regions([cells].into_iter());
        let volume = |region: &LevelRegion| region.cells.volume() << (3 * region.level);
        let sum: usize = regions.iter().map(volume).sum();
        // If the box cuts a wide cell, the whole cell belongs to a region.
        assert!((cells.volume()..cells.volume() * 102 / 100).contains(&sum));
        assert!(regions.is_sorted_by_key(|region| MortonKey::of(region.first_block())));
        let mut seams = 0;
        for region in regions {
            let narrower = levels.of(region.level, region.block()).narrower != 0;
            let found = levels.seams(region);
            assert_eq!(!found.is_empty(), narrower, "{region:?}");
            seams += found.len();
            for seam in found {
                let of_seam = levels.of(seam.level, seam.block());
                assert_eq!((seam.level + 1, of_seam.wider & 1), (region.level, 1));
                assert!(of_seam.wider != 0xff && of_seam.narrower == 0, "{seam:?}");
            }
        }
        assert!(seams > 50, "{seams}");
    }
}

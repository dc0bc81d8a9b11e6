//! Stretches of the Morton curve of blocks, and the bins whose particles affect them.

use glam::IVec3;

use super::{BIN, BLOCK, CellBox, MortonKey, block_of_bin};

/// Consecutive blocks along the Morton curve, as a half-open range of keys.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stretch {
    /// The key of the first block.
    pub first: MortonKey,
    /// The key after the last block.
    pub end: MortonKey,
}

impl Stretch {
    /// All blocks.
    pub const ALL: Self = Self { first: MortonKey(0), end: MortonKey(u64::MAX) };

    /// Whether the stretch contains `block`, which is in units of blocks.
    pub fn contains(&self, block: IVec3) -> bool {
        let key = MortonKey::of(block);
        self.first <= key && key < self.end
    }

    /// Whether the stretch contains any block of the box `blocks`, which is in units of blocks.
    pub fn overlaps(&self, blocks: &CellBox) -> bool {
        self.overlaps_within(blocks, MortonKey(0), 3 * MortonKey::AXIS_BITS)
    }

    /// Whether the stretch contains any block of the box `blocks` that is also in a given cube.
    /// `first` is the key of the cube's first block, and `bits` is the number of bits in which the
    /// keys of its blocks differ.
    fn overlaps_within(&self, blocks: &CellBox, first: MortonKey, bits: u32) -> bool {
        let last = MortonKey(first.0 + ((1 << bits) - 1));
        let cube = CellBox { lo: first.coord(), hi: first.coord() + (1 << (bits / 3)) };
        if last < self.first || self.end <= first || cube.intersection(blocks).is_empty() {
            return false;
        }
        // The cube overlaps both the box and the stretch. If the box or the stretch contains the
        // whole cube, the box and the stretch share a block.
        if blocks.covers(&cube) || self.first <= first && last < self.end {
            return true;
        }
        let bits = bits - 3;
        (0..8).any(|child| self.overlaps_within(blocks, MortonKey(first.0 + (child << bits)), bits))
    }

    /// Whether the stretch contains the block in which `bin` lies.
    pub fn contains_bin(&self, bin: IVec3) -> bool {
        self.contains(block_of_bin(bin))
    }
}

/// The cells that affect a block's mesh, relative to the block's lowest corner. These relative
/// cells are the same for all blocks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DecidingCells(CellBox);

impl DecidingCells {
    /// Creates the cells from `of_first_block`, the cells that affect block (0, 0, 0).
    pub fn new(of_first_block: CellBox) -> Self {
        Self(of_first_block)
    }

    /// The cells that affect the mesh of a block.
    pub fn cells(&self, block: IVec3) -> CellBox {
        let corner = block * BLOCK;
        CellBox { lo: self.0.lo + corner, hi: self.0.hi + corner }
    }

    /// The blocks that particles in `bin` may affect.
    pub fn blocks(&self, bin: IVec3) -> impl Iterator<Item = IVec3> + use<> {
        self.blocks_of(CellBox::cube(bin, 1)).cubes(1)
    }

    /// The box of blocks that particles in a box of bins may affect.
    fn blocks_of(&self, bins: CellBox) -> CellBox {
        let (lowest, highest) = (bins.lo * BIN, bins.hi * BIN - 1);
        // A shift divides like `div_euclid`, and is faster for many bins.
        let block_of = |cell: IVec3| cell >> BLOCK.ilog2() as i32;
        // The box runs from the first block whose deciding cells end above the lowest cell, to the
        // last block whose deciding cells begin at or below the highest cell.
        CellBox { lo: block_of(lowest - self.0.hi) + 1, hi: block_of(highest - self.0.lo) + 1 }
    }
}

/// The bins whose particles affect a stretch of blocks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WantedBins {
    /// The blocks to mesh.
    pub stretch: Stretch,
    /// The cells that affect the mesh of a block.
    pub deciding: DecidingCells,
}

impl WantedBins {
    /// Whether these bins include `bin`.
    pub fn contains(&self, bin: IVec3) -> bool {
        let Stretch { first, end } = self.stretch;
        let blocks = self.deciding.blocks_of(CellBox::cube(bin, 1));
        // Keys increase along every axis, so the keys of all blocks in the box lie between the keys
        // of its lowest and its highest block.
        let (least, most) = (MortonKey::of(blocks.lo), MortonKey::of(blocks.hi - 1));
        if most < first || end <= least {
            return false;
        }
        first <= least || most < end || blocks.cubes(1).any(|block| self.stretch.contains(block))
    }

    /// Whether these bins include any bin of the box `bins`.
    pub fn overlaps(&self, bins: CellBox) -> bool {
        !bins.is_empty() && self.stretch.overlaps(&self.deciding.blocks_of(bins))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bin_is_wanted_exactly_if_it_overlaps_the_deciding_cells_of_a_block() {
        for (below, above) in [(0, 0), (1, 1), (16, 17), (17, 16), (22, 54), (40, 3)] {
            let cube = CellBox::cube(IVec3::ZERO, BLOCK);
            let deciding = DecidingCells::new(cube.grown(below, above));
            let [first, end] = [IVec3::new(-1, 0, 1), IVec3::new(1, 1, 0)].map(MortonKey::of);
            let stretch = Stretch { first: first.min(end), end: first.max(end) };
            let wanted = WantedBins { stretch, deciding };
            let all = CellBox { lo: IVec3::splat(-4), hi: IVec3::splat(5) };
            let blocks: Vec<IVec3> =
                all.cubes(1).filter(|&block| stretch.contains(block)).collect();
            assert!(blocks.len() > 3);
            let mut contained = 0;
            for bin in (CellBox { lo: IVec3::splat(-6), hi: IVec3::splat(8) }).cubes(1) {
                let cells = CellBox::cube(bin, BIN);
                let touches =
                    |&block: &IVec3| !deciding.cells(block).intersection(&cells).is_empty();
                assert_eq!(
                    wanted.contains(bin),
                    blocks.iter().any(touches),
                    "{bin} by {below}, {above}"
                );
                contained += i32::from(wanted.contains(bin));
                let by_bin: Vec<IVec3> =
                    deciding.blocks(bin).filter(|block| all.contains(*block)).collect();
                let by_block: Vec<IVec3> = all.cubes(1).filter(touches).collect();
                assert_eq!(by_bin, by_block);
            }
            assert!(contained > 20);
        }
    }

    #[test]
    fn a_box_overlaps_the_wanted_bins_exactly_if_it_contains_one_of_them() {
        let deciding = DecidingCells::new(CellBox::cube(IVec3::ZERO, BLOCK).grown(17, 20));
        let all = CellBox { lo: IVec3::splat(-6), hi: IVec3::splat(6) };
        let boxes = all.cubes(3).flat_map(|corner| {
            let edges = [IVec3::ONE, IVec3::new(2, 1, 5), IVec3::new(4, 6, 3)];
            edges.map(|edge| CellBox { lo: 3 * corner + 1, hi: 3 * corner + 1 + edge })
        });
        let boxes: Vec<CellBox> = boxes.collect();
        let (mut overlapping, mut others) = (0, 0);
        for [first, end] in
            [[-1, 1], [0, 0], [0, 1], [-2, -1], [1, 2]].map(|ends| ends.map(IVec3::splat))
        {
            let [first, end] = [first, end].map(MortonKey::of);
            for end in [end, MortonKey(first.0 + 3), Stretch::ALL.end] {
                let wanted = WantedBins { stretch: Stretch { first, end }, deciding };
                for &bins in &boxes {
                    let any = bins.cubes(1).any(|bin| wanted.contains(bin));
                    assert_eq!(wanted.overlaps(bins), any, "{bins:?} by {wanted:?}");
                    *(if any { &mut overlapping } else { &mut others }) += 1;
                }
                assert!(!wanted.overlaps(CellBox::EMPTY));
            }
        }
        assert!(overlapping > 500 && others > 500, "{overlapping} boxes overlap, {others} do not");
    }

    #[test]
    fn the_bins_of_a_block_lie_within_the_block() {
        let stretch = Stretch { first: MortonKey::of(IVec3::ZERO), end: MortonKey(u64::MAX) };
        assert!(stretch.contains_bin(IVec3::ZERO) && stretch.contains_bin(IVec3::ONE));
        assert!(!stretch.contains_bin(IVec3::NEG_ONE) && Stretch::ALL.contains_bin(IVec3::NEG_ONE));
    }
}

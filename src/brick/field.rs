//! The DIF of a frame in sparse bricks, paged by bins: nothing exists where no particle is.

use glam::IVec3;
use hashbrown::HashMap;
use rayon::prelude::*;

use crate::grid::{BIN, BLOCK, CellBox, MortonKey, local_from_morton, local_morton};
use crate::units::FULL;

use super::Block;

/// Edge of a brick in cells. It decides how tightly the DIF is stored, and nothing else.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum BrickSide {
    /// 64 cells, 128 bytes.
    Four,
    /// 512 cells, 1 KiB.
    #[default]
    Eight,
    /// 4096 cells, 8 KiB: one brick a bin.
    Sixteen,
}

impl BrickSide {
    /// In cells.
    #[must_use]
    pub fn cells(self) -> i32 {
        match self {
            Self::Four => 4,
            Self::Eight => 8,
            Self::Sixteen => 16,
        }
    }
}

/// The bricks of one bin.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Page {
    /// A bit for every brick that is there, by its Morton index in the bin.
    bricks: u64,
    /// The bricks' samples one brick after the other, x fastest in each.
    samples: Box<[u16]>,
    /// The tightest box around the full cells, in cells of the world.
    full: CellBox,
    /// How many cells are full.
    full_count: u32,
}

impl Page {
    /// Keeps the bricks of `dense`, a whole bin with x fastest, that have a full cell.
    #[must_use]
    pub fn from_dense(bin: IVec3, dense: &[u16], side: BrickSide) -> Self {
        let edge = side.cells();
        let per_axis = BIN / edge;
        let mut page = Self { bricks: 0, samples: Box::default(), full: CellBox::EMPTY, full_count: 0 };
        let mut samples = Vec::with_capacity(dense.len());
        for index in 0..(per_axis * per_axis * per_axis) as usize {
            let brick = CellBox::cube(local_from_morton(index), edge);
            let begin = samples.len();
            let mut seen = CellBox::EMPTY;
            for z in brick.lo.z..brick.hi.z {
                for y in brick.lo.y..brick.hi.y {
                    let first = (brick.lo.x + BIN * (y + BIN * z)) as usize;
                    let row = &dense[first..first + edge as usize];
                    samples.extend_from_slice(row);
                    let count = row.iter().filter(|&&theta| theta > 0).count();
                    if count > 0 {
                        page.full_count += count as u32;
                        let left = row.iter().position(|&theta| theta > 0).unwrap_or(0) as i32;
                        let right = row.iter().rposition(|&theta| theta > 0).unwrap_or(0) as i32;
                        seen = seen.union(&CellBox {
                            lo: IVec3::new(brick.lo.x + left, y, z),
                            hi: IVec3::new(brick.lo.x + right, y, z) + 1,
                        });
                    }
                }
            }
            if seen.is_empty() {
                samples.truncate(begin);
            } else {
                page.bricks |= 1 << index;
                let corner = bin * BIN;
                page.full = page.full.union(&CellBox { lo: seen.lo + corner, hi: seen.hi + corner });
            }
        }
        page.samples = samples.into();
        page
    }

    /// The samples of one brick, given its place in the bin counted in bricks.
    fn brick(&self, local: IVec3, side: BrickSide) -> Option<&[u16]> {
        let bit = 1_u64 << local_morton(local);
        (self.bricks & bit != 0).then(|| {
            let size = side.cells().pow(3) as usize;
            let rank = (self.bricks & (bit - 1)).count_ones() as usize;
            &self.samples[rank * size..(rank + 1) * size]
        })
    }
}

/// The discrete indicator function of a frame. Where no brick is, it is exactly 0.
///
/// A cell is full, in the paper's sense, exactly where the DIF is not 0.
#[derive(Debug, Default)]
pub struct DifField {
    side: BrickSide,
    keys: Vec<MortonKey>,
    pages: Vec<Page>,
    rank: HashMap<IVec3, u32>,
}

impl DifField {
    /// Joins pages to the Morton keys of their bins, which must be in order.
    #[must_use]
    pub fn new(side: BrickSide, keys: Vec<MortonKey>, pages: Vec<Page>) -> Self {
        let rank = keys.iter().enumerate().map(|(i, key)| (key.coord(), i as u32)).collect();
        Self { side, keys, pages, rank }
    }

    /// Cells that hold particles.
    #[must_use]
    pub fn full_cells(&self) -> u64 {
        self.pages.iter().map(|page| u64::from(page.full_count)).sum()
    }

    /// Mean of the DIF over the full cells, in 0 to 1.
    #[must_use]
    pub fn mean_of_full(&self) -> f64 {
        let samples = |page: &Page| page.samples.iter().map(|&theta| u64::from(theta)).sum::<u64>();
        let sum: u64 = self.pages.par_iter().map(samples).sum();
        sum as f64 / (self.full_cells() as f64 * f64::from(FULL))
    }

    /// Bricks that hold particles.
    #[must_use]
    pub fn bricks(&self) -> u64 {
        self.pages.iter().map(|page| u64::from(page.bricks.count_ones())).sum()
    }

    /// Bytes of samples.
    #[must_use]
    pub fn sample_bytes(&self) -> u64 {
        self.pages.iter().map(|page| size_of_val(&*page.samples) as u64).sum()
    }

    /// Replaces every sample.
    pub fn map(&mut self, value: impl Fn(u16) -> u16 + Sync) {
        self.pages
            .par_iter_mut()
            .flat_map_iter(|page| page.samples.iter_mut())
            .for_each(|sample| *sample = value(*sample));
    }

    /// Cuts the samples of `cells` out of the bricks.
    #[must_use]
    pub fn gather(&self, cells: CellBox) -> Block {
        let mut block = Block::zero(cells);
        let edge = self.side.cells();
        let per_bin = BIN / edge;
        for bin in cells.cubes(BIN) {
            let Some(&rank) = self.rank.get(&bin) else { continue };
            let page = &self.pages[rank as usize];
            let inside = cells.intersection(&CellBox::cube(bin, BIN));
            for brick in inside.cubes(edge) {
                let Some(samples) = page.brick(brick - bin * per_bin, self.side) else { continue };
                let corner = brick * edge;
                let part = inside.intersection(&CellBox::cube(brick, edge));
                let width = part.size().x as usize;
                for z in part.lo.z..part.hi.z {
                    for y in part.lo.y..part.hi.y {
                        let at = IVec3::new(part.lo.x, y, z);
                        let local = at - corner;
                        let from = (local.x + edge * (local.y + edge * local.z)) as usize;
                        let to = block.index(at);
                        block.samples_mut()[to..to + width].copy_from_slice(&samples[from..from + width]);
                    }
                }
            }
        }
        block
    }

    /// The parts of blocks that lie within `below` cells under, or `above` cells over, a full cell along
    /// every axis: block coordinates in Morton order, and the box of cells within each block.
    #[must_use]
    pub fn regions(&self, below: i32, above: i32) -> Vec<(IVec3, CellBox)> {
        let mut regions: HashMap<IVec3, CellBox> = HashMap::new();
        for page in &self.pages {
            let reached = page.full.grown(below, above);
            for block in reached.cubes(BLOCK) {
                let part = reached.intersection(&CellBox::cube(block, BLOCK));
                let region = regions.entry(block).or_insert(CellBox::EMPTY);
                *region = region.union(&part);
            }
        }
        let mut regions: Vec<_> = regions.into_iter().collect();
        regions.sort_unstable_by_key(|&(block, _)| MortonKey::of(block));
        regions
    }

    /// The bins that have bricks, in Morton order.
    #[must_use]
    pub fn keys(&self) -> &[MortonKey] {
        &self.keys
    }
}

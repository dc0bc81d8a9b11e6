//! A page: the bricks of one bin.

use glam::IVec3;

use crate::grid::{BIN, CellBox, MortonKey, local_from_morton, local_morton};

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

    /// How many fill a bin: the bits of [`PageInfo::bricks`] that can be set.
    #[must_use]
    pub fn bricks_a_bin(self) -> usize {
        (BIN / self.cells()).pow(3) as usize
    }

    /// Samples of a brick.
    #[must_use]
    pub fn samples(self) -> usize {
        self.cells().pow(3) as usize
    }
}

/// What is always in memory of a page. Its samples may be elsewhere.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PageInfo {
    /// Its bin.
    pub key: MortonKey,
    /// A bit for every brick that has a full cell, by its Morton index in the bin. Others are not stored.
    pub bricks: u64,
    /// The tightest box around the full cells, in cells of the world.
    pub full: CellBox,
    /// How many cells are full.
    pub full_count: u32,
}

/// How the samples of a page lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PageShape {
    /// Of its bricks.
    pub side: BrickSide,
    /// Samples of a cell. A cell is full where the first is not 0.
    pub channels: usize,
}

impl From<BrickSide> for PageShape {
    /// One sample a cell.
    fn from(side: BrickSide) -> Self {
        Self { side, channels: 1 }
    }
}

impl PageShape {
    /// Samples of a brick.
    #[must_use]
    pub fn brick_samples(self) -> usize {
        self.side.samples() * self.channels
    }

    /// Samples of a whole bin.
    #[must_use]
    pub fn bin_samples(self) -> usize {
        BIN.pow(3) as usize * self.channels
    }
}

impl PageInfo {
    /// Keeps the bricks of `dense` that have a full cell: a whole bin, channel by channel, x fastest in each. Their samples
    /// lie one brick after the other in Morton order, each channel by channel, x fastest. `None` where no cell is full.
    #[must_use]
    pub fn from_dense(bin: IVec3, dense: &[u16], shape: PageShape) -> Option<(Self, Box<[u16]>)> {
        let edge = shape.side.cells();
        let mut page = Self::empty(MortonKey::of(bin));
        let mut samples = Vec::with_capacity(dense.len());
        for index in 0..shape.side.bricks_a_bin() {
            let corner = local_from_morton(index) * edge;
            let begin = samples.len();
            for dense in dense.chunks_exact(BIN.pow(3) as usize) {
                for first in rows(corner, edge) {
                    let (fours, _) = dense[first..first + edge as usize].as_chunks::<4>();
                    fours.iter().for_each(|four| samples.extend_from_slice(four));
                }
                // One channel says whether there is anything.
                if samples.len() - begin == shape.side.samples()
                    && !page.add(bin, index, &samples[begin..], shape.side)
                {
                    samples.truncate(begin);
                    break;
                }
            }
        }
        (page.bricks != 0).then(|| (page, samples.into()))
    }

    /// What there is to know of stored samples; `None` unless there is a full cell in every one of `bricks`.
    ///
    /// # Panics
    /// If the samples are not of the bricks' number.
    #[must_use]
    pub fn from_samples(key: MortonKey, bricks: u64, samples: &[u16], shape: PageShape) -> Option<Self> {
        let PageShape { side, .. } = shape;
        let mut page = Self::empty(key);
        let set = (0..side.bricks_a_bin()).filter(|index| bricks >> index & 1 != 0);
        assert_eq!(set.clone().count() * shape.brick_samples(), samples.len());
        set.zip(samples.chunks_exact(shape.brick_samples()))
            .all(|(index, brick)| page.add(key.coord(), index, &brick[..side.samples()], side))
            .then_some(page)
            .filter(|page| page.bricks == bricks)
    }

    fn empty(key: MortonKey) -> Self {
        Self { key, bricks: 0, full: CellBox::EMPTY, full_count: 0 }
    }

    /// Counts brick number `index` in by its first channel, unless it has no full cell.
    fn add(&mut self, bin: IVec3, index: usize, samples: &[u16], side: BrickSide) -> bool {
        let edge = side.cells();
        let (mut full, mut full_count) = (CellBox::EMPTY, 0);
        let rows = (0..edge).flat_map(|z| (0..edge).map(move |y| (y, z)));
        for ((y, z), row) in rows.zip(samples.chunks_exact(edge as usize)) {
            let (fours, _) = row.as_chunks::<4>();
            let bits = fours.iter().rev().fold(0, |bits, four| bits << 4 | full_bits(*four));
            if bits != 0 {
                full_count += bits.count_ones();
                let (left, right) = (bits.trailing_zeros() as i32, bits.ilog2() as i32);
                full = full.union(&CellBox { lo: IVec3::new(left, y, z), hi: IVec3::new(right, y, z) + 1 });
            }
        }
        if full_count == 0 {
            return false;
        }
        let corner = bin * BIN + local_from_morton(index) * edge;
        self.full = self.full.union(&CellBox { lo: full.lo + corner, hi: full.hi + corner });
        self.full_count += full_count;
        self.bricks |= 1 << index;
        true
    }

    /// The inverse of [`from_dense`](Self::from_dense).
    pub(super) fn write_dense(&self, samples: &[u16], dense: &mut [u16], shape: PageShape) {
        dense.fill(0);
        let edge = shape.side.cells();
        for index in (0..shape.side.bricks_a_bin()).filter(|index| self.bricks >> index & 1 != 0) {
            let local = local_from_morton(index);
            let Some(samples) = self.brick(samples, local, shape) else { continue };
            let channels = dense.chunks_exact_mut(BIN.pow(3) as usize);
            for (dense, samples) in channels.zip(samples.chunks_exact(shape.side.samples())) {
                for (first, from) in rows(local * edge, edge).zip(samples.chunks_exact(edge as usize)) {
                    dense[first..first + edge as usize].copy_from_slice(from);
                }
            }
        }
    }

    /// How many samples are stored.
    #[must_use]
    pub fn samples(&self, shape: PageShape) -> usize {
        self.bricks.count_ones() as usize * shape.brick_samples()
    }

    /// The part of the page's `samples` that is one brick, given its place in the bin counted in bricks.
    pub(super) fn brick<'a>(&self, samples: &'a [u16], local: IVec3, shape: PageShape) -> Option<&'a [u16]> {
        let bit = 1_u64 << local_morton(local);
        (self.bricks & bit != 0).then(|| {
            let size = shape.brick_samples();
            let rank = (self.bricks & (bit - 1)).count_ones() as usize;
            &samples[rank * size..(rank + 1) * size]
        })
    }
}

/// Where the rows of a brick begin among the cells of its bin, given its lowest cell there.
fn rows(corner: IVec3, edge: i32) -> impl Iterator<Item = usize> {
    let first = move |y, z| (corner.x + BIN * (corner.y + y + BIN * (corner.z + z))) as usize;
    (0..edge).flat_map(move |z| (0..edge).map(move |y| first(y, z)))
}

/// A bit for each sample that is not 0.
fn full_bits(four: [u16; 4]) -> u32 {
    // Most are empty.
    if four == [0; 4] { 0 } else { (0..4).map(|i| u32::from(four[i] > 0) << i).sum() }
}

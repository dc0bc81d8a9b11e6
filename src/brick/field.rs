//! The DIF of a frame, stored in sparse bricks with one page per bin. Space without particles is
//! not stored.

use std::borrow::Cow;
use std::fmt::Debug;
use std::ops::Range;

use glam::IVec3;
use hashbrown::HashMap;
use rayon::prelude::*;

use crate::grid::units::FULL;
use crate::grid::{BIN, CellBox, Mirror, MortonKey, block_parts};

use super::store::PageStore;
use super::{Block, BrickSide, PageInfo, PageSamples, PageShape, PageSource, Pages};

/// The discrete indicator function of a frame. Outside the stored bricks, it is exactly 0.
///
/// A cell is full if its stored sample is nonzero: the cell contains particles, as in the paper, or
/// is near a particle.
#[derive(Debug)]
pub struct DifField {
    shape: PageShape,
    infos: Vec<PageInfo>,
    rank: HashMap<IVec3, u32>,
    store: PageStore,
    stored: SampleMeaning,
}

/// The meaning of a field's stored samples.
#[derive(Debug)]
enum SampleMeaning {
    /// The DIF itself.
    Theta,
    /// Numbers of particles, which a table converts to the DIF on access.
    Counts(DecodeTable),
}

impl DifField {
    /// Makes a field from pages in memory. The pages must be sorted by key.
    pub fn in_memory(shape: PageShape, pages: Pages) -> Self {
        let (infos, samples) = pages.into_iter().unzip();
        Self::new(shape, infos, PageStore::Memory(samples))
    }

    /// Makes a field from pages whose samples are read from `source`. `infos` must be sorted by
    /// key. Recently used pages stay in memory, up to `cache_bytes`.
    pub fn paged(
        shape: PageShape,
        infos: Vec<PageInfo>,
        source: Box<dyn PageSource>,
        cache_bytes: u64,
    ) -> Self {
        let bytes: usize = infos.iter().map(|info| info.most_bytes(shape)).sum();
        let mean_bytes = (bytes / infos.len().max(1)) as u64;
        Self::new(shape, infos, PageStore::paged(source, cache_bytes, mean_bytes))
    }

    /// Makes a field from pages whose samples are outside the host's memory and are fetched on
    /// demand. `infos` must be sorted by key. If fetching fails, `fallback` computes the samples.
    pub fn from_remote(
        shape: PageShape,
        infos: Vec<PageInfo>,
        pages: Box<dyn RemotePages>,
        fallback: Box<dyn PageSource>,
    ) -> Self {
        debug_assert_eq!(infos.len(), pages.count(), "one info per page");
        Self::new(shape, infos, PageStore::remote(pages, fallback))
    }

    fn new(shape: PageShape, infos: Vec<PageInfo>, store: PageStore) -> Self {
        debug_assert!(infos.is_sorted_by(|a, b| a.key < b.key), "pages are in order");
        let rank = (0..).zip(&infos).map(|(rank, info)| (info.key.coord(), rank)).collect();
        Self { shape, infos, rank, store, stored: SampleMeaning::Theta }
    }

    /// Declares that the stored samples are numbers of particles. `theta[n]` is the DIF for n
    /// particles: 0 for n = 0, and positive otherwise. For n beyond the end of `theta`, the DIF is
    /// 1.
    pub fn with_decode(self, theta: &[u16]) -> Self {
        Self { stored: SampleMeaning::Counts(DecodeTable::new(theta)), ..self }
    }

    /// Maximum number of bytes of samples in memory; `None` if there is no limit.
    pub(super) fn cache_bytes(&self) -> Option<u64> {
        self.store.cache_bytes()
    }

    /// The samples that are outside the host's memory, for example on a device; `None` if there are
    /// none.
    pub fn remote(&self) -> Option<&dyn RemotePages> {
        match &self.store {
            PageStore::Remote { pages, .. } => Some(&**pages),
            PageStore::Memory(_) | PageStore::Paged { .. } => None,
        }
    }

    /// The maximum distance, in cells, of a positive sample from the full cells of its page.
    pub fn ghost_layer(&self) -> i32 {
        self.shape.ghost_layer
    }

    /// The arrangement of the samples in the field's pages.
    pub fn shape(&self) -> PageShape {
        self.shape
    }

    /// Edge of a brick.
    pub fn side(&self) -> BrickSide {
        self.shape.side
    }

    /// The number of cells that are full because of particles in their own bin.
    pub fn full_cells(&self) -> u64 {
        self.infos.iter().map(|info| u64::from(info.full_count)).sum()
    }

    /// The mean of the DIF over the full cells, from 0 to 1. The bricks must not have ghost layers.
    /// Reads all pages.
    pub fn mean_of_full(&self) -> f64 {
        let theta = |&sample: &u16| u64::from(self.stored.theta(sample));
        let pages = (0..self.infos.len()).into_par_iter();
        let sum: u64 = pages.map(|page| self.stored(page).iter().map(theta).sum::<u64>()).sum();
        sum as f64 / (self.full_cells() as f64 * f64::from(FULL))
    }

    /// The number of bricks that contain particles.
    pub fn bricks(&self) -> u64 {
        self.infos.iter().map(|info| u64::from(info.bricks.count_ones())).sum()
    }

    /// Bytes of the samples of all bricks, wherever they are stored.
    pub fn sample_bytes(&self) -> u64 {
        let bytes = |info: &PageInfo| (info.samples(self.shape) * size_of::<u16>()) as u64;
        self.infos.iter().map(bytes).sum()
    }

    /// Cuts the samples of `cells` out of the bricks.
    pub fn gather(&self, cells: CellBox) -> Block {
        match &self.stored {
            SampleMeaning::Theta if self.shape.ghost_layer > 0 => {
                self.gather_by(cells, u16::saturating_add, |_| {})
            }
            SampleMeaning::Theta => self.gather_by(cells, |_, theta| theta, |_| {}),
            SampleMeaning::Counts(table) => {
                self.gather_by(cells, |_, count| table.theta(count), |_| {})
            }
        }
    }

    /// Cuts the samples of `cells` out of the bricks. Also returns the cells with nonzero samples,
    /// x fastest, if there are at most `most` of them.
    pub fn gather_few(&self, cells: CellBox, most: usize) -> (Block, Option<Vec<IVec3>>) {
        let (mut full, mut dense) = (Vec::new(), false);
        let block = match &self.stored {
            // Bricks without ghost layers do not overlap, so each of their samples is added to 0.
            SampleMeaning::Theta => self.gather_by(cells, u16::saturating_add, |cell| match cell {
                Some(cell) => full.push(cell),
                None => dense = true,
            }),
            SampleMeaning::Counts(_) => {
                dense = true;
                self.gather(cells)
            }
        };
        if dense {
            let full = block.full_cells(most);
            return (block, full);
        }
        full.sort_unstable_by_key(|cell| (cell.z, cell.y, cell.x));
        (block, (full.len() <= most).then_some(full))
    }

    /// Cuts the samples of `cells` out of the bricks, mirrored by `mirror`.
    pub fn gather_mirrored(&self, cells: CellBox, mirror: Option<Mirror>) -> Block {
        let mut block = self.gather(cells);
        block.mirror(mirror);
        block
    }

    /// Cuts the samples of `cells` out of the bricks. `value(existing, stored)` combines the
    /// block's existing sample with the stored sample of a brick. Calls `fill` with each cell that
    /// a sparse page fills, and with `None` for each dense page.
    fn gather_by(
        &self,
        cells: CellBox,
        value: impl Fn(u16, u16) -> u16 + Copy,
        mut fill: impl FnMut(Option<IVec3>),
    ) -> Block {
        let PageShape { side, ghost_layer } = self.shape;
        let edge = side.cells();
        let mut block = Block::zero(cells);
        for bin in cells.grown(ghost_layer, ghost_layer).cubes(BIN) {
            let Some(&rank) = self.rank.get(&bin) else { continue };
            let info = &self.infos[rank as usize];
            let inside = cells.intersection(&info.full.grown(ghost_layer, ghost_layer));
            if inside.is_empty() {
                continue;
            }
            let samples = self.store.cached(rank, self.shape);
            let samples = match &*samples {
                PageSamples::Dense(samples) => samples,
                PageSamples::Sparse(samples) => {
                    let corner = bin * BIN - ghost_layer;
                    block.put_cells(inside, corner, samples, value, |cell| fill(Some(cell)));
                    continue;
                }
            };
            fill(None);
            let own = CellBox::cube(bin, BIN).intersection(&inside.grown(ghost_layer, ghost_layer));
            for brick in own.cubes(edge) {
                let local = brick - bin * (BIN / edge);
                if let Some(samples) = info.brick(samples, local, self.shape) {
                    let from = self.shape.cells_of(brick);
                    block.put_part(inside.intersection(&from), from, samples, value);
                }
            }
        }
        block
    }

    /// Writes the stored samples of a whole bin, in the dense form that [`PageInfo::from_dense`]
    /// takes.
    ///
    /// # Panics
    /// If the bin has no page, or if `dense` is too short for the samples of the bin.
    pub fn write_stored(&self, bin: IVec3, dense: &mut [u16]) {
        let rank = self.rank[&bin];
        let samples = self.store.cached(rank, self.shape);
        self.infos[rank as usize].write_dense(&samples.dense(self.shape), dense, self.shape);
    }

    /// Whether a bin has a page.
    pub fn has_page(&self, bin: IVec3) -> bool {
        self.rank.contains_key(&bin)
    }

    /// The sample of a cell for each number of particles. The last entry, which represents 1, also
    /// applies to all larger numbers. `None` if the stored samples are the DIF.
    pub fn decode_table(&self) -> Option<&[u16]> {
        match &self.stored {
            SampleMeaning::Counts(table) => Some(&table.0),
            _ => None,
        }
    }

    /// The total volume, in cells, of the boxes around the full cells of each bin that overlaps
    /// `cells`.
    pub fn full_volume(&self, cells: CellBox) -> usize {
        let bins = cells.cubes(BIN).filter_map(|bin| self.rank.get(&bin));
        bins.map(|&rank| self.infos[rank as usize].full.volume()).sum()
    }

    /// For each bin, the part of `cells` that lies, along every axis, within `reach` cells of the
    /// box around the bin's full cells. Parts may overlap, and empty parts are left out.
    pub fn parts_near(&self, cells: CellBox, reach: i32) -> impl Iterator<Item = CellBox> + '_ {
        let bins = cells.grown(reach, reach).cubes(BIN).filter_map(|bin| self.rank.get(&bin));
        let near = bins.map(move |&rank| {
            self.infos[rank as usize].full.grown(reach, reach).intersection(&cells)
        });
        near.filter(|part| !part.is_empty())
    }

    /// Boxes that contain all full cells that are, along every axis, within `reach` cells of
    /// `cells`. The boxes may also contain full cells that are farther away. A bin with few full
    /// cells gives one box for each group of adjacent full cells; every other bin gives one box.
    pub fn groups_near(&self, cells: CellBox, reach: i32) -> Vec<CellBox> {
        let (mut all, mut groups) = (Vec::new(), Vec::new());
        for bin in cells.grown(reach, reach).cubes(BIN) {
            let Some(&rank) = self.rank.get(&bin) else { continue };
            let full = self.infos[rank as usize].full;
            match &*self.store.cached(rank, self.shape) {
                PageSamples::Dense(_) => groups.push(full),
                PageSamples::Sparse(samples) => {
                    let corner = bin * BIN - self.shape.ghost_layer;
                    let cells = samples.iter().map(|(place, _)| corner + place.local());
                    for cell in cells.filter(|&cell| full.contains(cell)) {
                        join(&mut groups, CellBox::cube(cell, 1), 1);
                    }
                }
            }
            all.append(&mut groups);
        }
        all
    }

    /// Boxes that contain all nonzero samples of `cells`. The boxes do not overlap.
    pub fn parts_with_samples(&self, cells: CellBox) -> Vec<CellBox> {
        let mut parts: Vec<CellBox> = Vec::new();
        for part in self.parts_near(cells, self.shape.ghost_layer) {
            join(&mut parts, part, 0);
        }
        parts
    }

    /// The parts of blocks that are near full cells, as boxes of cells in the Morton order of the
    /// blocks. Along every axis, a part extends `below` cells below and `above` cells above the
    /// full cells.
    pub fn regions(&self, below: i32, above: i32) -> Vec<CellBox> {
        block_parts(self.infos.iter().map(|info| info.full.grown(below, above)))
    }

    /// The bins that have bricks, in Morton order.
    pub fn keys(&self) -> impl ExactSizeIterator<Item = MortonKey> + '_ {
        self.infos.iter().map(|info| info.key)
    }

    /// All pages, sorted by key.
    pub fn infos(&self) -> &[PageInfo] {
        &self.infos
    }

    /// All stored samples of page number `page`, not converted to the DIF.
    pub fn stored(&self, page: usize) -> Cow<'_, [u16]> {
        self.store.once(page, self.shape)
    }
}

/// Adds the box `new` to `boxes`, merged with all boxes that are at most `gap` cells away.
fn join(boxes: &mut Vec<CellBox>, mut new: CellBox, gap: i32) {
    let is_near =
        |other: &CellBox, new: &CellBox| !other.grown(gap, gap).intersection(new).is_empty();
    while let Some(at) = boxes.iter().position(|other| is_near(other, &new)) {
        new = new.union(&boxes.swap_remove(at));
    }
    boxes.push(new);
}

impl SampleMeaning {
    #[inline]
    fn theta(&self, sample: u16) -> u16 {
        match self {
            Self::Theta => sample,
            Self::Counts(table) => table.theta(sample),
        }
    }
}

/// The sample of a cell for each number of particles. The last entry, which represents 1, also
/// applies to all larger numbers.
#[derive(Debug)]
struct DecodeTable(Box<[u16]>);

impl DecodeTable {
    fn new(theta: &[u16]) -> Self {
        debug_assert_eq!(theta.first(), Some(&0), "an empty cell stays empty");
        debug_assert!(theta.iter().skip(1).all(|&theta| theta > 0), "a full cell stays full");
        Self(theta.iter().copied().chain([FULL]).collect())
    }

    #[inline]
    fn theta(&self, count: u16) -> u16 {
        self.0[usize::from(count).min(self.0.len() - 1)]
    }
}

/// Number of fractional bits of a [`Factor`].
pub(super) const FACTOR_BITS: u32 = 16;

/// The fraction of its content that a wide cell stores, at most 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Factor(u32);

impl Factor {
    /// Rounds a factor of at most 1 down to a multiple of 2^-16.
    pub fn new(factor: f64) -> Self {
        Self((factor * f64::from(1 << FACTOR_BITS)) as u32)
    }

    /// The factor in steps of 2^-16.
    pub fn steps(self) -> u32 {
        self.0
    }
}

/// Samples outside the host's memory, with operations that run where the samples are. An operation
/// returns `None` on failure; the host then computes the result.
pub trait RemotePages: Send + Sync + Debug {
    /// The number of pages.
    fn count(&self) -> usize;

    /// The samples of consecutive pages.
    fn samples(&self, pages: Range<usize>) -> Option<Vec<PageSamples>>;

    /// Computes the pages of `bins` on cells twice as wide. The results are the same as those of
    /// [`DifField::halved`](super::DifField::halved). Empty pages are left out. `mirror` is in
    /// cells of this field.
    fn halved(
        &self,
        bins: &[IVec3],
        mirror: Option<Mirror>,
        factor: Factor,
    ) -> Option<(Vec<PageInfo>, Box<dyn RemotePages>)>;

    /// For each page, one bit per brick of 4^3 cells, at the brick's Morton index. The cells are
    /// divided into parts of 2^3 cells. A cube with `width` parts along each axis begins at each
    /// part. The bit of a brick is set if the sum of the samples is at least `least` in every cube
    /// that overlaps the brick.
    fn full_bricks(&self, width: u32, least: u32) -> Option<Vec<u64>>;
}

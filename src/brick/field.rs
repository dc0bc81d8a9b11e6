//! The DIF of a frame in sparse bricks, paged by bins: nothing exists where no particle is.

use std::borrow::Cow;
use std::fmt::Debug;
use std::ops::Range;

use glam::IVec3;
use hashbrown::HashMap;
use rayon::prelude::*;

use crate::grid::units::FULL;
use crate::grid::{BIN, CellBox, MortonKey, block_parts};

use super::store::PageStore;
use super::{Block, BrickSide, PageInfo, PageSamples, PageShape, PageSource, Pages};

/// The discrete indicator function of a frame. Where no brick is, it is exactly 0.
///
/// A cell is full exactly where what is stored is not 0: where it holds particles, in the paper's
/// sense, or is near some.
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
    /// Numbers of particles, which a table turns into the DIF on the way out.
    Counts(DecodeTable),
}

impl DifField {
    /// Makes a field of pages in memory, in the order of their keys.
    pub fn in_memory(shape: PageShape, pages: Pages) -> Self {
        let (infos, samples) = pages.into_iter().unzip();
        Self::new(shape, infos, PageStore::Memory(samples))
    }

    /// Makes a field of pages, in the order of their keys, whose samples are read from `source`.
    /// Those last used stay in memory as long as they take no more than `cache_bytes`.
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

    /// Makes a field of pages, in the order of their keys, whose samples are elsewhere and come
    /// when they are wanted. Where that fails they are made by `otherwise`.
    pub fn elsewhere_paged(
        shape: PageShape,
        infos: Vec<PageInfo>,
        pages: Box<dyn RemotePages>,
        otherwise: Box<dyn PageSource>,
    ) -> Self {
        debug_assert_eq!(infos.len(), pages.count(), "pages are those of the infos");
        Self::new(shape, infos, PageStore::elsewhere(pages, otherwise))
    }

    fn new(shape: PageShape, infos: Vec<PageInfo>, store: PageStore) -> Self {
        debug_assert!(infos.is_sorted_by(|a, b| a.key < b.key), "pages are in order");
        let rank = (0..).zip(&infos).map(|(rank, info)| (info.key.coord(), rank)).collect();
        Self { shape, infos, rank, store, stored: SampleMeaning::Theta }
    }

    /// Takes what is stored for numbers of particles, and `theta` for the DIF by number: 0 for
    /// none, more than 0 for any, and 1 beyond its end.
    pub fn with_decode(self, theta: &[u16]) -> Self {
        Self { stored: SampleMeaning::Counts(DecodeTable::new(theta)), ..self }
    }

    /// Bytes of samples that may be in memory; `None` where all are.
    pub(super) fn cache_bytes(&self) -> Option<u64> {
        self.store.cache_bytes()
    }

    /// Returns the samples that are in another memory than the host's, such as a device's, if the
    /// field has such.
    pub fn elsewhere(&self) -> Option<&dyn RemotePages> {
        match &self.store {
            PageStore::Elsewhere { pages, .. } => Some(&**pages),
            PageStore::Memory(_) | PageStore::Paged { .. } => None,
        }
    }

    /// How far from a page's full cells the DIF can be more than 0, in cells.
    pub fn ghost_layer(&self) -> i32 {
        self.shape.ghost_layer
    }

    /// How its pages' samples lie.
    pub fn shape(&self) -> PageShape {
        self.shape
    }

    /// Edge of a brick.
    pub fn side(&self) -> BrickSide {
        self.shape.side
    }

    /// Cells that are full by what their own bin's particles leave in them.
    pub fn full_cells(&self) -> u64 {
        self.infos.iter().map(|info| u64::from(info.full_count)).sum()
    }

    /// Mean of the DIF over the full cells, in 0 to 1, where bricks have no ghost layers. Reads all
    /// pages.
    pub fn mean_of_full(&self) -> f64 {
        let theta = |&sample: &u16| u64::from(self.stored.theta(sample));
        let pages = (0..self.infos.len()).into_par_iter();
        let sum: u64 = pages.map(|page| self.stored(page).iter().map(theta).sum::<u64>()).sum();
        sum as f64 / (self.full_cells() as f64 * f64::from(FULL))
    }

    /// Bricks that hold particles.
    pub fn bricks(&self) -> u64 {
        self.infos.iter().map(|info| u64::from(info.bricks.count_ones())).sum()
    }

    /// Bytes of all samples of its bricks, however they are kept.
    pub fn sample_bytes(&self) -> u64 {
        let bytes = |info: &PageInfo| (info.samples(self.shape) * size_of::<u16>()) as u64;
        self.infos.iter().map(bytes).sum()
    }

    /// Cuts the DIF of `cells` out of the bricks.
    pub fn gather(&self, cells: CellBox) -> Block {
        match &self.stored {
            SampleMeaning::Theta if self.shape.ghost_layer > 0 => {
                self.gather_by(cells, u16::saturating_add)
            }
            SampleMeaning::Theta => self.gather_by(cells, |_, theta| theta),
            SampleMeaning::Counts(table) => self.gather_by(cells, |_, count| table.theta(count)),
        }
    }

    /// Cuts `cells` out of the DIF; beyond `walls` their edge cells are repeated.
    pub fn gather_within(&self, cells: CellBox, walls: Option<CellBox>) -> Block {
        let mut block = self.gather(cells);
        if let Some(walls) = walls {
            block.repeat_edges(walls);
        }
        block
    }

    /// Cuts out the samples by what `value` makes of what is there already and of what another
    /// brick has stored.
    fn gather_by(&self, cells: CellBox, value: impl Fn(u16, u16) -> u16 + Copy) -> Block {
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
                    block.put_cells(inside, bin * BIN - ghost_layer, samples, value);
                    continue;
                }
            };
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

    /// Writes the samples of a whole bin as they are stored, dense as [`PageInfo::from_dense`]
    /// takes them.
    ///
    /// # Panics
    /// If no page is there, or `dense` is not as long as a bin.
    pub fn write_stored(&self, bin: IVec3, dense: &mut [u16]) {
        let rank = self.rank[&bin];
        let samples = self.store.cached(rank, self.shape);
        self.infos[rank as usize].write_dense(&samples.dense(self.shape), dense, self.shape);
    }

    /// Whether a bin has a page.
    pub fn has_page(&self, bin: IVec3) -> bool {
        self.rank.contains_key(&bin)
    }

    /// theta by the number of particles, and 1 for all numbers beyond, where what is stored is
    /// counts.
    pub fn decode_table(&self) -> Option<&[u16]> {
        match &self.stored {
            SampleMeaning::Counts(table) => Some(&table.0),
            _ => None,
        }
    }

    /// Cells of the boxes around the full ones of all bins that some cells lie in.
    pub fn full_volume(&self, cells: CellBox) -> usize {
        let bins = cells.cubes(BIN).filter_map(|bin| self.rank.get(&bin));
        bins.map(|&rank| self.infos[rank as usize].full.volume()).sum()
    }

    /// The parts of some cells that lie within `reach` cells of a bin's full ones along every axis,
    /// which may overlap.
    pub fn parts_near(&self, cells: CellBox, reach: i32) -> impl Iterator<Item = CellBox> + '_ {
        let bins = cells.grown(reach, reach).cubes(BIN).filter_map(|bin| self.rank.get(&bin));
        let near = bins.map(move |&rank| {
            self.infos[rank as usize].full.grown(reach, reach).intersection(&cells)
        });
        near.filter(|part| !part.is_empty())
    }

    /// The parts of some cells that lie within `reach` cells of full ones along every axis, which may
    /// overlap: around each group of full cells side by side where a bin has few, else around all
    /// of a bin.
    pub fn parts_near_groups(&self, cells: CellBox, reach: i32) -> Vec<CellBox> {
        let (mut parts, mut groups) = (Vec::new(), Vec::new());
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
            let near = |group: CellBox| group.grown(reach, reach).intersection(&cells);
            parts.extend(groups.drain(..).map(near).filter(|part| !part.is_empty()));
        }
        parts
    }

    /// Boxes that hold all samples of some cells that are not 0, and do not overlap.
    pub fn parts_with_samples(&self, cells: CellBox) -> Vec<CellBox> {
        let mut parts: Vec<CellBox> = Vec::new();
        for part in self.parts_near(cells, self.shape.ghost_layer) {
            join(&mut parts, part, 0);
        }
        parts
    }

    /// The parts of blocks that lie within `below` cells under, or `above` cells over, a full cell
    /// along every axis, as boxes of cells, in the Morton order of their blocks.
    pub fn regions(&self, below: i32, above: i32) -> Vec<CellBox> {
        block_parts(self.infos.iter().map(|info| info.full.grown(below, above)))
    }

    /// The bins that have bricks, in Morton order.
    pub fn keys(&self) -> impl ExactSizeIterator<Item = MortonKey> + '_ {
        self.infos.iter().map(|info| info.key)
    }

    /// All pages, in the order of their keys.
    pub fn infos(&self) -> &[PageInfo] {
        &self.infos
    }

    /// All samples of page number `page`'s bricks, not decoded.
    pub fn stored(&self, page: usize) -> Cow<'_, [u16]> {
        self.store.once(page, self.shape)
    }
}

/// Adds a box to others, joined with those less than `gap` + 1 cells away from it.
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

/// theta by the number of particles; the last one, 1, for all numbers from there on.
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

/// Bits of a [`Factor`].
pub(super) const FACTOR_BITS: u32 = 16;

/// The share of their content that wide cells hold: at most all.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Factor(u32);

impl Factor {
    /// Rounds a factor of at most 1 down to its step.
    pub fn new(factor: f64) -> Self {
        Self((factor * f64::from(1 << FACTOR_BITS)) as u32)
    }

    /// The factor in steps of 2^-16.
    pub fn steps(self) -> u32 {
        self.0
    }
}

/// Samples that are not in the host's memory, and what can be made of them where they are. Whatever
/// fails is `None`, and made on the host.
pub trait RemotePages: Send + Sync + Debug {
    /// How many pages there are.
    fn count(&self) -> usize;

    /// The samples of consecutive pages.
    fn samples(&self, pages: Range<usize>) -> Option<Vec<PageSamples>>;

    /// The pages of bins in cells twice as wide, but for those that hold nothing: what
    /// [`DifField::halved`](super::DifField::halved) makes, within the `walls` of these cells.
    fn halved(
        &self,
        bins: &[IVec3],
        walls: Option<CellBox>,
        factor: Factor,
    ) -> Option<(Vec<PageInfo>, Box<dyn RemotePages>)>;

    /// For each page a bit for each brick of four cells, by its Morton index: those that no cube of
    /// `width` parts along each axis touches that holds less than `least`; a part is two cells
    /// wide, and cubes slide by one.
    fn full_bricks(&self, width: u32, least: u32) -> Option<Vec<u64>>;
}

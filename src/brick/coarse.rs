//! A field on cells twice as wide, computed from the finer field bin by bin, on demand.
//!
//! Along each axis, a wide cell takes 1/4, 3/4, 3/4 and 1/4 of the content of the four cells around
//! its centre. These weights preserve the mass, the centroid and, up to a constant, the variance of
//! the content, wherever the content lies. The finer field is mirrored at walls, as it is for all
//! filters.

use std::path::Path;
use std::sync::Arc;

use glam::IVec3;
use multiversion::multiversion;
use rayon::prelude::*;

use crate::grid::units::FULL;
use crate::grid::{BIN, CellBox, Mirror, MortonKey};
use crate::system::scratch::Scratch;

use super::field::FACTOR_BITS;
use super::{Block, BrickSide, DifField, Factor, PageInfo, PageSamples, PageShape, PageSource};

/// The binary logarithm of the sum of the weights of all cells from which a wide cell is computed.
const WEIGHT_BITS: u32 = 9;
/// Number of bits by which the product of a weighted sum and a [`Factor`] is shifted right. A wide
/// cell holds the content of 2^3 cells, so the shift is three bits less than for a mean.
pub const HALVED_BITS: u32 = WEIGHT_BITS + FACTOR_BITS - 3;

/// The arrangement of the pages of a field that was computed from cells half as wide.
pub const HALVED: PageShape = PageShape { side: BrickSide::Sixteen, ghost_layer: 0 };

/// Halves the number of planes along an axis. Each plane has `step` sums. Each plane of `to` is
/// computed from two planes of `run`, and from one more plane on each side of these two.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn halved_along(to: &mut [u32], run: &[u32], step: usize) {
    if step == 1 {
        for (to, taps) in to.iter_mut().zip(run.windows(4).step_by(2)) {
            *to = taps[0] + 3 * (taps[1] + taps[2]) + taps[3];
        }
        return;
    }
    for (to, first) in to.chunks_exact_mut(step).zip((0..).step_by(2 * step)) {
        let [a, b, c, d] = [first, first + step, first + 2 * step, first + 3 * step];
        let (a, b, c, d) =
            (&run[a..a + step], &run[b..b + step], &run[c..c + step], &run[d..d + step]);
        for ((((to, a), b), c), d) in to.iter_mut().zip(a).zip(b).zip(c).zip(d) {
            *to = a + 3 * (b + c) + d;
        }
    }
}

/// The wide cells of `bin` that are within the walls at which the finer cells are mirrored.
fn wide_cells_of(bin: IVec3, mirror: Option<Mirror>) -> CellBox {
    let wide = CellBox::cube(bin, BIN);
    mirror.map_or(wide, |mirror| wide.intersection(&mirror.in_wider_cells(1).cells()))
}

/// The finer cells from which the wide cells of `bin` are computed; empty if none of these wide
/// cells is within the walls at which the finer cells are mirrored.
pub fn halved_from(bin: IVec3, mirror: Option<Mirror>) -> CellBox {
    let wide = wide_cells_of(bin, mirror);
    if wide.is_empty() {
        return CellBox::EMPTY;
    }
    let fine = halved_from_box(wide);
    mirror.map_or(fine, |mirror| mirror.with_sources(fine))
}

/// The finer cells from which the box `wide` of wide cells is computed, ignoring walls.
pub fn halved_from_box(wide: CellBox) -> CellBox {
    CellBox { lo: wide.lo * 2 - 1, hi: wide.hi * 2 + 1 }
}

/// Computes the pages of wide cells.
#[derive(Debug)]
struct Halving {
    fine: Arc<DifField>,
    mirror: Option<Mirror>,
    factor: Factor,
    bins: Vec<IVec3>,
    /// The pages in the scratch file, if there is one.
    kept: Option<ScratchPages>,
}

/// Pages in a scratch file. Without this file, recomputing a page of a field that was halved
/// repeatedly would read hundreds of pages of the finest field.
#[derive(Debug)]
struct ScratchPages {
    scratch: Scratch,
    /// For each page, its byte offset in the file and its number of words; `None` for a page that
    /// could not be written.
    places: Vec<Option<(u64, usize)>>,
}

impl ScratchPages {
    fn keep(scratch: &Scratch, samples: &PageSamples) -> Option<(u64, usize)> {
        let words = samples.to_words();
        Some((scratch.append(bytemuck::cast_slice(&words)).ok()?, words.len()))
    }

    fn read(&self, page: usize) -> Option<Vec<u16>> {
        let (at, len) = self.places[page]?;
        let mut words = vec![0; len];
        self.scratch.read_at(at, bytemuck::cast_slice_mut(&mut words)).ok()?;
        Some(PageSamples::dense_of_words(words, HALVED))
    }
}

impl Halving {
    /// Computes the samples of a bin, x fastest.
    fn dense(&self, bin: IVec3) -> Vec<u16> {
        let fine = halved_from(bin, self.mirror);
        let mut dense = vec![0; BIN.pow(3) as usize];
        if fine.is_empty() {
            return dense;
        }
        let wide = wide_cells_of(bin, self.mirror);
        let mut sums = vec![0; dense.len()];
        // Any cell beyond a wall may be the mirror image of a full cell, so no part is skipped.
        let parts = match self.mirror {
            Some(mirror) if !mirror.cells().covers(&fine) => vec![fine],
            _ => self.fine.parts_with_samples(fine),
        };
        for part in parts {
            self.add(&mut sums, bin, part, wide);
        }
        let factor = u64::from(self.factor.steps());
        for (to, sums) in dense.chunks_exact_mut(BIN as usize).zip(sums.chunks_exact(BIN as usize))
        {
            if sums.iter().fold(0, |any, sum| any | sum) == 0 {
                continue;
            }
            for (to, &sum) in to.iter_mut().zip(sums) {
                let scaled = (u64::from(sum) * factor + (1 << (HALVED_BITS - 1))) >> HALVED_BITS;
                *to = scaled.min(FULL.into()) as u16;
            }
        }
        dense
    }

    /// Adds the content of `part`, a box of finer cells, to the sums of the `wide` cells of a bin.
    fn add(&self, sums: &mut [u32], bin: IVec3, part: CellBox, wide: CellBox) {
        let near = CellBox { lo: (part.lo - 1) >> 1, hi: (part.hi >> 1) + 1 };
        let wide = wide.intersection(&near);
        let from = halved_from_box(wide);
        let mut fine = self.fine.gather_mirrored(part, self.mirror);
        if part.covers(&from) {
            fine = fine.part(from);
        } else {
            let samples = std::mem::replace(&mut fine, Block::zero(from));
            fine.put(&samples);
        }
        let corner = bin * BIN;
        let mut size = from.size().as_usizevec3();
        let mut halved: Vec<u32> = fine.samples().iter().map(|&sample| sample.into()).collect();
        // Halving along y and z adds contiguous samples. Halving along x is slower, because it adds
        // samples that are two apart. Therefore x comes last, when the fewest samples are left.
        for axis in [2, 1, 0] {
            let step = [1, size.x, size.x * size.y][axis];
            let planes = size[axis];
            size[axis] = planes / 2 - 1;
            let mut to = vec![0; size.element_product()];
            for (to, run) in
                to.chunks_exact_mut(step * size[axis]).zip(halved.chunks_exact(step * planes))
            {
                halved_along(to, run, step);
            }
            halved = to;
        }
        for (halved, [y, z]) in halved
            .chunks_exact(size.x)
            .zip((wide.lo.z..wide.hi.z).flat_map(|z| (wide.lo.y..wide.hi.y).map(move |y| [y, z])))
        {
            let at = IVec3::new(wide.lo.x, y, z) - corner;
            let first = (at.x + BIN * (at.y + BIN * at.z)) as usize;
            sums[first..].iter_mut().zip(halved).for_each(|(to, sum)| *to += sum);
        }
    }
}

impl PageSource for Halving {
    fn samples(&self, page: usize) -> Vec<u16> {
        let kept = self.kept.as_ref().and_then(|kept| kept.read(page));
        kept.unwrap_or_else(|| self.dense(self.bins[page]))
    }
}

impl DifField {
    /// The field on cells twice as wide. Each sample is the content of a wide cell times `factor`
    /// (at most 1), clamped to 65535. If this field is in memory, the pages of the result are also
    /// in memory; otherwise they are written to a scratch file in the folder `scratch`. Without
    /// such a folder, or without space in it, pages are recomputed on demand.
    pub fn halved(
        self: &Arc<Self>,
        mirror: Option<Mirror>,
        factor: f64,
        scratch: Option<&Path>,
    ) -> Self {
        // A mirror plane in the middle of a finer cell moves content by one cell.
        let reach = self.ghost_layer() + i32::from(mirror.is_some());
        let touched = |cells: CellBox| CellBox { lo: (cells.lo - 1) >> 1, hi: (cells.hi + 2) >> 1 };
        let mut keys: Vec<MortonKey> = self
            .infos()
            .iter()
            .flat_map(|info| touched(info.full.grown(reach, reach)).cubes(BIN))
            .map(MortonKey::of)
            .collect();
        keys.par_sort_unstable();
        keys.dedup();
        let bins = keys.into_iter().map(|key| key.coord());
        let bins: Vec<IVec3> = bins.filter(|&bin| !halved_from(bin, mirror).is_empty()).collect();
        let factor = Factor::new(factor);
        if let Some((infos, pages)) =
            self.remote().and_then(|pages| pages.halved(&bins, mirror, factor))
        {
            let bins = infos.iter().map(|info| info.key.coord()).collect();
            let halving = Halving { fine: Arc::clone(self), mirror, factor, bins, kept: None };
            return Self::from_remote(HALVED, infos, pages, Box::new(halving));
        }
        let halving = Halving { fine: Arc::clone(self), mirror, factor, bins, kept: None };
        let page = |&bin: &IVec3| PageInfo::from_dense(bin, &halving.dense(bin), HALVED);
        // The wide field has about an eighth of the finer field's cells. It gets a cache that is a
        // quarter as large as the cache of the finer field.
        let share = self.cache_bytes().map(|bytes| bytes / 4);
        let most = (halving.bins.len() * HALVED.bin_samples() * size_of::<u16>()) as u64;
        match share.filter(|&share| share < most) {
            None => Self::in_memory(HALVED, halving.bins.par_iter().filter_map(page).collect()),
            Some(share) => {
                let scratch = scratch.and_then(|folder| Scratch::in_folder(folder).ok());
                let pages = halving.bins.par_iter().filter_map(|bin| {
                    let (info, samples) = page(bin)?;
                    Some((
                        (*bin, info),
                        scratch.as_ref().and_then(|scratch| ScratchPages::keep(scratch, &samples)),
                    ))
                });
                let (pages, places): (Vec<_>, Vec<_>) =
                    pages.collect::<Vec<_>>().into_iter().unzip();
                let (bins, infos) = pages.into_iter().unzip();
                let kept = scratch.map(|scratch| ScratchPages { scratch, places });
                Self::paged(HALVED, infos, Box::new(Halving { bins, kept, ..halving }), share)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;
    use crate::brick::Pages;

    /// Four bins of noise in which about one in `among` cells is full.
    fn noise(among: u64) -> Arc<DifField> {
        let mut state = 7_u64;
        let mut random = move || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            state >> 33
        };
        let bins = [IVec3::new(-1, 0, 0), IVec3::ZERO, IVec3::new(0, 0, 1), IVec3::new(3, 0, 1)];
        let mut pages: Pages = bins
            .into_iter()
            .map(|bin| {
                let dense: Vec<u16> = (0..BIN.pow(3))
                    .map(|_| if random() % among == 0 { (random() % 30_000) as u16 + 1 } else { 0 })
                    .collect();
                PageInfo::from_dense(bin, &dense, HALVED).expect("the bin has a full cell")
            })
            .collect();
        pages.sort_by_key(|(info, _)| info.key);
        Arc::new(DifField::in_memory(HALVED, pages))
    }

    /// Evaluates the formula for one wide cell.
    fn by_formula(fine: &DifField, mirror: Option<Mirror>, cell: IVec3, factor: f64) -> u16 {
        let weights = [1.0, 3.0, 3.0, 1.0];
        let around = CellBox { lo: cell * 2 - 1, hi: cell * 2 + 3 };
        let mut sum = 0.0;
        for z in 0..4 {
            for y in 0..4 {
                for x in 0..4 {
                    let mut at = around.lo + IVec3::new(x, y, z);
                    if let Some(mirror) = mirror {
                        at = IVec3::from([0, 1, 2].map(|axis| mirror.source(axis, at[axis])));
                    }
                    let sample = fine.gather(CellBox { lo: at, hi: at + 1 }).at(at);
                    sum += weights[x as usize]
                        * weights[y as usize]
                        * weights[z as usize]
                        * f64::from(sample);
                }
            }
        }
        (sum / 64.0 * factor + 0.5).floor().min(65535.0) as u16
    }

    #[test]
    fn wide_cells_match_the_formula_with_and_without_walls() {
        let faces = CellBox { lo: IVec3::new(-5, -3, 1), hi: IVec3::new(14, 9, 30) };
        let odd = Mirror::new(faces);
        // Along x, a plane of `last` passes through the middle of cell -1 of `fine`, in the last
        // wide cell of a bin. A plane of `first` passes through the middle of cell 0, in the first
        // wide cell of a bin.
        let last = CellBox { lo: IVec3::new(-1, -3, -1), hi: 2 * faces.hi };
        let first = CellBox { lo: -2 * faces.hi, hi: IVec3::new(1, 33, 60) };
        let [last, first] = [last, first].map(|cells| Mirror::new(cells).in_wider_cells(1));
        for (among, mirror, factor) in [
            (3, None, 1.0),
            (3, None, 0.421_875),
            (3, Some(odd), 0.25),
            (3, Some(last), 1.0),
            (3, Some(first), 1.0),
            (500, None, 1.0),
            (500, Some(odd), 1.0),
        ] {
            let fine = noise(among);
            let wide = fine.halved(mirror, factor, None);
            let cells = CellBox { lo: IVec3::new(-10, -3, -3), hi: IVec3::new(34, 11, 19) };
            let cells = mirror.map_or(cells, |mirror| mirror.in_wider_cells(1).cells());
            let block = wide.gather(cells);
            let mut any = 0;
            for cell in cells.cubes(1) {
                assert_eq!(
                    block.at(cell),
                    by_formula(&fine, mirror, cell, factor),
                    "{cell} of {mirror:?}, {among}"
                );
                any += i32::from(block.at(cell) > 0);
            }
            assert!(any > if among == 3 { 40 } else { 10 });
        }
    }

    /// Pages in memory that count how often they are read.
    #[derive(Debug)]
    struct CountingPages {
        field: Arc<DifField>,
        requests: Arc<AtomicUsize>,
    }

    impl PageSource for CountingPages {
        fn samples(&self, page: usize) -> Vec<u16> {
            self.requests.fetch_add(1, Ordering::Relaxed);
            self.field.stored(page).into_owned()
        }
    }

    #[test]
    fn pages_beyond_memory_are_computed_once_if_there_is_a_scratch_folder() {
        let fine = noise(3);
        let folder = tempfile::tempdir().unwrap();
        let cells = CellBox { lo: IVec3::splat(-10), hi: IVec3::splat(40) };
        let expected = Arc::new(fine.halved(None, 0.5, None)).halved(None, 0.5, None).gather(cells);
        for scratch in [Some(folder.path()), None, Some(Path::new("/nowhere"))] {
            let requests = Arc::new(AtomicUsize::new(0));
            let source =
                CountingPages { field: Arc::clone(&fine), requests: Arc::clone(&requests) };
            // The cache has 1 byte, so no page fits into it.
            let paged_field = DifField::paged(HALVED, fine.infos().to_vec(), Box::new(source), 1);
            let wide = Arc::new(Arc::new(paged_field).halved(None, 0.5, scratch));
            let first_requests = requests.swap(0, Ordering::Relaxed);
            let wider = wide.halved(None, 0.5, scratch);
            assert!(
                first_requests > 0 && wider.gather(cells).samples() == expected.samples(),
                "{scratch:?}"
            );
            assert_eq!(requests.load(Ordering::Relaxed) == 0, scratch == Some(folder.path()));
        }
    }
}

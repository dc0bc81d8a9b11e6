//! A padded block: the dense samples of a box of cells, cut out of the sparse field.

use glam::IVec3;
use multiversion::multiversion;

use crate::grid::{CellBox, Mirror};

use super::samples::SamplePlace;

/// Number of samples that are processed together. They fit into the first-level cache.
const ROW: usize = 1 << 11;

/// Number of samples that are tested together.
const PIECE: usize = 256;

/// Maximum length, in samples, of a run of several rows.
const RUN: usize = 1 << 10;

/// An iterator over rows of a block: see [`Block::rows`].
#[derive(Debug, Clone)]
pub struct BlockRows<'a, T> {
    block: &'a Block<T>,
    part: CellBox,
    next: [i32; 2],
}

impl<'a, T: Copy + Default> Iterator for BlockRows<'a, T> {
    type Item = ([i32; 2], &'a [T]);

    #[inline]
    fn next(&mut self) -> Option<Self::Item> {
        let ([y, z], CellBox { lo, hi }) = (self.next, self.part);
        if z >= hi.z {
            return None;
        }
        self.next = if y + 1 < hi.y { [y + 1, z] } else { [lo.y, z + 1] };
        let first = self.block.index(IVec3::new(lo.x, y, z));
        Some(([y, z], &self.block.samples[first..first + (hi.x - lo.x) as usize]))
    }
}

/// Splits the cells of `part` into runs. `boxes` lists the cells of the blocks that will be
/// accessed. In each of these blocks, the samples of a run are consecutive. A run is one row along
/// x, or several short rows that are consecutive in all of these blocks. Returns the length of the
/// runs, in samples, and the first cell of each run.
///
/// # Panics
/// If one of the `boxes` does not cover `part`.
pub fn runs(part: CellBox, boxes: &[CellBox]) -> (usize, impl Iterator<Item = IVec3> + use<>) {
    for cells in boxes {
        assert!(cells.covers(&part), "{part:?} is not in {cells:?}");
    }
    let [width, height, depth] = part.size().max(IVec3::ZERO).to_array();
    let whole = |axis: usize| {
        boxes.iter().all(|cells| [cells.lo[axis], cells.hi[axis]] == [part.lo[axis], part.hi[axis]])
    };
    let candidates = [(height * depth, whole(0) && whole(1)), (height, whole(0))];
    let is_short = |&(rows, whole): &(i32, bool)| whole && (width * rows) as usize <= RUN;
    let rows = candidates.into_iter().find(is_short).map_or(1, |(rows, _)| rows.max(1));
    let all = if width > 0 { height * depth } else { 0 };
    let first = move |row: i32| part.lo + IVec3::new(0, row % height, row / height);
    ((width * rows).max(1) as usize, (0..all).step_by(rows as usize).map(first))
}

/// One sample for every cell of a box, x fastest.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Block<T = u16> {
    cells: CellBox,
    samples: Vec<T>,
}

impl<T: Copy + Default> Block<T> {
    /// A block of zeros.
    pub fn zero(cells: CellBox) -> Self {
        Self { cells, samples: vec![T::default(); cells.volume()] }
    }

    /// The cells of the block.
    pub fn cells(&self) -> CellBox {
        self.cells
    }

    /// All samples, x fastest, then y, then z.
    pub fn samples(&self) -> &[T] {
        &self.samples
    }

    /// Returns mutable access to all samples, x fastest, then y, then z.
    pub fn samples_mut(&mut self) -> &mut [T] {
        &mut self.samples
    }

    /// The distances, in samples, between adjacent cells along x, y and z.
    pub fn strides(&self) -> [usize; 3] {
        let size = self.cells.size().as_usizevec3();
        [1, size.x, size.x * size.y]
    }

    /// The index of the sample of `cell`.
    ///
    /// # Panics
    /// In debug builds, if the block does not contain the cell.
    #[inline]
    pub fn index(&self, cell: IVec3) -> usize {
        debug_assert!(self.cells.contains(cell), "{cell} is not in {:?}", self.cells);
        let [_, row, slab] = self.strides();
        let local = (cell - self.cells.lo).as_usizevec3();
        local.x + local.y * row + local.z * slab
    }

    /// The sample of `cell`.
    #[inline]
    pub fn at(&self, cell: IVec3) -> T {
        self.samples[self.index(cell)]
    }

    /// The run of `length` samples that starts at the cell `first`: see [`runs`].
    #[inline]
    pub fn run(&self, first: IVec3, length: usize) -> &[T] {
        &self.samples[self.index(first)..][..length]
    }

    /// The rows of `part` along x, each with its y and z.
    ///
    /// # Panics
    /// If the block does not cover `part`.
    pub fn rows(&self, part: CellBox) -> BlockRows<'_, T> {
        assert!(self.cells.covers(&part), "{part:?} is not in {:?}", self.cells);
        let z = if part.is_empty() { part.hi.z } else { part.lo.z };
        BlockRows { block: self, part, next: [part.lo.y, z] }
    }

    /// The cell of the sample with the index `place`.
    fn cell(&self, place: usize) -> IVec3 {
        // Blocks are small, so indices fit into 32 bits, and 32-bit division is faster.
        let place = place as u32;
        let [_, row, slab] = self.strides().map(|stride| stride as u32);
        let (z, rest) = (place / slab, place % slab);
        self.cells.lo + IVec3::new((rest % row) as i32, (rest / row) as i32, z as i32)
    }

    /// The first and the last cell whose sample satisfies `is`.
    fn ends_of(&self, is: impl Fn(T) -> bool) -> Option<[IVec3; 2]> {
        // Few samples satisfy `is`, so this tests a whole piece of samples at once.
        let any = |samples: &&[T]| {
            samples.iter().fold(0_u16, |any, &sample| any | u16::from(is(sample))) > 0
        };
        let mut pieces = self.samples.chunks(PIECE);
        let first = pieces.position(|piece| any(&piece))? * PIECE;
        let last =
            pieces.rposition(|piece| any(&piece)).map_or(first, |at| first + PIECE + at * PIECE);
        let piece = |at: usize| &self.samples[at..self.samples.len().min(at + PIECE)];
        let first = first + piece(first).iter().position(|&sample| is(sample))?;
        let last = last + piece(last).iter().rposition(|&sample| is(sample))?;
        Some([first, last].map(|place| self.cell(place)))
    }

    /// The tightest box around the cells whose samples satisfy `is`.
    pub fn box_of(&self, is: impl Fn(T) -> bool) -> CellBox {
        let mut found = CellBox::EMPTY;
        let Some([first, last]) = self.ends_of(&is) else { return found };
        let (lo, hi) = (self.cells.lo.with_z(first.z), self.cells.hi.with_z(last.z + 1));
        for ([y, z], row) in self.rows(CellBox { lo, hi }) {
            // In most rows, no sample satisfies `is`. This test of a whole row has no branches, so
            // it is fast.
            if row.iter().fold(0_u16, |any, &sample| any | u16::from(is(sample))) == 0 {
                continue;
            }
            let [first, end] = [
                row.iter().position(|&s| is(s)),
                row.iter().rposition(|&s| is(s)).map(|at| at + 1),
            ]
            .map(|at| self.cells.lo.x + at.unwrap_or(0) as i32);
            found = found
                .union(&CellBox { lo: IVec3::new(first, y, z), hi: IVec3::new(end, y + 1, z + 1) });
        }
        found
    }

    /// Sets the samples of `part` to `sample`.
    ///
    /// # Panics
    /// If the block does not cover `part`.
    pub fn fill(&mut self, part: CellBox, sample: T) {
        let size = part.size().as_usizevec3();
        for z in part.lo.z..part.hi.z {
            for y in part.lo.y..part.hi.y {
                let first = self.index(IVec3::new(part.lo.x, y, z));
                self.samples[first..first + size.x].fill(sample);
            }
        }
    }

    /// Sets each sample in `part` to `value(existing, new)`. The new `samples` cover the box
    /// `from`, x fastest.
    ///
    /// # Panics
    /// If `part` is not within both the block and `from`.
    pub(crate) fn put_part(
        &mut self,
        part: CellBox,
        from: CellBox,
        samples: &[T],
        value: impl Fn(T, T) -> T,
    ) {
        assert!(
            self.cells.covers(&part) && from.covers(&part),
            "{part:?} is not in {:?}",
            self.cells
        );
        let size = part.size().as_usizevec3();
        let from_strides = [from.size().x, from.size().x * from.size().y].map(|n| n as usize);
        let [_, row, slab] = self.strides();
        let first = self.index(part.lo);
        let local = (part.lo - from.lo).as_usizevec3();
        let samples = &samples[local.x + local.y * from_strides[0] + local.z * from_strides[1]..];
        let rows = (0..size.z).flat_map(|z| {
            (0..size.y)
                .map(move |y| (y * row + z * slab, y * from_strides[0] + z * from_strides[1]))
        });
        let to = &mut self.samples[first..];
        match size.x {
            2 => put_rows::<T, 2>(to, samples, rows, value),
            3 => put_rows::<T, 3>(to, samples, rows, value),
            4 => put_rows::<T, 4>(to, samples, rows, value),
            5 => put_rows::<T, 5>(to, samples, rows, value),
            6 => put_rows::<T, 6>(to, samples, rows, value),
            8 => put_rows::<T, 8>(to, samples, rows, value),
            10 => put_rows::<T, 10>(to, samples, rows, value),
            16 => put_rows::<T, 16>(to, samples, rows, value),
            18 => put_rows::<T, 18>(to, samples, rows, value),
            width => {
                for (at, from) in rows {
                    for (to, &from) in to[at..][..width].iter_mut().zip(&samples[from..]) {
                        *to = value(*to, from);
                    }
                }
            }
        }
    }

    /// Sets the sample of each cell in `samples` to `value(existing, new)`, and skips cells outside
    /// `part`. The places in `samples` are relative to the cell `corner`. Calls `fill` for each
    /// cell whose existing sample was the default.
    ///
    /// # Panics
    /// If `part` is not within the block.
    pub(super) fn put_cells(
        &mut self,
        part: CellBox,
        corner: IVec3,
        samples: &[(SamplePlace, T)],
        value: impl Fn(T, T) -> T,
        mut fill: impl FnMut(IVec3),
    ) where
        T: PartialEq,
    {
        assert!(self.cells.covers(&part), "{part:?} is not in {:?}", self.cells);
        for &(place, sample) in samples {
            let cell = corner + place.local();
            if part.contains(cell) {
                let index = self.index(cell);
                let existing = self.samples[index];
                if existing == T::default() {
                    fill(cell);
                }
                self.samples[index] = value(existing, sample);
            }
        }
    }

    /// A block with copies of this block's samples in `cells`.
    ///
    /// # Panics
    /// If `cells` are not within the block.
    pub fn part(&self, cells: CellBox) -> Self {
        let mut part = Self::zero(cells);
        part.put_part(cells, self.cells, &self.samples, |_, sample| sample);
        part
    }

    /// Copies the samples of `other` into this block.
    ///
    /// # Panics
    /// If a cell of `other` is not in this block.
    pub fn put(&mut self, other: &Self) {
        self.put_part(other.cells, other.cells, &other.samples, |_, sample| sample);
    }

    /// Applies a separable operation along x, then y, then z; see [`along`](Self::along).
    ///
    /// # Panics
    /// If the block is so small that no cell would remain.
    pub fn along_each_axis(mut self, reach: i32, fill: impl Fn(&mut [T], &[T], usize)) -> Self {
        let mut spare = Vec::new();
        (0..3).for_each(|axis| self.along(axis, reach, &mut spare, &fill));
        self
    }

    /// Replaces the samples with the results of `fill` along one axis. The block shrinks by `reach`
    /// cells at each end of the axis. `spare` is scratch memory: its content before the call does
    /// not matter, and its content after the call is undefined.
    ///
    /// `fill(to, taps, step)` overwrites `to`, a row of the result. It computes `to[i]` from
    /// `taps[i]`, `taps[i + step]`, ...: the first tap is `reach` cells below the sample, and the
    /// last tap is `reach` cells above it.
    ///
    /// # Panics
    /// If the block is so small that no cell would remain.
    pub fn along(
        &mut self,
        axis: usize,
        reach: i32,
        spare: &mut Vec<T>,
        fill: &impl Fn(&mut [T], &[T], usize),
    ) {
        if spare.len() < self.samples.len() {
            *spare = vec![T::default(); self.samples.len()];
        }
        let step = self.strides()[axis];
        let margin = 2 * reach as usize * step;
        self.cells.lo[axis] += reach;
        self.cells.hi[axis] -= reach;
        assert!(!self.cells.is_empty(), "a reach of {reach} leaves {:?}", self.cells);
        let fill_all = |to: &mut [T], taps: &[T]| {
            for (first, to) in (0..).step_by(ROW).zip(to.chunks_mut(ROW)) {
                fill(to, &taps[first..first + to.len() + margin], step);
            }
        };
        let volume = self.cells.volume();
        if axis == 0 {
            // Rows are short, so all rows are processed as one long row. Results that mix samples
            // of two rows are dropped.
            let all = self.samples.len() - margin;
            fill_all(&mut spare[..all], &self.samples);
            let width = self.cells.size().x as usize;
            for (to, row) in
                self.samples.chunks_exact_mut(width).zip(spare[..all].chunks(width + margin))
            {
                to.copy_from_slice(&row[..width]);
            }
        } else {
            let run = step * self.cells.size()[axis] as usize;
            for (to, taps) in
                spare[..volume].chunks_exact_mut(run).zip(self.samples.chunks_exact(run + margin))
            {
                fill_all(to, taps);
            }
            std::mem::swap(&mut self.samples, spare);
        }
        self.samples.truncate(volume);
    }

    /// Replaces each sample beyond the planes of `mirror`, if there is one, with the sample of the
    /// cell that is mirrored there. If the block does not contain this cell, which happens only
    /// beyond the reach of the filters, the nearest cell of the block is used instead. A block that
    /// lies completely beyond a plane does not change.
    pub fn mirror(&mut self, mirror: Option<Mirror>) {
        let Some(mirror) = mirror else { return };
        let (cells, inside) = (self.cells, mirror.cells());
        let known = inside.intersection(&cells);
        if inside.covers(&cells) || known.is_empty() {
            return;
        }
        let source = |axis: usize, cell: i32| {
            mirror.source(axis, cell).clamp(known.lo[axis], known.hi[axis] - 1)
        };
        let CellBox { lo, hi } = cells;
        for z in known.lo.z..known.hi.z {
            for y in known.lo.y..known.hi.y {
                let first = self.index(IVec3::new(lo.x, y, z));
                for x in (lo.x..known.lo.x).chain(known.hi.x..hi.x) {
                    let place = |x: i32| first + (x - lo.x) as usize;
                    self.samples[place(x)] = self.samples[place(source(0, x))];
                }
            }
        }
        for z in lo.z..hi.z {
            for y in lo.y..hi.y {
                let sources = [source(1, y), source(2, z)];
                if sources != [y, z] {
                    let [from, to] =
                        [sources, [y, z]].map(|[y, z]| self.index(IVec3::new(lo.x, y, z)));
                    self.samples.copy_within(from..from + (hi.x - lo.x) as usize, to);
                }
            }
        }
    }
}

impl Block {
    /// The cells with nonzero samples, x fastest; `None` if there are more than `most` of them.
    pub fn full_cells(&self, most: usize) -> Option<Vec<IVec3>> {
        let mut cells = Vec::new();
        for (first, piece) in (0..).step_by(PIECE).zip(self.samples.chunks(PIECE)) {
            if !any_full(piece) {
                continue;
            }
            for (place, &sample) in (first..).zip(piece) {
                if sample > 0 {
                    cells.push(self.cell(place));
                }
            }
            if cells.len() > most {
                return None;
            }
        }
        Some(cells)
    }
}

#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn any_full(samples: &[u16]) -> bool {
    samples.iter().fold(0, |any, sample| any | sample) > 0
}

/// Sets rows of `N` samples to `value(existing, new)`. `rows` gives, for each row, the indices at
/// which it begins in `to` and in the new `samples`. `N` is known at compile time. It is the length
/// of a row of a brick, or of the part of a brick that reaches into a neighbour's halo.
#[inline(always)]
fn put_rows<T: Copy, const N: usize>(
    to: &mut [T],
    samples: &[T],
    rows: impl Iterator<Item = (usize, usize)>,
    value: impl Fn(T, T) -> T,
) {
    for (at, from) in rows {
        let (Some(to), Some(from)) =
            (to[at..].first_chunk_mut::<N>(), samples[from..].first_chunk::<N>())
        else {
            unreachable!("both boxes cover the part")
        };
        let existing = *to;
        *to = std::array::from_fn(|i| value(existing[i], from[i]));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_beyond_walls_mirror_the_samples_before_them() {
        let cells = CellBox { lo: IVec3::new(-4, 2, -9), hi: IVec3::new(9, 8, 5) };
        let mut block = Block::zero(cells);
        (1..).zip(block.samples_mut()).for_each(|(number, sample)| *sample = number);
        let walls = CellBox { lo: IVec3::new(-1, 3, -20), hi: IVec3::new(3, 8, 2) };
        let narrow = Mirror::new(CellBox { lo: 2 * walls.lo + 1, hi: 2 * walls.hi });
        for mirror in [Mirror::new(walls), narrow.in_wider_cells(1)] {
            let mut mirrored = block.clone();
            mirrored.mirror(Some(mirror));
            for cell in (0..cells.volume()).map(|place| block.cell(place)) {
                let source = IVec3::from([0, 1, 2].map(|axis| mirror.source(axis, cell[axis])));
                assert_eq!(mirrored.at(cell), block.at(source), "{cell} from {source}, {mirror:?}");
            }
        }
    }
}

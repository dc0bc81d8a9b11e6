//! A page: the bricks of one bin.

use std::borrow::Cow;

use glam::IVec3;
use multiversion::multiversion;

use crate::grid::{BIN, CellBox, MortonKey, local_from_morton, local_morton};

use super::samples::take_sparse;
use super::{PageSamples, PageShape};

/// The description of a page. The description is always in memory; the samples of the page may be
/// stored elsewhere.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PageInfo {
    /// The key of the page's bin.
    pub key: MortonKey,
    /// A bit for every stored brick, at the brick's Morton index in the bin. Only bricks with a
    /// full cell of their own (outside the ghost layer) are stored.
    pub bricks: u64,
    /// The tightest box around the bin's full cells, in grid coordinates.
    pub full: CellBox,
    /// The number of full cells of the bin. A cell is full if a nonzero sample is stored for it.
    pub full_count: u32,
}

/// Pages with their samples.
pub type Pages = Vec<(PageInfo, PageSamples)>;

impl PageInfo {
    /// Describes a bin with `full_count` full cells. `layers` has one bit mask for each axis: bit i
    /// is set if layer i perpendicular to the axis has a full cell.
    pub(super) fn of_layers(
        key: MortonKey,
        bricks: u64,
        layers: [u16; 3],
        full_count: u32,
    ) -> Self {
        let lo = IVec3::from(layers.map(|bits| bits.trailing_zeros() as i32));
        let hi = IVec3::from(layers.map(|bits| bits.ilog2() as i32 + 1));
        let corner = key.coord() * BIN;
        Self { key, bricks, full: CellBox { lo: lo + corner, hi: hi + corner }, full_count }
    }

    /// Makes a page from the bricks of `dense` that have a full cell of their own. Without ghost
    /// layers, `dense` is a whole bin, x fastest; with ghost layers, it has the layout that
    /// [`from_bricks`](Self::from_bricks) takes.
    pub fn from_dense(bin: IVec3, dense: &[u16], shape: PageShape) -> Option<(Self, PageSamples)> {
        if shape.ghost_layer > 0 {
            return Self::from_bricks(bin, &mut dense.to_vec(), shape);
        }
        let edge = shape.side.cells();
        let mut bricks = Vec::with_capacity(dense.len());
        for local in (0..shape.side.bricks_per_bin()).map(local_from_morton) {
            for first in rows(local * edge, edge) {
                let (fours, _) = dense[first..first + edge as usize].as_chunks::<4>();
                fours.iter().for_each(|four| bricks.extend_from_slice(four));
            }
        }
        Self::from_bricks(bin, &mut bricks, shape)
    }

    /// Makes a page from the bricks that have a full cell of their own. `samples` has all bricks of
    /// a bin in Morton order, x fastest in each brick. The content of `samples` is undefined
    /// afterwards.
    pub fn from_bricks(
        bin: IVec3,
        samples: &mut [u16],
        shape: PageShape,
    ) -> Option<(Self, PageSamples)> {
        let mut full = FullCells::default();
        let (mut bricks, mut kept) = (0, 0);
        for index in 0..shape.side.bricks_per_bin() {
            let brick = index * shape.brick_samples()..(index + 1) * shape.brick_samples();
            if full.add(local_from_morton(index), &samples[brick.clone()], shape) {
                bricks |= 1 << index;
                if kept < brick.start {
                    samples.copy_within(brick, kept);
                }
                kept += shape.brick_samples();
            }
        }
        (bricks != 0).then(|| {
            let samples = PageSamples::new(Cow::Borrowed(&samples[..kept]), shape);
            (full.page(MortonKey::of(bin), bricks), samples)
        })
    }

    /// Moves the nonzero `samples` of a bin with a single brick into a page, and leaves zeros. All
    /// nonzero samples must come from particles in these `cells` of the bin. Returns `None` if no
    /// cell of the bin itself is full.
    pub fn take_sparse(
        bin: IVec3,
        samples: &mut [u16],
        cells: impl ExactSizeIterator<Item = [usize; 3]>,
        shape: PageShape,
    ) -> Option<(Self, PageSamples)> {
        let sparse = take_sparse(samples, cells, shape);
        let mut full = FullCells::default();
        let own = CellBox::cube(IVec3::ZERO, BIN);
        let places = sparse.iter().map(|(place, _)| place.local() - shape.ghost_layer);
        for cell in places.filter(|&cell| own.contains(cell)) {
            full.rows[(cell.y + BIN * cell.z) as usize] |= 1 << cell.x;
        }
        let any = full.rows.iter().any(|&row| row != 0);
        any.then(|| (full.page(MortonKey::of(bin), 1), PageSamples::Sparse(sparse)))
    }

    /// Describes the page with these stored `samples`; returns `None` if the page is invalid. A
    /// valid page has at least one brick. Each of its bricks has a full cell that belongs to the
    /// bin rather than to the ghost layer. All nonzero samples lie in the box around the bin's full
    /// cells, extended by the width of the ghost layer.
    ///
    /// # Panics
    /// If the number of samples does not match the bricks.
    pub fn from_samples(
        key: MortonKey,
        bricks: u64,
        samples: &[u16],
        shape: PageShape,
    ) -> Option<Self> {
        let mut full = FullCells::default();
        let set = (0..shape.side.bricks_per_bin()).filter(|index| bricks >> index & 1 != 0);
        assert_eq!(set.clone().count() * shape.brick_samples(), samples.len());
        let stored =
            || set.clone().map(local_from_morton).zip(samples.chunks_exact(shape.brick_samples()));
        if bricks == 0 || !stored().all(|(local, brick)| full.add(local, brick, shape)) {
            return None;
        }
        let page = full.page(key, bricks);
        let near = page.full.grown(shape.ghost_layer, shape.ghost_layer);
        let first = |local: IVec3| key.coord() * (BIN / shape.side.cells()) + local;
        let is_near = |(local, brick): (IVec3, &[u16])| {
            nonzero_are_in(brick, shape.cells_of(first(local)), near)
        };
        (shape.ghost_layer == 0 || stored().all(is_near)).then_some(page)
    }

    /// The inverse of [`from_dense`](Self::from_dense).
    pub(super) fn write_dense(&self, samples: &[u16], dense: &mut [u16], shape: PageShape) {
        dense.fill(0);
        let edge = shape.side.cells();
        for index in (0..shape.side.bricks_per_bin()).filter(|index| self.bricks >> index & 1 != 0)
        {
            let local = local_from_morton(index);
            let Some(samples) = self.brick(samples, local, shape) else { continue };
            if shape.ghost_layer == 0 {
                for (first, from) in
                    rows(local * edge, edge).zip(samples.chunks_exact(edge as usize))
                {
                    dense[first..first + edge as usize].copy_from_slice(from);
                }
            } else {
                dense[index * shape.brick_samples()..][..shape.brick_samples()]
                    .copy_from_slice(samples);
            }
        }
    }

    /// Maximum memory, in bytes, that the page's samples take.
    pub fn most_bytes(&self, shape: PageShape) -> usize {
        let nonzero = shape.cells_per_particle() * self.full_count as usize;
        let near = self.full.grown(shape.ghost_layer, shape.ghost_layer).volume();
        PageSamples::most_bytes(nonzero.min(near), self.bricks.count_ones() as usize, shape)
    }

    /// The number of stored samples.
    pub fn samples(&self, shape: PageShape) -> usize {
        self.bricks.count_ones() as usize * shape.brick_samples()
    }

    /// The part of the page's `samples` that belongs to the brick with the coordinates `local` in
    /// the bin; `None` if the brick is not stored.
    pub(super) fn brick<'a>(
        &self,
        samples: &'a [u16],
        local: IVec3,
        shape: PageShape,
    ) -> Option<&'a [u16]> {
        let bit = 1_u64 << local_morton(local);
        (self.bricks & bit != 0).then(|| {
            let size = shape.brick_samples();
            let rank = (self.bricks & (bit - 1)).count_ones() as usize;
            &samples[rank * size..(rank + 1) * size]
        })
    }
}

/// Whether all nonzero samples of the box `cells` belong to cells in `inside`.
fn nonzero_are_in(samples: &[u16], cells: CellBox, inside: CellBox) -> bool {
    let size = cells.size();
    let at = |i: i32| cells.lo + IVec3::new(i % size.x, i / size.x % size.y, i / (size.x * size.y));
    (0..).zip(samples).all(|(i, &sample)| sample == 0 || inside.contains(at(i)))
}

/// For each row of a brick, the index of the row's first cell among the cells of the bin. `corner`
/// is the brick's lowest cell.
fn rows(corner: IVec3, edge: i32) -> impl Iterator<Item = usize> {
    let first = move |y, z| (corner.x + BIN * (corner.y + y + BIN * (corner.z + z))) as usize;
    (0..edge).flat_map(move |z| (0..edge).map(move |y| first(y, z)))
}

/// The full cells of a bin, including cells that are filled only by the ghost layer of another
/// brick.
struct FullCells {
    /// For each row along x, one bit per cell; rows are sorted by z, then y.
    rows: [u16; (BIN * BIN) as usize],
}

impl Default for FullCells {
    fn default() -> Self {
        Self { rows: [0; (BIN * BIN) as usize] }
    }
}

impl FullCells {
    /// Adds the samples of the brick at `local`; returns whether the brick has a full cell of its
    /// own.
    fn add(&mut self, local: IVec3, samples: &[u16], shape: PageShape) -> bool {
        let PageShape { side, ghost_layer } = shape;
        let (own, edge) = (CellBox::cube(local, side.cells()), shape.edge());
        let first = own.lo - ghost_layer;
        let inside =
            own.grown(ghost_layer, ghost_layer).intersection(&CellBox::cube(IVec3::ZERO, BIN));
        let of_brick = ((1_u32 << side.cells()) - 1) << own.lo.x;
        let full = fullness(samples);
        let mut any = 0;
        for z in inside.lo.z..inside.hi.z {
            for y in inside.lo.y..inside.hi.y {
                let at = IVec3::new(inside.lo.x, y, z) - first;
                let row = &full[(at.x + edge * (at.y + edge * at.z)) as usize..];
                let row = &row[..inside.size().x as usize];
                // A row that spans the bin is converted to an array, whose length is known at
                // compile time.
                let bits = <&[u8; BIN as usize]>::try_from(row)
                    .map_or_else(|_| full_bits(row), |row| full_bits(row));
                let bits = (bits as u32) << inside.lo.x;
                self.rows[(y + BIN * z) as usize] |= bits as u16;
                if own.contains(IVec3::new(own.lo.x, y, z)) {
                    any |= bits & of_brick;
                }
            }
        }
        any != 0
    }

    /// The page with these full cells.
    fn page(&self, key: MortonKey, bricks: u64) -> PageInfo {
        let (layers, full_count) = summary(&self.rows);
        PageInfo::of_layers(key, bricks, layers, full_count)
    }
}

/// Returns, for each axis, a bit mask of the layers perpendicular to it that have a full cell; and
/// the number of full cells.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512vl+avx512bitalg",
    "x86_64+avx2+popcnt",
    "x86_64+sse4.2+popcnt"
))]
fn summary(rows: &[u16; (BIN * BIN) as usize]) -> ([u16; 3], u32) {
    let mut layers = [0_u16; 3];
    let (slabs, _) = rows.as_chunks::<{ BIN as usize }>();
    for (z, rows) in slabs.iter().enumerate() {
        let any = rows.iter().fold(0, |any, bits| any | bits);
        layers[0] |= any;
        layers[1] |= (0..).zip(rows).fold(0, |y, (i, &bits)| y | u16::from(bits != 0) << i);
        layers[2] |= u16::from(any != 0) << z;
    }
    (layers, rows.iter().map(|bits| bits.count_ones()).sum())
}

/// For each sample, a byte that is 1 if the sample is nonzero, and 0 otherwise.
pub fn fullness(samples: &[u16]) -> Vec<u8> {
    samples.iter().map(|&sample| u8::from(sample > 0)).collect()
}

/// Packs a row of [`fullness`] bytes into bits.
///
/// # Panics
/// If the row has more than 128 bytes.
#[inline]
pub fn full_bits(row: &[u8]) -> u128 {
    assert!(row.len() <= 128, "a row of {} cells exceeds 128 bits", row.len());
    let (eights, rest) = row.as_chunks::<8>();
    let rest = rest.iter().rev().fold(0, |bits, &full| bits << 1 | u128::from(full));
    // Each byte is 0 or 1. The multiplication moves byte i to bit 56 + i.
    let bits =
        |&eight: &[u8; 8]| u64::from_le_bytes(eight).wrapping_mul(0x0102_0408_1020_4080) >> 56;
    eights.iter().rev().fold(rest, |all, eight| all << 8 | u128::from(bits(eight)))
}

//! Bounding boxes of chunks of particles, collected while all particles are read. A later reader
//! that needs only some bins can skip the chunks whose boxes contain none of these bins.

use std::ops::Range;
use std::sync::{Mutex, PoisonError};

use glam::{DVec3, IVec3};
use multiversion::multiversion;

use crate::grid::{CellBox, Domain, Grid};
use crate::particles::{AttributeInfo, Particles, RereadError};

use super::bins::AXIS_BITS;

/// Number of positions that are processed together: a multiple of the number of lanes of every
/// vector width.
const LANES: usize = 8;

/// A wrapper around particles. While the particles are read, it records the bounding box of each
/// chunk.
#[derive(Debug)]
pub struct WithBoxes<'a> {
    particles: &'a dyn Particles,
    grid: Grid,
    chunks: Vec<ChunkExtent>,
}

#[derive(Debug)]
struct ChunkExtent {
    /// The index of the first particle.
    first: usize,
    extent: Mutex<Extent>,
}

/// Minimum and maximum coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Extent {
    lo: DVec3,
    hi: DVec3,
}

impl Extent {
    const NONE: Self = Self { lo: DVec3::INFINITY, hi: DVec3::NEG_INFINITY };

    /// The extent of positions. NaN coordinates are ignored.
    fn of(positions: &[[f64; 3]]) -> Self {
        let [lo, hi] = extent(positions);
        Self { lo: lo.into(), hi: hi.into() }
    }

    fn union(self, other: Self) -> Self {
        Self { lo: self.lo.min(other.lo), hi: self.hi.max(other.hi) }
    }

    fn is_on(&self, grid: &Grid) -> bool {
        [self.lo, self.hi].iter().all(|corner| grid.place(corner.to_array()).is_ok())
    }
}

impl<'a> WithBoxes<'a> {
    /// Wraps `particles`, which consist of consecutive chunks with these `counts`. The sum of
    /// `counts` must be the number of particles.
    pub fn new(
        particles: &'a dyn Particles,
        counts: impl Iterator<Item = usize>,
        grid: &Grid,
    ) -> Self {
        let mut end = 0;
        let chunks = counts.map(|count| {
            let first = end;
            end += count;
            ChunkExtent { first, extent: Mutex::new(Extent::NONE) }
        });
        let chunks = chunks.collect();
        assert_eq!(end, particles.len(), "the chunks contain all particles");
        Self { particles, grid: *grid, chunks }
    }

    /// For each chunk, a box of bins that contains all particles of the chunk that were read so
    /// far, except particles that are too far from the grid's origin or beyond the domain's walls;
    /// `None` if all particles that were read are too far from the grid's origin or not finite.
    pub fn boxes(&self, domain: Option<&Domain>) -> Vec<Option<CellBox>> {
        let bins = |chunk: &ChunkExtent| {
            let extent = *chunk.extent.lock().unwrap_or_else(PoisonError::into_inner);
            // Rounding to steps and clamping to the walls preserve the order of coordinates, so the
            // bins of the corners bound the bins of all particles.
            let bin = |corner: DVec3| {
                let mut steps = self.grid.place(corner.to_array()).ok()?;
                if let Some([first, last]) = domain.map(Domain::step_range) {
                    steps = std::array::from_fn(|axis| steps[axis].clamp(first[axis], last[axis]));
                }
                Some(IVec3::from(steps.map(|step| (step >> AXIS_BITS) as i32)))
            };
            Some(CellBox { lo: bin(extent.lo)?, hi: bin(extent.hi)? + 1 })
        };
        self.chunks.iter().map(bins).collect()
    }

    fn record_extents(&self, first: usize, positions: &[[f64; 3]]) {
        let mut at = self.chunks.partition_point(|chunk| chunk.first <= first).saturating_sub(1);
        let mut rest = positions;
        while !rest.is_empty() {
            let next = self.chunks.get(at + 1).map_or(usize::MAX, |chunk| chunk.first);
            let begin = first + (positions.len() - rest.len());
            let (own, later) = rest.split_at((next - begin).min(rest.len()));
            let mut extent = Extent::of(own);
            if !extent.is_on(&self.grid) {
                let placed = own.iter().filter(|&&position| self.grid.place(position).is_ok());
                extent = Extent::of(&placed.copied().collect::<Vec<_>>());
            }
            let mut all = self.chunks[at].extent.lock().unwrap_or_else(PoisonError::into_inner);
            *all = all.union(extent);
            drop(all);
            (rest, at) = (later, at + 1);
        }
    }
}

#[multiversion(targets("x86_64+avx512f", "x86_64+avx2"))]
fn extent(positions: &[[f64; 3]]) -> [[f64; 3]; 2] {
    // These comparisons are false for NaN, so NaN coordinates are ignored.
    let least = |a: f64, b: f64| if b < a { b } else { a };
    let greatest = |a: f64, b: f64| if b > a { b } else { a };
    let (mut lo, mut hi) = ([f64::INFINITY; 3 * LANES], [f64::NEG_INFINITY; 3 * LANES]);
    let (groups, rest) = positions.as_chunks::<LANES>();
    for group in groups {
        for (i, &x) in group.as_flattened().iter().enumerate() {
            lo[i] = least(lo[i], x);
            hi[i] = greatest(hi[i], x);
        }
    }
    for (i, &x) in rest.as_flattened().iter().enumerate() {
        lo[i] = least(lo[i], x);
        hi[i] = greatest(hi[i], x);
    }
    let axis = |a: usize| (a..3 * LANES).step_by(3);
    [
        std::array::from_fn(|a| axis(a).fold(f64::INFINITY, |all, i| least(all, lo[i]))),
        std::array::from_fn(|a| axis(a).fold(f64::NEG_INFINITY, |all, i| greatest(all, hi[i]))),
    ]
}

impl Particles for WithBoxes<'_> {
    fn len(&self) -> usize {
        self.particles.len()
    }

    fn positions(&self, first: usize, out: &mut [[f64; 3]]) {
        self.particles.positions(first, out);
        self.record_extents(first, out);
    }

    fn check(&self) -> Result<(), RereadError> {
        self.particles.check()
    }

    fn goes_on(&self) -> bool {
        self.particles.goes_on()
    }

    fn resident_bytes(&self) -> u64 {
        self.particles.resident_bytes() + size_of_val(&self.chunks[..]) as u64
    }

    fn release(&self, range: Range<usize>) {
        self.particles.release(range);
    }

    fn attributes(&self) -> &[AttributeInfo] {
        self.particles.attributes()
    }

    fn attribute(&self, index: usize, first: usize, out: &mut [f32]) {
        self.particles.attribute(index, first, out);
    }

    fn integers(&self, index: usize, first: usize, out: &mut [i64]) {
        self.particles.integers(index, first, out);
    }
}

#[cfg(test)]
mod tests {
    use crate::brick::{BinPlan, CountingRoom, InvalidParticles};

    use super::*;

    /// Positions at multiples of a bin's edge and at the nearest floating-point numbers on both
    /// sides, and invalid positions.
    fn particles(grid: &Grid) -> Vec<[f64; 3]> {
        let place = |i: usize, axis: usize| {
            let bins = ((i * [7919, 6761, 5879][axis]) % 97) as f64 - 48.0;
            let at = grid.origin()[axis] + 16.0 * grid.cell_size() * bins;
            [at.next_down(), at, at.next_up()][(i + axis) % 3]
        };
        let mut all: Vec<[f64; 3]> =
            (0..5000).map(|i| std::array::from_fn(|axis| place(i, axis))).collect();
        (all[3][1], all[700][0], all[1900][2]) = (f64::NAN, 1e30, f64::NEG_INFINITY);
        all[2000..2064].fill([f64::NAN; 3]);
        all
    }

    #[test]
    fn the_box_of_a_chunk_is_tight_around_the_bins_of_its_particles() {
        let grid = Grid::new(DVec3::new(0.3, -7.0, 1e-3), 0.37).unwrap();
        let walls =
            Domain::new(&grid, DVec3::splat(-100.1), DVec3::new(90.0, 120.0, 111.3)).unwrap();
        let particles = particles(&grid);
        for (chunk, read) in [(64, 512), (1000, 77), (5000, 5000), (1, 13)] {
            let counts = || (0..5000).step_by(chunk).map(|first| chunk.min(5000 - first));
            for domain in [None, Some(&walls)] {
                let watched = WithBoxes::new(&particles, counts(), &grid);
                for first in (0..5000).step_by(read).rev() {
                    watched.positions(first, &mut vec![[0.0; 3]; read.min(5000 - first)]);
                }
                for (own, found) in particles.chunks(chunk).zip(watched.boxes(domain)) {
                    let room = CountingRoom::BINS;
                    let counted = |domain| {
                        BinPlan::count(&own, &grid, domain, InvalidParticles::Skip, room).unwrap()
                    };
                    let around = |plan: &BinPlan| {
                        let bins = plan.keys().iter().map(|key| CellBox::cube(key.coord(), 1));
                        bins.reduce(|one, other| one.union(&other))
                    };
                    let (inside, all) = (around(&counted(domain)), around(&counted(None)));
                    assert_eq!(found.is_some(), all.is_some());
                    assert!(
                        inside
                            .is_none_or(|inside| found.is_some_and(|found| found.covers(&inside)))
                    );
                    if domain.is_none() {
                        assert_eq!(found, inside);
                    }
                }
            }
        }
    }
}

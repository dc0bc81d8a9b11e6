//! Samples of many particles: an even sample of all particles, and all particles in some cubes.
//! Neither sample depends on the particles' order.

use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, PoisonError};

use glam::DVec3;
use multiversion::multiversion;
use rayon::prelude::*;

use crate::particles::Bounds;

/// Target number of particles in an even sample, which holds from half to twice this number.
pub const SHARE: usize = 1 << 18;

/// An even sample of the positions of many particles.
pub struct EvenSample {
    one_in: u64,
    sampled: Mutex<SampledPositions>,
}

/// The positions of a sample, and the bounds of all particles so far.
struct SampledPositions {
    positions: Vec<[f64; 3]>,
    /// Maximum number of positions before duplicates are dropped.
    room: usize,
    has_duplicates: bool,
    /// Bounds of all particles, not only of the sample.
    bounds: Bounds,
}

/// The sample after all particles were added.
pub struct FinishedSample {
    /// Distinct positions.
    pub positions: Vec<[f64; 3]>,
    /// The share of all distinct positions that the sample holds.
    pub part: f64,
    /// The number of distinct positions of all particles; an estimate if some positions hold
    /// several particles.
    pub places: usize,
    /// Bounds of all particles.
    pub bounds: Bounds,
    one_in: u64,
}

impl EvenSample {
    /// Begins a sample from `particles` particles.
    pub fn of(particles: usize) -> Self {
        Self::one_in((particles / SHARE).max(1).next_power_of_two() as u64)
    }

    fn one_in(one_in: u64) -> Self {
        let bounds = Bounds::NONE;
        let sampled = SampledPositions {
            positions: Vec::new(),
            room: 4 * SHARE,
            has_duplicates: false,
            bounds,
        };
        Self { one_in, sampled: Mutex::new(sampled) }
    }

    /// Adds the sample's share of the particles at `positions`. Positions that are not finite are
    /// ignored.
    pub fn add(&self, positions: &[[f64; 3]]) {
        let mut selected = [[0.0; 3]; BATCH];
        let mut bounds = Bounds::NONE;
        let mut taken = Vec::new();
        for positions in positions.chunks(BATCH) {
            bounds = bounds.joined(Bounds::of(positions));
            // This loop has no branch, because a branch would be unpredictable.
            let mut end = 0;
            for &position in positions {
                selected[end] = position;
                end += usize::from(position_hash(position) & (self.one_in - 1) == 0);
            }
            taken.extend_from_slice(&selected[..end]);
        }
        if bounds.finite < positions.len() {
            taken.retain(|position| DVec3::from(*position).is_finite());
        }
        let all = taken.len();
        taken.dedup_by_key(|position| position.map(f64::to_bits));
        let mut sampled = self.sampled.lock().unwrap_or_else(PoisonError::into_inner);
        sampled.has_duplicates |= taken.len() < all;
        sampled.bounds = sampled.bounds.joined(bounds);
        sampled.positions.extend(taken);
        if sampled.positions.len() > sampled.room {
            sampled.drop_duplicates();
            sampled.room = (2 * sampled.positions.len()).max(4 * SHARE);
        }
    }

    /// Finishes the sample.
    pub fn taken(self) -> FinishedSample {
        let Self { one_in, sampled } = self;
        let mut sampled = sampled.into_inner().unwrap_or_else(PoisonError::into_inner);
        let all = sampled.positions.len();
        let positions = without_duplicates(std::mem::take(&mut sampled.positions));
        let has_duplicates = sampled.has_duplicates || positions.len() < all;
        let bounds = sampled.bounds;
        let (taken, all) = (positions.len() as f64, bounds.finite as f64);
        let expected = taken * one_in as f64;
        // If the sample is smaller than chance explains, it lacks a position with many particles.
        let is_small = (1.0 - expected / all) * taken.sqrt() > 6.0;
        let distinct = if has_duplicates || is_small { expected.min(all) } else { all };
        FinishedSample {
            positions,
            part: taken / distinct,
            places: distinct as usize,
            bounds,
            one_in,
        }
    }
}

impl SampledPositions {
    /// Drops duplicate positions. Sorts on this thread only, because a parallel sort could steal a
    /// task that waits for the same lock, which would be a deadlock.
    fn drop_duplicates(&mut self) {
        let all = self.positions.len();
        self.positions.sort_unstable_by_key(|position| position.map(f64::to_bits));
        self.positions.dedup_by_key(|position| position.map(f64::to_bits));
        self.has_duplicates |= self.positions.len() < all;
    }
}

impl FinishedSample {
    /// A larger sample for a second reading, if the particles have so few distinct positions that
    /// this sample is almost empty.
    pub fn larger(&self) -> Option<EvenSample> {
        const FEW: usize = SHARE / 256;
        let is_small = self.positions.len() < FEW && self.one_in > 1;
        is_small.then(|| EvenSample::one_in((self.one_in / 256).max(1)))
    }
}

/// Number of positions that are hashed together.
const BATCH: usize = 512;

/// A hash of a position, which does not depend on its index in the file.
#[inline(always)]
pub fn position_hash(position: [f64; 3]) -> u64 {
    position.iter().fold(0, |state, c| mixed(state ^ c.to_bits()))
}

/// A faster hash than [`position_hash`], of lower quality for particles on a lattice.
#[inline(always)]
pub fn quick_hash([x, y, z]: [f64; 3]) -> u64 {
    mixed(x.to_bits() ^ y.to_bits().rotate_left(21) ^ z.to_bits().rotate_left(42))
}

#[inline(always)]
fn mixed(state: u64) -> u64 {
    let mixed = state.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let mixed = (mixed ^ (mixed >> 32)).wrapping_mul(0xd6e8_feb8_6659_fd93);
    mixed ^ (mixed >> 32)
}

/// A grid of cubes, each as wide as a few neighbourhoods.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cubes {
    edge: f64,
}

impl Cubes {
    /// Edge of a cube in spacings. For a particle in the middle third of a cube, all particles
    /// within two spacings are in the same cube. The edge is not a multiple of the spacing, so a
    /// lattice has a different offset in each cube.
    const SPACINGS: f64 = 6.37;

    /// Cubes that are wide enough to show the neighbours of particles with this spacing.
    pub fn for_spacing(spacing: f64) -> Self {
        Self { edge: Self::SPACINGS * spacing }
    }

    /// A hash that is the same for all positions in a cube.
    #[inline(always)]
    fn number(&self, position: [f64; 3]) -> u32 {
        let scale = 1.0 / self.edge;
        // Cubes with coordinates beyond 2^31 are treated as one cube.
        let [x, y, z] = position.map(|c| (c * scale + 0.5).floor() as i32 as u32);
        // This is the finalizer of MurmurHash3, which gives adjacent cubes unrelated numbers.
        let sum =
            x.wrapping_mul(0x9e37_79b1) ^ y.wrapping_mul(0x85eb_ca77) ^ z.wrapping_mul(0xc2b2_ae3d);
        let mixed = (sum ^ (sum >> 16)).wrapping_mul(0x85eb_ca6b);
        let mixed = (mixed ^ (mixed >> 13)).wrapping_mul(0xc2b2_ae35);
        mixed ^ (mixed >> 16)
    }

    /// The largest distance such that all neighbours within it are in the particle's cube; `None`
    /// if the particle is not in the middle third of the cube along every axis.
    pub fn covered_around(&self, position: [f64; 3]) -> Option<f64> {
        let of_axis = |c: &f64| {
            // Coordinate 0, where floors and planes often are, is in the middle of a cube.
            let at = c / self.edge + 0.5;
            let within = at - at.floor();
            within.min(1.0 - within)
        };
        let nearest = position.iter().map(of_axis).fold(f64::INFINITY, f64::min);
        (nearest >= 1.0 / 3.0).then_some(nearest * self.edge)
    }
}

/// Particles to search for neighbours.
#[derive(Debug)]
pub struct NeighbourSample {
    /// All finite particles, or the particles in some cubes.
    pub positions: Vec<[f64; 3]>,
    /// The particles in a few of the cubes.
    pub few: Vec<[f64; 3]>,
    /// The cubes; `None` if the sample has all particles.
    pub cubes: Option<Cubes>,
    /// A lower bound of the number of particles that were dropped because another particle has the
    /// same position.
    pub coincident: usize,
}

/// Number of particles, in a few cubes, that suffices to confirm a count.
const FEW: usize = 1 << 13;

impl NeighbourSample {
    /// A sample of all particles.
    pub fn whole(positions: Vec<[f64; 3]>) -> Self {
        Self { positions, few: Vec::new(), cubes: None, coincident: 0 }
    }
}

/// The distinct positions, in a random order that does not depend on the order of the particles.
pub fn distinct(positions: Vec<[f64; 3]>) -> Vec<[f64; 3]> {
    let mut numbered: Vec<(u64, [f64; 3])> =
        positions.into_par_iter().map(|position| (position_hash(position), position)).collect();
    numbered.par_sort_unstable_by_key(|&(number, _)| number);
    let mut positions: Vec<[f64; 3]> = numbered.into_iter().map(|(_, position)| position).collect();
    positions.dedup_by_key(|position| position.map(f64::to_bits));
    positions
}

/// The distinct positions in any order; faster than [`distinct`] if there are no duplicates.
fn without_duplicates(positions: Vec<[f64; 3]>) -> Vec<[f64; 3]> {
    let numbers: Vec<u64> = positions.par_iter().map(|&position| position_hash(position)).collect();
    if any_equal(&numbers) { distinct(positions) } else { positions }
}

/// Whether any two of the hashes are equal.
fn any_equal(numbers: &[u64]) -> bool {
    /// The number of upper bits of a hash that index a table of bits. With this number, different
    /// hashes rarely share a bit.
    const BITS: u32 = 23;
    let place = |number: u64| {
        let bit = number >> (u64::BITS - BITS);
        ((bit / 64) as usize, 1_u64 << (bit % 64))
    };
    let mut bits = vec![[0; 2]; 1 << (BITS - 6)];
    for (word, bit) in numbers.iter().map(|&number| place(number)) {
        let [once, twice] = &mut bits[word];
        *twice |= *once & bit;
        *once |= bit;
    }
    let is_shared = |&number: &u64| {
        let (word, bit) = place(number);
        bits[word][1] & bit != 0
    };
    let mut shared: Vec<u64> = numbers.iter().copied().filter(is_shared).collect();
    shared.sort_unstable();
    shared.windows(2).any(|pair| pair[0] == pair[1])
}

/// All particles in the cubes with the lowest numbers, up to a maximum number of particles.
#[derive(Debug)]
pub struct CubeSample {
    cubes: Cubes,
    /// Maximum number of particles.
    room: usize,
    /// Cubes with this number or a higher one are excluded.
    end: AtomicU32,
    kept: Mutex<Vec<OccupiedPlace>>,
}

/// A position with at least one particle.
#[derive(Debug, Clone, Copy)]
struct OccupiedPlace {
    /// The number of the position's cube.
    number: u32,
    position: [f64; 3],
    /// Whether the position has more than one particle.
    several: bool,
}

impl CubeSample {
    /// Begins a sample from `particles` particles.
    pub fn new(cubes: Cubes, particles: usize) -> Self {
        Self::within(1 << 15, cubes, particles)
    }

    /// Begins a small sample from `particles` particles. Such a sample suffices to confirm a count.
    pub fn few(cubes: Cubes, particles: usize) -> Self {
        Self::within(FEW, cubes, particles)
    }

    fn within(room: usize, cubes: Cubes, particles: usize) -> Self {
        // The cubes numbered below `end` are expected to hold twice `room` particles, so that they
        // probably hold at least `room`.
        let share = 2.0 * room as f64 / particles.max(1) as f64;
        let end = (share * f64::from(u32::MAX)) as u32;
        Self { cubes, room, end: AtomicU32::new(end), kept: Mutex::default() }
    }

    /// Adds the particles that are in the sample's cubes.
    pub fn add(&self, positions: &[[f64; 3]]) {
        let end = self.end.load(Ordering::Relaxed);
        let mut taken = Vec::new();
        let mut numbers = [0; BATCH];
        for positions in positions.chunks(BATCH) {
            let numbers = &mut numbers[..positions.len()];
            cube_numbers(self.cubes, positions, numbers);
            let selected = positions.iter().zip(&*numbers).filter(|&(_, &number)| number < end);
            taken.extend(selected.map(|(&position, &number)| OccupiedPlace {
                number,
                position,
                several: false,
            }));
        }
        taken.retain(|kept| DVec3::from(kept.position).is_finite());
        OccupiedPlace::merge(&mut taken);
        if taken.is_empty() {
            return;
        }
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let end = self.end.load(Ordering::Relaxed);
        kept.extend(taken.into_iter().filter(|kept| kept.number < end));
        if kept.len() > 2 * self.room {
            self.end.store(self.fitted(&mut kept, end), Ordering::Relaxed);
        }
    }

    /// Keeps one particle per position, and only cubes whose numbers are below a new end, so that
    /// at most `room` particles remain. Returns the new end. The end is halved as long as too many
    /// particles are below it, so the result does not depend on the order of the particles. Sorts
    /// on this thread only: see [`SampledPositions::drop_duplicates`].
    fn fitted(&self, kept: &mut Vec<OccupiedPlace>, mut end: u32) -> u32 {
        kept.sort_unstable_by_key(|kept| (kept.number, kept.position.map(f64::to_bits)));
        OccupiedPlace::merge(kept);
        while kept.len() > self.room {
            end /= 2;
            kept.retain(|kept| kept.number < end);
        }
        end
    }

    /// Finishes the sample after all particles were added.
    pub fn sample(self) -> NeighbourSample {
        let mut kept =
            std::mem::take(&mut *self.kept.lock().unwrap_or_else(PoisonError::into_inner));
        let end = self.fitted(&mut kept, self.end.load(Ordering::Relaxed));
        let positions: Vec<[f64; 3]> = kept.iter().map(|kept| kept.position).collect();
        let share = (FEW as f64 / positions.len().max(1) as f64).min(1.0);
        let end = (f64::from(end) * share) as u32;
        let few = positions[..kept.partition_point(|kept| kept.number < end)].to_vec();
        let coincident = kept.iter().filter(|kept| kept.several).count();
        NeighbourSample { positions, few, cubes: Some(self.cubes), coincident }
    }
}

impl OccupiedPlace {
    /// Merges consecutive entries with the same position.
    fn merge(all: &mut Vec<Self>) {
        all.dedup_by(|other, kept| {
            let same = other.position.map(f64::to_bits) == kept.position.map(f64::to_bits);
            kept.several |= same;
            same
        });
    }
}

/// Computes the cube number of each position.
#[multiversion(targets("x86_64+avx512f+avx512dq", "x86_64+avx2", "x86_64+sse4.1"))]
fn cube_numbers(cubes: Cubes, positions: &[[f64; 3]], numbers: &mut [u32]) {
    for (number, &position) in numbers.iter_mut().zip(positions) {
        *number = cubes.number(position);
    }
}

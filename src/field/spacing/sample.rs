//! Samples of many particles: an even share of all, and all in some cubes. Neither depends on their
//! order.

use std::sync::atomic::{AtomicU32, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use glam::DVec3;
use multiversion::multiversion;
use rayon::prelude::*;

/// An even share holds at least half as many particles as this, and at most twice as many.
pub const SHARE: usize = 1 << 18;

/// An even share of many particles.
pub struct Share {
    one_in: u64,
    finite: AtomicUsize,
    positions: Mutex<Vec<[f64; 3]>>,
}

impl Share {
    /// The share of `particles` particles, none of which was looked at yet.
    #[must_use]
    pub fn of(particles: usize) -> Self {
        let one_in = (particles / SHARE).max(1).next_power_of_two() as u64;
        Self { one_in, finite: AtomicUsize::new(0), positions: Mutex::default() }
    }

    /// Takes its share of some particles. Those that are not finite are passed over.
    pub fn look(&self, positions: &[[f64; 3]]) {
        let mut numbers = [0; LOOKED];
        let (mut finite, mut taken) = (0, Vec::new());
        for positions in positions.chunks(LOOKED) {
            let numbers = &mut numbers[..positions.len()];
            finite += scatter(positions, numbers);
            let ours = |&(_, number): &(_, &u64)| number & (NOT_FINITE | (self.one_in - 1)) == 0;
            taken.extend(positions.iter().zip(&*numbers).filter(ours).map(|(&position, _)| position));
        }
        self.finite.fetch_add(finite, Ordering::Relaxed);
        if !taken.is_empty() {
            self.positions.lock().unwrap_or_else(PoisonError::into_inner).extend(taken);
        }
    }

    /// The part of all particles that was taken, and their positions.
    #[must_use]
    pub fn taken(self) -> (f64, Vec<[f64; 3]>) {
        let positions = self.positions.into_inner().unwrap_or_else(PoisonError::into_inner);
        (positions.len() as f64 / self.finite.into_inner() as f64, positions)
    }
}

/// Positions whose numbers are found at once.
const LOOKED: usize = 512;
/// The bit of a position's number that says that it is not finite.
const NOT_FINITE: u64 = 1 << 63;

/// Finds the number of each position, with [`NOT_FINITE`] set or not, and how many are finite.
#[multiversion(targets("x86_64+avx512f+avx512dq", "x86_64+avx2", "x86_64+sse4.1"))]
fn scatter(positions: &[[f64; 3]], numbers: &mut [u64]) -> usize {
    let mut finite = 0;
    for (number, &position) in numbers.iter_mut().zip(positions) {
        let is_finite = position.iter().fold(true, |all, c| all & c.is_finite());
        finite += usize::from(is_finite);
        *number = scattered(position) & !NOT_FINITE | if is_finite { 0 } else { NOT_FINITE };
    }
    finite
}

/// A number that is as good as random, and the same wherever a particle stands in its file.
#[inline(always)]
pub fn scattered(position: [f64; 3]) -> u64 {
    position.iter().fold(0, |state, c| mixed(state ^ c.to_bits()))
}

/// A number like that of [`scattered`], of a lattice's particles not quite as good, and found
/// sooner.
#[inline(always)]
pub fn lightly_scattered([x, y, z]: [f64; 3]) -> u64 {
    mixed(x.to_bits() ^ y.to_bits().rotate_left(21) ^ z.to_bits().rotate_left(42))
}

#[inline(always)]
fn mixed(state: u64) -> u64 {
    let mixed = state.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let mixed = (mixed ^ (mixed >> 32)).wrapping_mul(0xd6e8_feb8_6659_fd93);
    mixed ^ (mixed >> 32)
}

/// A grid of cubes that are as wide as some neighbourhoods.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cubes {
    edge: f64,
}

impl Cubes {
    /// Edge of a cube in spacings: within its middle third a particle is seen with all others
    /// within two spacings. Lattices are at other places in each cube.
    const SPACINGS: f64 = 6.37;

    /// Cubes that show the neighbours of particles so far apart.
    #[must_use]
    pub fn for_spacing(spacing: f64) -> Self {
        Self { edge: Self::SPACINGS * spacing }
    }

    /// A number that is as good as random, and the same for all positions in a cube.
    #[inline(always)]
    fn number(&self, position: [f64; 3]) -> u32 {
        let scale = 1.0 / self.edge;
        // Beyond 2^31 all cubes are one.
        let [x, y, z] = position.map(|c| (c * scale + 0.5).floor() as i32 as u32);
        // The finalizer of MurmurHash3, of a number that differs between neighbours.
        let sum = x.wrapping_mul(0x9e37_79b1) ^ y.wrapping_mul(0x85eb_ca77) ^ z.wrapping_mul(0xc2b2_ae3d);
        let mixed = (sum ^ (sum >> 16)).wrapping_mul(0x85eb_ca6b);
        let mixed = (mixed ^ (mixed >> 13)).wrapping_mul(0xc2b2_ae35);
        mixed ^ (mixed >> 16)
    }

    /// The distance within which all neighbours of a particle are in its cube; `None` outside of
    /// the cube's middle.
    #[must_use]
    pub fn shown_around(&self, position: [f64; 3]) -> Option<f64> {
        let of_axis = |c: &f64| {
            // Coordinate 0, where floors and planes are, is in the middle of a cube.
            let at = c / self.edge + 0.5;
            let within = at - at.floor();
            within.min(1.0 - within)
        };
        let nearest = position.iter().map(of_axis).fold(f64::INFINITY, f64::min);
        (nearest >= 1.0 / 3.0).then_some(nearest * self.edge)
    }
}

/// Particles to be searched for neighbours.
#[derive(Debug)]
pub struct Sample {
    /// All finite ones, or those in some cubes.
    pub positions: Vec<[f64; 3]>,
    /// The particles in a few of the cubes.
    pub few: Vec<[f64; 3]>,
    /// The cubes, if it is not all.
    pub cubes: Option<Cubes>,
}

/// Particles in a few cubes that are enough to bear out a count.
const FEW: usize = 1 << 13;

impl Sample {
    /// All particles.
    #[must_use]
    pub fn whole(positions: Vec<[f64; 3]>) -> Self {
        Self { positions, few: Vec::new(), cubes: None }
    }
}

/// One position of those in each place, in an order as good as random that is the same for all
/// orders of the particles.
#[must_use]
pub fn distinct(positions: Vec<[f64; 3]>) -> Vec<[f64; 3]> {
    let mut numbered: Vec<(u64, [f64; 3])> =
        positions.into_par_iter().map(|position| (scattered(position), position)).collect();
    numbered.par_sort_unstable_by_key(|&(number, _)| number);
    let mut positions: Vec<[f64; 3]> = numbered.into_iter().map(|(_, position)| position).collect();
    positions.dedup();
    positions
}

/// All particles in some cubes: in those with the least numbers, as far as the room goes.
#[derive(Debug)]
pub struct InCubes {
    cubes: Cubes,
    /// Numbers from this one on are too great.
    end: AtomicU32,
    positions: Mutex<Vec<(u32, [f64; 3])>>,
}

impl InCubes {
    /// The largest number of particles that are kept.
    const ROOM: usize = 1 << 15;

    /// Begins with none, of `particles` particles.
    #[must_use]
    pub fn new(cubes: Cubes, particles: usize) -> Self {
        // Twice as many as there is room for are to be expected below this end, and some in the
        // cubes with the least numbers.
        let share = 2.0 * Self::ROOM as f64 / particles.max(1) as f64;
        let end = (share * f64::from(u32::MAX)) as u32;
        Self { cubes, end: AtomicU32::new(end), positions: Mutex::default() }
    }

    /// Takes those of some particles that are in the cubes.
    pub fn look(&self, positions: &[[f64; 3]]) {
        let end = self.end.load(Ordering::Relaxed);
        let mut taken = Vec::new();
        let mut numbers = [0; LOOKED];
        for positions in positions.chunks(LOOKED) {
            let numbers = &mut numbers[..positions.len()];
            cube_numbers(self.cubes, positions, numbers);
            let both = positions.iter().zip(&*numbers).filter(|&(_, &number)| number < end);
            taken.extend(both.map(|(&position, &number)| (number, position)));
        }
        taken.retain(|(_, position)| DVec3::from(*position).is_finite());
        if taken.is_empty() {
            return;
        }
        let mut kept = self.positions.lock().unwrap_or_else(PoisonError::into_inner);
        let mut end = self.end.load(Ordering::Relaxed);
        kept.extend(taken.into_iter().filter(|&(number, _)| number < end));
        // Halved by how many there are in all: whatever came first, the same are left.
        while kept.len() > Self::ROOM {
            end /= 2;
            kept.retain(|&(number, _)| number < end);
        }
        self.end.store(end, Ordering::Relaxed);
    }

    /// The sample, once all particles were looked at.
    #[must_use]
    pub fn sample(self) -> Sample {
        let end = self.end.into_inner();
        let kept = self.positions.into_inner().unwrap_or_else(PoisonError::into_inner);
        let in_cubes: Vec<_> = kept.into_iter().filter(|&(number, _)| number < end).collect();
        let positions = in_cubes.iter().map(|&(_, position)| position).collect();
        let share = (FEW as f64 / in_cubes.len().max(1) as f64).min(1.0);
        let end = (f64::from(end) * share) as u32;
        let few = in_cubes.iter().filter(|&&(number, _)| number < end).map(|&(_, position)| position);
        let few = few.collect();
        Sample { positions, few, cubes: Some(self.cubes) }
    }
}

/// Finds the number of the cube of each position.
#[multiversion(targets("x86_64+avx512f+avx512dq", "x86_64+avx2", "x86_64+sse4.1"))]
fn cube_numbers(cubes: Cubes, positions: &[[f64; 3]], numbers: &mut [u32]) {
    for (number, &position) in numbers.iter_mut().zip(positions) {
        *number = cubes.number(position);
    }
}

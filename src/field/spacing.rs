//! The particles' spacing, estimated from their number density deep in the fluid.
//!
//! Spacing is the edge of the cube that a particle fills: (volume / number)^(1/3). Counting in cells a few
//! spacings wide, and only in those whose 26 neighbours hold particles too, leaves surfaces out of it.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use glam::{DVec3, IVec3};
use hashbrown::HashMap;
use multiversion::multiversion;
use rayon::prelude::*;

use crate::brick::{BinPlan, CountingRoom, InvalidParticles};
use crate::grid::{BIN, Grid};
use crate::particles::{Bounds, Particles, bounds, finite_chunks};

/// Particles a counting cell should hold: first choice, and what thin layers are tried with.
const TARGETS: [f64; 3] = [48.0, 16.0, 6.0];
/// Interior cells that make an estimate worth having.
const ENOUGH_CELLS: usize = 8;
/// Particles of a part in interior cells that make its estimate worth having.
const ENOUGH_SHARE: f64 = 1.0 / 16.0;
/// Counting cells at the most: spray fills one each.
const MOST_CELLS: usize = 1 << 24;
/// The number of particles that tell enough in one placement of the counting grid.
/// With fewer, several placements are averaged. Of more, an even share is looked at.
const MANY: usize = 1 << 18;

/// How far apart particles are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spacings {
    /// The one that holds for all, or would if they were even.
    pub mean: f64,
    /// Where they are plainly of two resolutions: the spacing of most, and that of the others.
    pub two: Option<[f64; 2]>,
}

/// Estimates the spacing; `None` where there is no inside, as in a few particles or mere spray.
#[must_use]
pub fn estimate(particles: &(impl Particles + ?Sized)) -> Option<f64> {
    spacings(particles).map(|spacings| spacings.mean)
}

/// Estimates the spacing as [`estimate`] does, and tells two resolutions apart.
#[must_use]
pub fn spacings(particles: &(impl Particles + ?Sized)) -> Option<Spacings> {
    let Some(part) = Part::of(particles.len()) else { return estimate_of_all(particles) };
    finite_chunks(particles).for_each(|positions| part.look(&positions));
    part.spacings(particles)
}

/// An even share of many particles, which tells enough of all, whatever their order.
pub struct Part {
    one_in: u64,
    finite: AtomicUsize,
    positions: Mutex<Vec<[f64; 3]>>,
}

impl Part {
    /// Creates the part of so many particles, none of which was looked at yet; `None` where they are so few that all are needed.
    #[must_use]
    pub fn of(particles: usize) -> Option<Self> {
        let one_in = (particles / MANY).next_power_of_two() as u64;
        (particles > MANY).then(|| Self { one_in, finite: AtomicUsize::new(0), positions: Mutex::default() })
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

    /// Estimates the spacings of the particles, each of which was looked at once.
    #[must_use]
    pub fn spacings(self, particles: &(impl Particles + ?Sized)) -> Option<Spacings> {
        let (share, part) = self.taken();
        // A layer may be too thin to have an inside that so few can tell.
        let of_part = estimate_where(&part[..], ENOUGH_SHARE).map(|Spacings { mean, two }| Spacings {
            mean: mean * share.cbrt(),
            two: two.map(|two| two.map(|spacing| spacing * share.cbrt())),
        });
        of_part.or_else(|| estimate_of_all(particles))
    }

    /// How large a share of all was taken, and its particles.
    fn taken(self) -> (f64, Vec<[f64; 3]>) {
        let part = self.positions.into_inner().unwrap_or_else(PoisonError::into_inner);
        (part.len() as f64 / self.finite.into_inner() as f64, part)
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
fn scattered(position: [f64; 3]) -> u64 {
    position.iter().fold(0, |state, c| {
        let mixed = (state ^ c.to_bits()).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let mixed = (mixed ^ (mixed >> 32)).wrapping_mul(0xd6e8_feb8_6659_fd93);
        mixed ^ (mixed >> 32)
    })
}

/// Estimates the spacings by all particles.
fn estimate_of_all(particles: &(impl Particles + ?Sized)) -> Option<Spacings> {
    estimate_where(particles, 0.0)
}

/// Estimates the spacings, where interior cells hold at least `enough_share` of the particles.
fn estimate_where(particles: &(impl Particles + ?Sized), enough_share: f64) -> Option<Spacings> {
    let Bounds { lo, hi, finite } = bounds(particles)?;
    let extent = hi - lo;
    let volume: f64 = extent.to_array().iter().map(|e| e.max(1e-3 * extent.max_element())).product();
    let mut cell = (TARGETS[0] * volume / finite as f64).cbrt();
    if !(cell.is_finite() && cell > 0.0) {
        return None;
    }
    TARGETS.iter().find_map(|&target| {
        cell = cell_for(particles, target, cell, lo)?;
        let placements = (MANY / particles.len().max(1)).clamp(1, 8) as u32;
        // Shifts by multiples of the golden ratio's powers spread evenly.
        let shifts = (0..placements).map(|i| {
            let i = f64::from(i);
            DVec3::new(i * 0.819_172_513, i * 0.671_043_606, i * 0.549_700_478).fract()
        });
        let mut inside = Vec::new();
        for shift in shifts {
            inside.extend(interior(&counts(particles, lo - shift * cell, cell)?));
        }
        let (total, cells) = (inside.iter().sum::<usize>(), inside.len());
        let enough = cells >= ENOUGH_CELLS * placements as usize
            && total as f64 >= enough_share * f64::from(placements) * finite as f64;
        enough.then(|| {
            // Coarse particles have their inside in wider cells.
            let wider = || two_of(interior(&counts(particles, lo, WIDER * cell)?), WIDER * cell);
            Spacings {
                mean: cell * (cells as f64 / total as f64).cbrt(),
                two: two_of(inside, cell).or_else(wider),
            }
        })
    })
}

/// The counts of interior cells.
fn interior(counts: &Counts) -> Vec<usize> {
    counts.iter().filter(|(coord, _)| surrounded(counts, **coord)).map(|(_, &count)| count).collect()
}

/// Cells that coarse particles are looked for in, over those of the estimate.
const WIDER: f64 = 2.0;
/// A share of the fluid's volume, or of its particles, that is a part of its own.
const PART: f64 = 0.05;
/// Particles in the cells of such a part, at the least: of fewer, spray cannot be told.
const ENOUGH_IN_CELL: usize = 4;
/// The share of such a part's cells whose counts are like each other.
const EVEN: f64 = 0.8;

/// The spacings of two resolutions, by the counts of interior cells of edge `cell`: there are two kinds of cells, each with
/// counts of its own, and fewer cells between them. A fluid that thins out into spray has cells of every count.
fn two_of(mut counts: Vec<usize>, cell: f64) -> Option<[f64; 2]> {
    counts.sort_unstable();
    let total: usize = counts.iter().sum();
    let mut below = 0;
    // Where most particles are.
    let most = *counts.iter().find(|&&count| {
        below += count;
        2 * below >= total
    })?;
    // Cells, and particles in them, with counts in a range of multiples of that.
    let of = |from: f64, to: f64| {
        let [from, to] =
            [from, to].map(|bound| counts.partition_point(|&count| (count as f64) < bound * most as f64));
        &counts[from..to]
    };
    let cells = |part: &[usize]| part.len() as f64;
    let particles = |part: &[usize]| part.iter().sum::<usize>() as f64;
    let is_even = |part: &[usize]| {
        let median = part[part.len() / 2];
        let near = part.iter().filter(|&&count| count <= 2 * median && median <= 2 * count);
        median >= ENOUGH_IN_CELL && near.count() as f64 > EVEN * cells(part)
    };
    let (thin, thinner) = (of(0.25, 0.5), of(0.0, 0.25));
    let (dense, denser) = (of(2.0, 4.0), of(4.0, f64::INFINITY));
    let other = if cells(thinner) >= PART * cells(&counts) && cells(thinner) > 2.0 * cells(thin) {
        thinner
    } else if particles(denser) >= PART * total as f64 && particles(denser) > 2.0 * particles(dense) {
        denser
    } else {
        return None;
    };
    let spacing = |part: &[usize]| cell * (cells(part) / particles(part)).cbrt();
    is_even(other).then(|| [spacing(of(0.5, 2.0)), spacing(other)])
}

type Counts = HashMap<IVec3, usize>;

/// Counts particles in the cells of edge `cell` that begin at `origin`: the bins of a grid that much finer.
fn counts(particles: &(impl Particles + ?Sized), origin: DVec3, cell: f64) -> Option<Counts> {
    let grid = Grid::new(origin, cell / f64::from(BIN)).ok()?;
    let room = CountingRoom { bins: MOST_CELLS, places: 0 };
    let plan = BinPlan::count(particles, &grid, None, InvalidParticles::Skip, room).ok()?;
    Some(plan.keys().iter().map(|key| key.coord()).zip(plan.counts()).collect())
}

/// A cell size at which the typical particle shares its cell with about `target` others.
fn cell_for(particles: &(impl Particles + ?Sized), target: f64, mut cell: f64, lo: DVec3) -> Option<f64> {
    for _ in 0..12 {
        let counts = counts(particles, lo, cell)?;
        let mut sizes: Vec<usize> = counts.into_values().collect();
        sizes.sort_unstable();
        let binned: usize = sizes.iter().sum();
        let mut below = 0;
        let typical = sizes.into_iter().find(|size| {
            below += size;
            2 * below >= binned
        })?;
        if (0.6..1.6).contains(&(typical as f64 / target)) {
            break;
        }
        cell *= (target / typical as f64).cbrt().clamp(0.1, 10.0);
    }
    Some(cell)
}

fn surrounded(counts: &Counts, cell: IVec3) -> bool {
    (0..27).all(|i| counts.contains_key(&(cell + IVec3::new(i % 3, i / 3 % 3, i / 9) - 1)))
}

#[cfg(test)]
mod tests {
    use hashbrown::HashSet;

    use super::*;

    /// A box of so many layers, a particle of each within a third of a spacing.
    fn layers(counts: [usize; 3]) -> Vec<[f64; 3]> {
        let jitter = |seed: f64| (scattered([seed; 3]) % 1024) as f64 / 1536.0;
        let [x, y, z] = counts;
        (0..x * y * z)
            .map(|i| {
                let place = [i % x, i / x % y, i / (x * y)];
                [0, 1, 2].map(|axis| place[axis] as f64 + jitter((3 * i + axis) as f64 + 0.5))
            })
            .collect()
    }

    fn part_of(particles: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let part = Part::of(particles.len()).unwrap();
        particles.chunks(1000).for_each(|positions| part.look(positions));
        part.taken().1
    }

    #[test]
    fn of_many_particles_a_part_tells_the_same_whatever_their_order() {
        let mut particles = layers([120; 3]);
        let all = estimate_of_all(&particles[..]).unwrap().mean;
        let part = estimate(&particles[..]).unwrap();
        assert!((all - 1.0).abs() < 0.01 && (part - 1.0).abs() < 0.01, "{all} {part}");
        assert_ne!(all, part, "all were looked at");
        particles.reverse();
        particles.push([f64::NAN; 3]);
        assert_eq!(estimate(&particles[..]), Some(part));
    }

    #[test]
    fn a_part_of_a_lattice_is_as_good_as_random_whatever_its_spacing() {
        for spacing in [1.0, 1.0 / 64.0, 0.02] {
            let side = 110;
            let of = |i: usize| [i % side, i / side % side, i / (side * side)].map(|c| c as f64 * spacing);
            let particles: Vec<[f64; 3]> = (0..side * side * side).map(of).collect();
            let part = part_of(&particles);
            for axis in 0..3 {
                let column = |p: &[f64; 3]| [p[(axis + 1) % 3], p[(axis + 2) % 3]].map(f64::to_bits);
                let columns: HashSet<[u64; 2]> = part.iter().map(column).collect();
                assert!(100 * columns.len() > 99 * side * side, "{} columns along {axis}", columns.len());
            }
            let estimated = estimate(&particles[..]).unwrap();
            assert!((estimated / spacing - 1.0).abs() < 0.005, "{estimated} of {spacing}");
        }
    }

    #[test]
    fn a_layer_that_is_too_thin_for_a_part_of_its_particles_is_told_by_all() {
        let particles = layers([500, 500, 10]);
        assert_eq!(estimate_where(&part_of(&particles)[..], ENOUGH_SHARE), None);
        let spacing = estimate(&particles[..]).unwrap();
        assert!((spacing - 1.0).abs() < 0.05, "{spacing}");
    }
}

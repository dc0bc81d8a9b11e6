//! The particles' spacing, estimated from their number density deep in the fluid.
//!
//! Spacing is the edge of the cube that a particle fills: (volume / number)^(1/3). Counting in cells a few
//! spacings wide, and only in those whose 26 neighbours hold particles too, leaves surfaces out of it.

use glam::{DVec3, IVec3};
use hashbrown::HashMap;
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
/// So many particles tell enough in one placement of the counting grid; with fewer, several are averaged. Of more, an
/// even share is looked at.
const MANY: usize = 1 << 18;

/// Estimates the spacing; `None` where there is no inside, as in a few particles or mere spray.
#[must_use]
pub fn estimate(particles: &(impl Particles + ?Sized)) -> Option<f64> {
    if particles.len() <= MANY {
        return estimate_of_all(particles);
    }
    let (share, part) = part_of(particles);
    // A layer may be too thin to have an inside that so few can tell.
    estimate_where(&part[..], ENOUGH_SHARE)
        .map(|spacing| spacing * share.cbrt())
        .or_else(|| estimate_of_all(particles))
}

/// About [`MANY`] of the particles, whatever their order, and how large a share of all they are.
fn part_of(particles: &(impl Particles + ?Sized)) -> (f64, Vec<[f64; 3]>) {
    let one_in = (particles.len() / MANY).next_power_of_two() as u64;
    let of_chunk = |positions: Vec<[f64; 3]>| -> (usize, Vec<[f64; 3]>) {
        let part = positions.iter().copied().filter(|&p| scattered(p).is_multiple_of(one_in));
        (positions.len(), part.collect())
    };
    let chunks: Vec<_> = finite_chunks(particles).map(of_chunk).collect();
    let finite: usize = chunks.iter().map(|(finite, _)| finite).sum();
    let part: Vec<[f64; 3]> = chunks.into_iter().flat_map(|(_, part)| part).collect();
    (part.len() as f64 / finite as f64, part)
}

/// A number that is as good as random, and the same wherever a particle stands in its file.
fn scattered(position: [f64; 3]) -> u64 {
    position.iter().fold(0, |state, c| {
        let mixed = (state ^ c.to_bits()).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let mixed = (mixed ^ (mixed >> 32)).wrapping_mul(0xd6e8_feb8_6659_fd93);
        mixed ^ (mixed >> 32)
    })
}

/// The same by all particles.
fn estimate_of_all(particles: &(impl Particles + ?Sized)) -> Option<f64> {
    estimate_where(particles, 0.0)
}

/// The same, where interior cells hold so large a share of the particles.
fn estimate_where(particles: &(impl Particles + ?Sized), enough_share: f64) -> Option<f64> {
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
        let (mut total, mut cells) = (0, 0);
        for shift in shifts {
            let counts = counts(particles, lo - shift * cell, cell)?;
            for (coord, count) in &counts {
                if surrounded(&counts, *coord) {
                    total += count;
                    cells += 1;
                }
            }
        }
        let enough = cells >= ENOUGH_CELLS * placements as usize
            && total as f64 >= enough_share * f64::from(placements) * finite as f64;
        enough.then(|| cell * (cells as f64 / total as f64).cbrt())
    })
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

    #[test]
    fn of_many_particles_a_part_tells_the_same_whatever_their_order() {
        let mut particles = layers([120; 3]);
        let all = estimate_of_all(&particles[..]).unwrap();
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
            let part = part_of(&particles[..]).1;
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
        assert_eq!(estimate_where(&part_of(&particles[..]).1[..], ENOUGH_SHARE), None);
        let spacing = estimate(&particles[..]).unwrap();
        assert!((spacing - 1.0).abs() < 0.05, "{spacing}");
    }
}

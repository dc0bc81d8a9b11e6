//! What the plateau of a fluid would be, told from its spacing alone.

use hashbrown::HashMap;

use crate::grid::FRACTIONS;
use crate::stage::indicator::{Indicator, amount, count_table, symmetry};
use crate::units::{FULL, MeanCount};

/// How often a fluid is made, each time elsewhere on the grid.
const PLACES: u64 = 8;

/// Edge of the fluid that is made, in spacings or in cells, whichever is longer.
const EDGE: f64 = 16.0;

/// The most that it is, in spacings. Of the disorder of so many particles in one cell nothing is left.
const LONGEST: f64 = 24.0;

/// How far a particle is from its place on the lattice along each axis, in spacings, at the most.
const JITTER: f64 = 0.3;

/// The mean DIF of a fluid whose particles are `spacing` cells apart: those of a lattice in some disorder. Smoothing does not
/// change a mean.
///
/// # Panics
/// If the indicator has to know mu0, and does not.
pub fn expected(indicator: Indicator, spacing: f64) -> u16 {
    match indicator {
        Indicator::Cloud { mean } => {
            // Clouds add up, wherever the particles are.
            let theta = f64::from(amount(known(mean))) / (spacing * spacing * spacing);
            theta.round().clamp(1.0, f64::from(FULL)) as u16
        }
        Indicator::Counting { mean } => {
            let table = count_table(known(mean));
            mean_of_cells(spacing, |[n, ..]| table.get(n as usize).copied().unwrap_or(FULL))
        }
        Indicator::Symmetry => mean_of_cells(spacing, symmetry),
    }
}

fn known(mean: Option<MeanCount>) -> MeanCount {
    mean.expect("a plateau is of a DIF, which knows its mu0")
}

/// The mean over cells of what `theta` makes of their number of particles and the sums of their offsets.
fn mean_of_cells(spacing: f64, theta: impl Fn([f64; 4]) -> u16) -> u16 {
    let spacing = spacing.max(1.0 / LONGEST);
    let edge = (EDGE * spacing).max(EDGE.min(LONGEST * spacing)).floor() as i32;
    // One layer of the lattice more, for it begins below the cells.
    let layers = (f64::from(edge) / spacing).ceil() as u64 + 1;
    // Multiples of the golden ratio's powers spread evenly.
    let shift =
        |place: u64| [0.819_172_513, 0.671_043_606, 0.549_700_478].map(|x| (place as f64 * x).fract());
    // Integers add up to the same in any order.
    let sum_at = |place: u64| {
        let shift = shift(place);
        let mut cells: HashMap<[i32; 3], [f64; 4]> = HashMap::new();
        for number in 0..layers.pow(3) {
            let of_lattice = [number % layers, number / layers % layers, number / (layers * layers)];
            let at = [0, 1, 2].map(|axis| {
                let random = unit(3 * (place * layers.pow(3) + number) + axis as u64);
                let jitter = JITTER * (2.0 * random - 1.0);
                (of_lattice[axis] as f64 - 0.5 + shift[axis] + jitter) * spacing
            });
            let cell = at.map(|x| x.floor() as i32);
            if cell.iter().all(|x| (0..edge).contains(x)) {
                let [n, sums @ ..] = cells.entry(cell).or_default();
                *n += 1.0;
                for (axis, sum) in sums.iter_mut().enumerate() {
                    *sum += ((at[axis] - f64::from(cell[axis])) * f64::from(FRACTIONS)).floor();
                }
            }
        }
        cells.into_values().map(|sums| u64::from(theta(sums))).sum::<u64>()
    };
    let cells = PLACES as f64 * f64::from(edge * edge * edge);
    let sum: u64 = (0..PLACES).map(sum_at).sum();
    ((sum as f64 / cells).round() as u16).max(1)
}

/// Numbers from 0 to 1, 1 excluded, as good as random, the same on every machine.
fn unit(number: u64) -> f64 {
    let mixed = (number + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((mixed ^ (mixed >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn share(indicator: Indicator, spacing: f64) -> f64 {
        f64::from(expected(indicator, spacing)) / f64::from(FULL)
    }

    #[test]
    fn in_fine_cells_a_plateau_is_what_a_particle_makes_times_how_many_there_are_in_a_cell() {
        let mean = MeanCount::new(1.25).ok();
        for spacing in [3.0, 4.0, 7.5] {
            let a_cell = f64::powi(spacing, -3);
            let near = |indicator, each: f64, within: f64| {
                let ratio = share(indicator, spacing) / (each * a_cell);
                assert!((ratio - 1.0).abs() < within, "{indicator:?} at {spacing}: {ratio}");
            };
            // As many as fit into 2 mu0, of mu0, and of a centroid that may be anywhere in the cell.
            near(Indicator::Cloud { mean }, 0.4, 0.01);
            near(Indicator::Counting { mean }, 0.8, 0.02);
            near(Indicator::Symmetry, 0.4454, 0.05);
        }
    }

    #[test]
    fn in_coarse_cells_it_is_that_of_many_particles() {
        let mean = MeanCount::new(64.0).ok();
        assert!((share(Indicator::Cloud { mean }, 0.25) - 0.5).abs() < 0.001);
        assert!((0.93..1.0).contains(&share(Indicator::Counting { mean }, 0.25)));
        assert!((0.85..1.0).contains(&share(Indicator::Symmetry, 0.25)));
        assert_eq!(expected(Indicator::Cloud { mean: MeanCount::new(1.0).ok() }, 0.01), FULL);
        assert_eq!(expected(Indicator::Counting { mean: MeanCount::new(1.0).ok() }, 0.01), FULL);
    }
}

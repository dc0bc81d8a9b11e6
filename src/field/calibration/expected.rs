//! The plateau that a fluid of a given spacing would have.

use hashbrown::HashMap;
use rayon::prelude::*;

use crate::brick::DifField;
use crate::field::indicator::{Amount, Indicator, count_table, symmetry};
use crate::grid::FRACTIONS;
use crate::grid::units::FULL;

/// How often a fluid is made, each time elsewhere on the grid.
const PLACES: u64 = 8;

/// Edge of the fluid that is made, in spacings or in cells, whichever is longer.
const EDGE: f64 = 16.0;

/// The maximum, in spacings. With this many particles in a cell, no disorder is left.
const LONGEST: f64 = 24.0;

/// Cells of a spacing in which no cell holds two particles: finer ones hold as much less as they
/// are smaller.
const FINEST: f64 = 64.0;

/// How far a particle is from its place on the lattice along each axis, in spacings, at the most.
const JITTER: f64 = 0.3;

/// Full cells that tell of a frame's disorder, and not of a few particles.
const TELLING: u64 = 1000;

/// Particles of a cell that count for its disorder, in usual ones: beyond, they are a clump.
const MOST: f64 = 4.0;

/// The mean DIF of a fluid whose particles are `spacing` cells apart: those of a lattice in some
/// disorder. Smoothing does not change a mean. As in a field, 65535 is 1. Counts also tell of the
/// disorder that there is in a frame, from its DIF.
pub fn expected(indicator: Indicator, spacing: f64, dif: Option<&DifField>) -> f64 {
    match indicator {
        Indicator::Counting(mean) => {
            let table = count_table(mean);
            let theta = |[n, ..]: [f64; 4]| table.get(n as usize).copied().unwrap_or(FULL);
            let fluid = FluidSums::of(spacing, theta);
            // In more disorder particles fill fewer cells, each with more of them.
            fluid.theta() / dif.map_or(1.0, |dif| crowding(dif, fluid.mean_count()))
        }
        Indicator::Symmetry => FluidSums::of(spacing, symmetry).theta(),
        Indicator::Cloud => {
            let amount = f64::from(Amount::of_spacing(spacing).steps());
            amount / (spacing * spacing * spacing)
        }
    }
}

/// Sums over the cells of a synthetic fluid.
#[derive(Default)]
struct FluidSums {
    cells: f64,
    full_cells: f64,
    particles: f64,
    /// Sum of theta over all cells.
    sum: u64,
    /// How many times as many particles its cells hold as those that were asked for.
    denser: f64,
}

impl FluidSums {
    /// With what `theta` makes of the number of particles in a cell and of the sums of their
    /// offsets.
    fn of(spacing: f64, theta: impl Fn([f64; 4]) -> u16) -> Self {
        let denser = (spacing / FINEST).powi(3).max(1.0);
        let spacing = spacing.clamp(1.0 / LONGEST, FINEST);
        let edge = (EDGE * spacing).max(EDGE.min(LONGEST * spacing)).floor().max(1.0) as i32;
        // One layer of the lattice more, for it begins below the cells.
        let layers = (f64::from(edge) / spacing).ceil() as u64 + 1;
        let mut fluid = Self { denser, ..Self::default() };
        for place in 0..PLACES {
            // Multiples of the golden ratio's powers spread evenly.
            let shift =
                [0.819_172_513, 0.671_043_606, 0.549_700_478].map(|x| (place as f64 * x).fract());
            let mut cells: HashMap<[i32; 3], [f64; 4]> = HashMap::new();
            for number in 0..layers.pow(3) {
                let of_lattice =
                    [number % layers, number / layers % layers, number / (layers * layers)];
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
            fluid.cells += f64::from(edge) * f64::from(edge) * f64::from(edge);
            fluid.full_cells += cells.len() as f64;
            // Integers add up to the same in any order.
            fluid.particles += cells.values().map(|[n, ..]| n).sum::<f64>();
            fluid.sum += cells.into_values().map(|sums| u64::from(theta(sums))).sum::<u64>();
        }
        fluid
    }

    /// mu0.
    fn mean_count(&self) -> f64 {
        self.particles / self.full_cells
    }

    /// The mean of theta.
    fn theta(&self) -> f64 {
        self.sum as f64 / self.cells / self.denser
    }
}

/// How many times as many particles the full cells of counts hold as is `usual`, if that is more.
fn crowding(dif: &DifField, usual: f64) -> f64 {
    let full_cells = dif.full_cells();
    if full_cells < TELLING {
        return 1.0;
    }
    let most = (MOST * usual).ceil() as u16;
    let of_page =
        |page: usize| dif.stored(page).iter().map(|&n| u64::from(n.min(most))).sum::<u64>();
    let particles: u64 = (0..dif.infos().len()).into_par_iter().map(of_page).sum();
    (particles as f64 / full_cells as f64 / usual).max(1.0)
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
    use crate::grid::units::MeanCount;

    fn share(indicator: Indicator, spacing: f64) -> f64 {
        expected(indicator, spacing, None) / f64::from(FULL)
    }

    #[test]
    fn in_fine_cells_a_plateau_is_what_a_particle_makes_times_how_many_there_are_in_a_cell() {
        let mean = MeanCount::new(1.25).unwrap();
        for spacing in [3.0, 4.0, 7.5] {
            let a_cell = f64::powi(spacing, -3);
            let near = |indicator, each: f64, within: f64| {
                let ratio = share(indicator, spacing) / (each * a_cell);
                assert!((ratio - 1.0).abs() < within, "{indicator:?} at {spacing}: {ratio}");
            };
            // As many as fit into mu0, and of a centroid that may be anywhere in the cell.
            near(Indicator::Counting(mean), 0.8, 0.02);
            near(Indicator::Symmetry, 0.4454, 0.05);
        }
    }

    #[test]
    fn in_coarse_cells_it_is_that_of_many_particles() {
        let mean = MeanCount::new(64.0).unwrap();
        assert!((0.93..1.0).contains(&share(Indicator::Counting(mean), 0.25)));
        assert!((0.85..1.0).contains(&share(Indicator::Symmetry, 0.25)));
        let one = MeanCount::new(1.0).unwrap();
        assert_eq!(expected(Indicator::Counting(one), 0.01, None), f64::from(FULL));
    }
}

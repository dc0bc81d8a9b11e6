//! The plateau that a fluid of a given spacing would have.

use hashbrown::HashMap;
use rayon::prelude::*;

use crate::brick::DifField;
use crate::field::indicator::{Amount, Indicator, count_table, symmetry};
use crate::grid::FRACTIONS;
use crate::grid::units::FULL;

/// Number of synthetic fluids, each at a different position on the grid.
const PLACES: u64 = 8;

/// The edge of a synthetic fluid is the longer of `EDGE` spacings and `EDGE` cells, but at most
/// [`MOST_PARTICLES_PER_EDGE`] spacings.
const EDGE: f64 = 16.0;

/// A synthetic fluid has at most this many particles along the edge of a cell. At this number,
/// disorder does not change the sample of a cell.
const MOST_PARTICLES_PER_EDGE: f64 = 24.0;

/// Maximum number of cells per spacing in a synthetic fluid. At this number no cell holds two
/// particles, so in finer cells the mean of theta is proportional to the cell's volume.
const FINEST: f64 = 64.0;

/// The maximum distance, in spacings, of a particle from its lattice position along each axis.
const JITTER: f64 = 0.3;

/// The minimum number of full cells for an estimate of a frame's disorder. With fewer cells, the
/// estimate would depend on a few particles.
const LEAST_FULL_CELLS: u64 = 1000;

/// The maximum number of particles of a cell that the estimate of disorder counts, as a multiple of
/// the usual mean number in full cells. The estimate ignores further particles of the cell, because
/// they are a clump.
const MOST_TIMES_USUAL: f64 = 4.0;

/// The mean DIF of a fluid whose particles are `spacing` cells apart, on a disordered lattice.
/// Smoothing does not change this mean. The result is a sample: 65535 means 1. For the counting
/// indicator, the result also depends on the frame's disorder, which is estimated from `dif`.
pub fn expected(indicator: Indicator, spacing: f64, dif: Option<&DifField>) -> f64 {
    match indicator {
        Indicator::Counting(mean) => {
            let table = count_table(mean);
            let theta = |[n, ..]: [f64; 4]| table.get(n as usize).copied().unwrap_or(FULL);
            let fluid = FluidSums::of(spacing, theta);
            // With more disorder, fewer cells are full, and each full cell contains more particles.
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
    /// The ratio of the fluid's density to the requested density.
    denser: f64,
}

impl FluidSums {
    /// Computes the sums of a fluid. `theta` computes theta from the number of particles in a cell
    /// and the sums of their offsets.
    fn of(spacing: f64, theta: impl Fn([f64; 4]) -> u16) -> Self {
        let denser = (spacing / FINEST).powi(3).max(1.0);
        let spacing = spacing.clamp(1.0 / MOST_PARTICLES_PER_EDGE, FINEST);
        let edge =
            (EDGE * spacing).max(EDGE.min(MOST_PARTICLES_PER_EDGE * spacing)).floor().max(1.0)
                as i32;
        // There is one additional layer, because the lattice begins below the cells.
        let layers = (f64::from(edge) / spacing).ceil() as u64 + 1;
        let mut fluid = Self { denser, ..Self::default() };
        for place in 0..PLACES {
            // The fractional parts of multiples of these numbers are evenly spread. The numbers are
            // the inverse powers of the golden ratio, generalised to three axes.
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
            // These sums are integers in f64, so their order does not matter.
            fluid.particles += cells.values().map(|[n, ..]| n).sum::<f64>();
            fluid.sum += cells.into_values().map(|sums| u64::from(theta(sums))).sum::<u64>();
        }
        fluid
    }

    /// mu0, the mean number of particles in a full cell.
    fn mean_count(&self) -> f64 {
        self.particles / self.full_cells
    }

    /// The mean of theta.
    fn theta(&self) -> f64 {
        self.sum as f64 / self.cells / self.denser
    }
}

/// The mean number of particles per full cell of `dif`, divided by `usual`; at least 1.
fn crowding(dif: &DifField, usual: f64) -> f64 {
    let full_cells = dif.full_cells();
    if full_cells < LEAST_FULL_CELLS {
        return 1.0;
    }
    let most = (MOST_TIMES_USUAL * usual).ceil() as u16;
    let of_page =
        |page: usize| dif.stored(page).iter().map(|&n| u64::from(n.min(most))).sum::<u64>();
    let particles: u64 = (0..dif.infos().len()).into_par_iter().map(of_page).sum();
    (particles as f64 / full_cells as f64 / usual).max(1.0)
}

/// A pseudo-random number in 0..1, the same on every machine.
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
    fn the_plateau_in_fine_cells_is_theta_times_particles_per_cell() {
        let mean = MeanCount::new(1.25).unwrap();
        for spacing in [3.0, 4.0, 7.5] {
            let per_cell = f64::powi(spacing, -3);
            let near = |indicator, each: f64, within: f64| {
                let ratio = share(indicator, spacing) / (each * per_cell);
                assert!((ratio - 1.0).abs() < within, "{indicator:?} at {spacing}: {ratio}");
            };
            // The second argument is theta of a cell with one particle: 1 / mu0 for counting, and
            // the mean over all positions in the cell for symmetry.
            near(Indicator::Counting(mean), 0.8, 0.02);
            near(Indicator::Symmetry, 0.4454, 0.05);
        }
    }

    #[test]
    fn the_plateau_in_coarse_cells_approaches_that_of_many_particles() {
        let mean = MeanCount::new(64.0).unwrap();
        assert!((0.93..1.0).contains(&share(Indicator::Counting(mean), 0.25)));
        assert!((0.85..1.0).contains(&share(Indicator::Symmetry, 0.25)));
        let one = MeanCount::new(1.0).unwrap();
        assert_eq!(expected(Indicator::Counting(one), 0.01, None), f64::from(FULL));
    }
}

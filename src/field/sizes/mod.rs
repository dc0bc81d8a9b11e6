//! Particles of several sizes: their clouds in octaves of the spacing, and one field for all.
//!
//! The size s of a particle is the edge of the cube that it fills: its own spacing. Octave k holds
//! the particles of sizes from 2^k d to 2^(k + 1) d, where d is the smallest size. Each octave has
//! its own grid, whose cells are 2^k times as wide as those of the mesh. The spacing of the octave,
//! 2^k d, grows by the same factor, so the ratio of cell to spacing is the same in all octaves.
//!
//! 1. Clouds. In its octave, a particle's cloud is weighted by the particle's volume: its amount is
//!    (s / (2^k d))^3 times half the usual [`Amount`]. The density of an octave is the sum over all
//!    particles: finer clouds are merged into wider cells, and quadratic B-splines interpolate
//!    coarser clouds.
//! 2. Field. Each octave turns its density into [distances](super::distance), in its own spacings
//!    and with the filters for particles of a single size.
//! 3. Mixed. A particle's size lies between two octaves, at log2(s / d). Under a Gaussian of 1.5
//!    spacings of octave k, f_k is the volume-weighted mean of log2(s / d) - k, limited to the
//!    range from 0 to 1. With B_k the surface of the bulk in octave k, R_k = (1 - f_k) B_k + f_k
//!    R_(k + 1). In fluid of size 2^k d, R_k is B_k. The bulk's surface is R_0.
//! 4. Drops. In each octave, particles that lie outside R_k add their drops and sheets. The radius
//!    of drops grows with the mean logarithm of the sizes of the octave's nearby particles.
//! 5. Cells. Blocks that have no particles of octaves below k nearby consist of the cells of octave
//!    k. The surface of the bulk in these blocks is R_k. See `levels`.
//!
//! No sample depends on the box of cells in which it is computed. Where a share is 0, the field
//! that it multiplies is not computed; this does not change any sample.

mod clouds;
mod levels;
mod mix;
mod sampled;

pub use clouds::{Layer, LayerPages, SizedClouds};
pub use levels::{BlockLevels, FinerBlocks};
pub use mix::{OctaveDrops, WHOLE, finer_spacings, in_finer_spacings, mixed, share};
pub use sampled::SampledOctaves;

use crate::brick::BrickSide;
use crate::field::blur::Weights;
use crate::field::distance::{UNITS, gaussian};
use crate::field::indicator::{Amount, IndicatorKind, WideCells};
use crate::grid::MOST_LEVELS;

/// The maximum number of octaves, which limits sizes to 64 times the smallest size.
pub const MOST_OCTAVES: usize = MOST_LEVELS;

/// The width of the Gaussian that averages sizes, in spacings of the octave.
const AVERAGING_WIDTH: f64 = 1.5;
/// The cut-off of the Gaussian that averages sizes, in standard deviations.
const AVERAGING_CUT: f64 = 2.6;
/// The gain of the filter that averages sizes, in bits.
const AVERAGING_GAIN: u32 = 2;

/// The growth of a drop's nominal radius from a size to twice that size, in spacings of the octave,
/// is the first number plus the second number divided by the squared spacing in cells. This growth
/// gives each drop about the volume of its particle.
const GROWTH: [f64; 2] = [0.65, 0.3];

/// The growth of the radius of drops within an octave, in units of distance.
#[must_use]
pub fn growth(spacing_cells: f64) -> i32 {
    let [fine, coarse] = GROWTH;
    let units = (fine + coarse / (spacing_cells * spacing_cells)) * UNITS;
    // The limit applies only to cells of more than 300 spacings, in which every drop is smaller
    // than a cell anyway.
    units.round().min(f64::from(1 << 28)) as i32
}

/// The filter that averages sizes, in wide cells of an octave.
#[must_use]
pub fn averaging(wide: WideCells) -> Weights {
    gaussian(AVERAGING_WIDTH / wide.edge, 0.5, AVERAGING_CUT).0.gaining(AVERAGING_GAIN)
}

/// The brick size for the clouds of particles of several sizes.
pub const SIDE: BrickSide = BrickSide::Sixteen;

/// The octaves of a frame, from which the amount of each particle's cloud follows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Octaves {
    /// The smallest size.
    pub finest: f64,
    /// The number of octaves.
    pub count: usize,
    /// The amount of a particle of the smallest size of its octave.
    amount: f64,
}

/// The octave and the amounts of a particle's cloud.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CloudShare {
    /// The octave.
    pub octave: usize,
    /// The amount of the cloud.
    pub amount: u32,
    /// The amount times the logarithm of the size in its octave. The logarithm is binary, and from
    /// 0 to 1.
    pub fraction: u32,
}

impl Octaves {
    /// Makes the octaves for sizes from `finest` to `coarsest`. `cell` is the edge of the finest
    /// cells.
    #[must_use]
    pub fn new(finest: f64, coarsest: f64, cell: f64) -> Self {
        let mut count = 1;
        // The surface around a particle is mixed from the octave that begins at or below the
        // particle's size and the next octave. The last octave must therefore begin at the largest
        // size or above it. The factor absorbs rounding errors.
        let most = coarsest / finest * (1.0 - 1e-6);
        while count < MOST_OCTAVES && most > f64::from(1_u32 << (count - 1)) {
            count += 1;
        }
        let amount = f64::from(Amount::of_spacing(finest / cell).steps()) / 2.0;
        Self { finest, count, amount }
    }

    /// The share of a particle of size `size`. A size outside the octaves counts as the nearest
    /// size inside them, but particles below the smallest size keep their volume.
    #[must_use]
    pub fn share(&self, size: f64) -> CloudShare {
        // Without this factor, rounding errors could move a size that is a power of two times the
        // finest size into the octave below.
        let mut ratio = (size / self.finest * (1.0 + 1e-6)).max(1.0);
        let mut octave = 0;
        while octave + 1 < self.count && ratio >= 2.0 {
            ratio /= 2.0;
            octave += 1;
        }
        let ratio = ratio.min(2.0);
        // Particles below the finest size keep their volume.
        let volume = (size / self.finest).min(1.0);
        let volume = volume * volume * volume * ratio * ratio * ratio;
        // The conversion to an integer rounds down, so adding 0.5 rounds to the nearest integer.
        // This is faster than a call of `round`.
        let rounded = |x: f64| (x + 0.5) as u32;
        let amount = rounded(self.amount * volume).max(1);
        let fraction = if octave + 1 < self.count { log2(ratio) } else { 0.0 };
        // A size slightly above a power of two counts as that power.
        let fraction = if fraction < 0.01 { 0.0 } else { fraction };
        CloudShare { octave, amount, fraction: rounded(f64::from(amount) * fraction) }
    }

    /// The kind of the samples.
    pub const INDICATOR: IndicatorKind = IndicatorKind::Cloud;
}

/// The logarithm to base 2 of a number from 1 to 2, the same on every machine.
fn log2(x: f64) -> f64 {
    let t = (x - 1.0) / (x + 1.0);
    let square = t * t;
    let series = 1.0 + square * (1.0 / 3.0 + square * (0.2 + square * (1.0 / 7.0 + square / 9.0)));
    (2.0 / std::f64::consts::LN_2 * t * series).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_size_contributes_its_volume_to_its_octave() {
        let octaves = Octaves::new(1.0, 8.0, 0.5);
        assert_eq!(octaves.count, 4);
        let one = octaves.share(1.0).amount;
        for (size, octave, volume, fraction) in
            [(1.0, 0, 1.0, 0.0), (1.5, 0, 3.375, 0.585), (2.0, 1, 1.0, 0.0), (3.0, 1, 3.375, 0.585)]
        {
            let share = octaves.share(size);
            assert_eq!(share.octave, octave, "{size}");
            assert!((f64::from(share.amount) / f64::from(one) / volume - 1.0).abs() < 1e-3);
            let found = f64::from(share.fraction) / f64::from(share.amount);
            assert!((found - fraction).abs() < 1e-3, "{size}: {found}");
        }
        assert_eq!(octaves.share(8.0).octave, 3);
        assert_eq!(octaves.share(0.5).amount, one.div_ceil(8), "a smaller size has its own volume");
        assert_eq!(octaves.share(f64::from(0.1_f32) * 20.0), octaves.share(2.0));
    }

    #[test]
    fn logarithms_are_exact_to_the_precision_of_an_amount() {
        for step in 0..=100 {
            let x = 1.0 + f64::from(step) / 100.0;
            assert!((log2(x) - x.log2()).abs() < 1e-5, "{x}");
        }
    }
}

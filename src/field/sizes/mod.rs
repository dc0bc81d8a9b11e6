//! Particles of several sizes: their clouds in octaves of the spacing, and one field of all.
//!
//! The size s of a particle is the edge of the cube that it fills: its own spacing. Octave k holds
//! the particles of sizes from 2^k d up to twice that, where d is the smallest size. It has a grid
//! of its own, whose cells are 2^k times as wide as those of the mesh, so that a cell has the same
//! edge in spacings of each octave.
//!
//! 1. Clouds. In its octave, a particle's cloud holds its volume: (s / 2^k d)^3 times half the
//!    usual [`Amount`]. The density of an octave is the sum over all particles: finer clouds are
//!    joined into wider cells, and coarser ones become cells by quadratic B-splines.
//! 2. Field. Each octave turns that density into [distances](super::distance), with the filters of
//!    one size, in its own spacings.
//! 3. Mixed. A particle's size lies between two octaves, at log2(s / d). Under a Gaussian of 1.5
//!    spacings of octave k, f_k is the volume-weighted mean of log2(s / d) - k, but at least 0 and
//!    at most 1. With B_k the surface of the bulk in octave k, R_k = (1 - f_k) B_k + f_k R_(k + 1):
//!    in fluid of size 2^k d this is B_k. The bulk's surface is R_0.
//! 4. Drops. In each octave, particles that lie outside of R_k add their drops, and sheets. Their
//!    radius grows with the mean logarithm of the sizes of the octave's particles near by.
//!
//! No sample depends on the box of cells that it is made in: where a share is 0, what it would be
//! multiplied with is left out.

mod clouds;
mod mix;

pub use clouds::{Layer, LayerPages, SizedClouds};
pub use mix::{OctaveDrops, finer_spacings, mixed, share};

use crate::brick::BrickSide;
use crate::field::blur::Weights;
use crate::field::distance::{UNITS, gaussian};
use crate::field::indicator::{Amount, IndicatorKind, WideCells};

/// The number of octaves at most: sizes differ by a factor of up to 64 from the smallest.
pub const MOST_OCTAVES: usize = 7;

/// The width under which sizes are averaged, in spacings of the octave.
const MIXED: f64 = 1.5;
/// Where its Gaussian is cut off, in standard deviations.
const MIXED_CUT: f64 = 2.6;
/// Bits that densities gain under it.
const MIXED_GAIN: u32 = 2;

/// By how much the nominal radius of a drop grows from a size to twice that, in spacings of the
/// octave, and over the squared spacing in cells: by what makes a drop of each size hold about its
/// particle's volume.
const GROWTH: [f64; 2] = [0.65, 0.3];

/// By how much the radius of drops grows within an octave, in units of distance.
#[must_use]
pub fn growth(spacing_cells: f64) -> i32 {
    let [fine, coarse] = GROWTH;
    ((fine + coarse / (spacing_cells * spacing_cells)) * UNITS).round() as i32
}

/// The filter under which sizes are averaged, in wide cells of an octave.
#[must_use]
pub fn averaging(wide: WideCells) -> Weights {
    gaussian(MIXED / wide.edge, 0.5, MIXED_CUT).0.gaining(MIXED_GAIN)
}

/// The bricks that clouds of sizes are stored in.
pub const SIDE: BrickSide = BrickSide::Sixteen;

/// The amounts of clouds by the sizes of their particles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Octaves {
    /// The smallest size.
    pub finest: f64,
    /// The number of octaves.
    pub count: usize,
    /// The amount of a particle of the smallest size of its octave.
    amount: f64,
}

/// Where a particle's cloud goes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CloudShare {
    /// The octave.
    pub octave: usize,
    /// The amount of the cloud.
    pub amount: u32,
    /// The amount times the logarithm of the size in its octave, from 0 to 1.
    pub fraction: u32,
}

impl Octaves {
    /// Octaves from the size `finest` on, up to that of `coarsest`, with cells of edge `cell`.
    #[must_use]
    pub fn new(finest: f64, coarsest: f64, cell: f64) -> Self {
        let mut count = 1;
        // The largest lies between two octaves, but for rounding.
        let most = coarsest / finest * (1.0 - 1e-6);
        while count < MOST_OCTAVES && most > f64::from(1_u32 << (count - 1)) {
            count += 1;
        }
        let amount = f64::from(Amount::of_spacing(finest / cell).steps()) / 2.0;
        Self { finest, count, amount }
    }

    /// Where a particle of size `size` goes; sizes beyond the octaves count as the nearest within.
    #[must_use]
    pub fn share(&self, size: f64) -> CloudShare {
        // 1e-6: f32 sizes of a power of two belong to their own octave, whatever the rounding.
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
        let amount = (self.amount * volume).round().max(1.0);
        let fraction = if octave + 1 < self.count { log2(ratio) } else { 0.0 };
        // Sizes of next to a power of two are one.
        let fraction = if fraction < 0.01 { 0.0 } else { fraction };
        CloudShare { octave, amount: amount as u32, fraction: (amount * fraction).round() as u32 }
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
    fn each_size_has_its_volume_in_its_octave() {
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
        assert_eq!(octaves.share(0.5).amount, one.div_ceil(8), "smaller ones keep their volume");
        assert_eq!(octaves.share(f64::from(0.1_f32) * 20.0), octaves.share(2.0));
    }

    #[test]
    fn logarithms_are_exact_to_what_an_amount_can_show() {
        for step in 0..=100 {
            let x = 1.0 + f64::from(step) / 100.0;
            assert!((log2(x) - x.log2()).abs() < 1e-5, "{x}");
        }
    }
}

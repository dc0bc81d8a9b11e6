//! Smoothing (section 4.2): separable filters along x, then y, then z.
//!
//! Per axis and cell: (sum over taps of weight * sample + 32768) >> 16, with integer weights that sum to
//! 65536. A result is never outside of the range of its samples.
//!
//! A filter reaches [`Kernel::reach`] cells along every axis, and the result is smaller by as much.

mod cpu;
mod filter;
mod smoothing;
pub mod vulkan;

pub use cpu::{Sample, blur, blur_while};
pub use filter::{FieldCount, Filter};
pub use smoothing::Smoothing;

use crate::units::Sigma;

/// Weights sum to this.
const UNIT: u32 = 1 << 16;

/// A symmetric filter: integer weights that sum to 65536.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Kernel {
    /// The weight of the centre, then of the cells 1, 2, ... away on either side.
    half: Vec<u32>,
}

impl Kernel {
    /// The Gaussian with max(3, 2 floor(3 sigma) - 1) taps.
    #[must_use]
    pub fn gaussian(sigma: Sigma) -> Self {
        let sigma = sigma.cells();
        let reach = ((3.0 * sigma).floor() as u32).saturating_sub(1).max(1);
        let weight = |k: u32| (-f64::from(k * k) / (2.0 * sigma * sigma)).exp();
        let sum: f64 = weight(0) + 2.0 * (1..=reach).map(weight).sum::<f64>();
        let tails: Vec<u32> =
            (1..=reach).map(|k| (weight(k) / sum * f64::from(UNIT)).round() as u32).collect();
        Self::with_tails(tails)
    }

    /// The box of three taps.
    #[must_use]
    pub fn box3() -> Self {
        Self::with_tails(vec![UNIT / 3])
    }

    /// The centre takes what the tails leave.
    fn with_tails(tails: Vec<u32>) -> Self {
        let centre = UNIT - 2 * tails.iter().sum::<u32>();
        Self { half: std::iter::once(centre).chain(tails).collect() }
    }

    /// How far it reaches from a cell, in cells.
    #[must_use]
    pub fn reach(&self) -> i32 {
        self.half.len() as i32 - 1
    }

    /// The square of its standard deviation, in squared cells.
    #[must_use]
    pub fn variance(&self) -> f64 {
        let moments = (0_u32..).zip(&self.half).map(|(k, &weight)| u64::from(k * k) * u64::from(weight));
        2.0 * moments.sum::<u64>() as f64 / f64::from(UNIT)
    }

    /// The weight of the centre, then of the cells 1, 2, ... away on either side.
    #[must_use]
    pub fn half(&self) -> &[u32] {
        &self.half
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mask_has_as_many_taps_as_the_paper_says() {
        for (sigma, taps) in [(0.1, 3), (0.8, 3), (1.0, 5), (1.2, 5), (1.5, 7), (2.0, 11), (10.0, 59)] {
            let kernel = Kernel::gaussian(Sigma::new(sigma).unwrap());
            assert_eq!(2 * kernel.reach() + 1, taps, "sigma {sigma}");
        }
    }

    #[test]
    fn the_variance_is_that_of_the_gaussian_but_for_what_is_cut_off() {
        assert!((Kernel::box3().variance() - 2.0 / 3.0).abs() < 1e-4);
        for sigma in [2.0, 3.2, 6.4, 10.0] {
            let ratio = Kernel::gaussian(Sigma::new(sigma).unwrap()).variance() / (sigma * sigma);
            assert!((0.85..1.0).contains(&ratio), "sigma {sigma}: {ratio}");
        }
    }

    #[test]
    fn weights_sum_to_one_and_fall_off() {
        for sigma in [0.01, 0.3, 0.5, 0.8, 1.0, 1.5, 3.3, 10.0] {
            let kernel = Kernel::gaussian(Sigma::new(sigma).unwrap());
            let half = kernel.half();
            assert_eq!(half[0] + 2 * half[1..].iter().sum::<u32>(), UNIT);
            assert!(half.is_sorted_by(|a, b| a >= b), "sigma {sigma}: {half:?}");
        }
    }
}

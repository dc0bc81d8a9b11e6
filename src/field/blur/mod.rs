//! Smoothing (section 4.2 of the paper): separable filters along x, then y, then z.
//!
//! Along each axis, a cell's new sample is (sum over taps of weight * sample + 32768) >> 16, with
//! integer weights that sum to 65536. Without a gain, each result lies between the smallest and the
//! greatest of its samples. With a gain of g bits, a filter shifts the sum along its last axis by
//! 16 - g bits instead of 16, and saturates at 65535. A wide filter makes samples small, and the
//! gain preserves their resolution.
//!
//! A filter reaches [`Weights::reach`] cells along every axis, and its result is smaller than its
//! input by this reach on every side.

mod cpu;
mod filter;
mod smoothing;
pub mod vulkan;

pub use cpu::{BlurSample, blur, blur_of_few, blur_while};
pub use filter::{FieldCount, Filter};
pub use smoothing::Smoothing;

use crate::grid::units::Sigma;

/// The sum of all weights.
const UNIT: u32 = 1 << 16;

/// A symmetric filter: integer weights that sum to 65536.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Weights {
    /// The weight of the centre, then of the cells at distances 1, 2, ... on either side.
    half: Vec<u32>,
    /// The gain in bits: results are 2^`gain` times the weighted mean of the samples.
    gain: u32,
}

impl Weights {
    /// The Gaussian with max(3, 2 floor(3 sigma) - 1) taps.
    pub fn gaussian(sigma: Sigma) -> Self {
        let sigma: f64 = sigma.cells();
        let reach = ((3.0 * sigma).floor() as u32).saturating_sub(1).max(1);
        let weight = |k: u32| libm::exp(-f64::from(k * k) / (2.0 * sigma * sigma));
        let sum: f64 = weight(0) + 2.0 * (1..=reach).map(weight).sum::<f64>();
        let tails: Vec<u32> =
            (1..=reach).map(|k| (weight(k) / sum * f64::from(UNIT)).round() as u32).collect();
        Self::with_tails(tails)
    }

    /// Makes a Gaussian that is cut off at `reach` cells. After the cut, its variance is
    /// `variance`, in squared cells. If the reach is too short for this variance, the Gaussian has
    /// a variance of 4 `variance` before the cut, and less than `variance` after it.
    ///
    /// The computation uses only arithmetic that rounds in the same way on every machine.
    pub fn of_variance(variance: f64, reach: i32) -> Self {
        let weights = |square: f64| -> Vec<f64> {
            (0..=reach).map(|k| libm::exp(-f64::from(k * k) / (2.0 * square))).collect()
        };
        let moments = |weights: &[f64]| {
            let tails = || (1_u32..).zip(&weights[1..]);
            let sum = weights[0] + 2.0 * tails().map(|(_, weight)| weight).sum::<f64>();
            let second: f64 = tails().map(|(k, weight)| f64::from(k * k) * weight).sum();
            (sum, 2.0 * second / sum)
        };
        // Cutting off the tails makes the filter narrower, so the search also tries wider
        // Gaussians.
        let (mut below, mut above) = (variance / 2.0, 4.0 * variance);
        for _ in 0..60 {
            let middle = (below + above) / 2.0;
            let (_, found) = moments(&weights(middle));
            *(if found < variance { &mut below } else { &mut above }) = middle;
        }
        let weights = weights(below);
        let (sum, _) = moments(&weights);
        let tails =
            weights[1..].iter().map(|weight| (weight / sum * f64::from(UNIT)).round() as u32);
        Self::with_tails(tails.collect())
    }

    /// The variance, in squared cells, that this Gaussian had before it was cut off, and the factor
    /// by which the remaining weights exceed the weights of the whole Gaussian.
    pub fn before_cut(&self) -> (f64, f64) {
        let [centre, next] = [0, 1].map(|k: usize| f64::from(self.half[k]) / f64::from(UNIT));
        let variance = 0.5 / libm::log(centre / next);
        (variance, centre * (std::f64::consts::TAU * variance).sqrt())
    }

    /// Adds a gain of `gain` bits, at most 15.
    pub fn gaining(self, gain: u32) -> Self {
        debug_assert!(gain < UNIT.ilog2(), "{gain} bits");
        Self { gain, ..self }
    }

    /// The box of three taps.
    pub fn box3() -> Self {
        Self::with_tails(vec![UNIT / 3])
    }

    /// Makes a filter from the weights on one side of its centre. The centre gets the remaining
    /// weight.
    fn with_tails(tails: Vec<u32>) -> Self {
        let centre = UNIT - 2 * tails.iter().sum::<u32>();
        Self { half: std::iter::once(centre).chain(tails).collect(), gain: 0 }
    }

    /// The maximum distance, in cells, from a cell to its taps.
    pub fn reach(&self) -> i32 {
        self.half.len() as i32 - 1
    }

    /// The number of bits by which the sum along `axis` is shifted right.
    pub fn shift(&self, axis: usize) -> u32 {
        if axis == 2 { UNIT.ilog2() - self.gain } else { UNIT.ilog2() }
    }

    /// The square of the filter's standard deviation, in squared cells.
    pub fn variance(&self) -> f64 {
        let moments =
            (0_u32..).zip(&self.half).map(|(k, &weight)| u64::from(k * k) * u64::from(weight));
        2.0 * moments.sum::<u64>() as f64 / f64::from(UNIT)
    }

    /// The weight of the centre, then of the cells at distances 1, 2, ... on either side.
    pub fn half(&self) -> &[u32] {
        &self.half
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gaussian_has_the_requested_variance() {
        for variance in [0.3, 0.5, 1.0, 2.3, 5.5, 12.7, 40.0] {
            let reach = (2.6 * f64::sqrt(variance)).ceil() as i32;
            let weights = Weights::of_variance(variance, reach);
            assert_eq!(weights.reach(), reach);
            assert!(
                (weights.variance() / variance - 1.0).abs() < 1e-3,
                "{variance}: {}",
                weights.variance()
            );
        }
    }

    #[test]
    fn the_variance_before_the_cut_follows_from_the_first_two_weights() {
        for variance in [1.0, 2.3, 5.5] {
            // At this reach, the cut hardly changes the Gaussian.
            let (before, higher) = Weights::of_variance(variance, 16).before_cut();
            assert!((before / variance - 1.0).abs() < 0.01, "{variance}: {before}");
            assert!((higher - 1.0).abs() < 0.01, "{variance}: {higher}");
            let reach = (2.0 * f64::sqrt(variance)).ceil() as i32;
            let (before, higher) = Weights::of_variance(variance, reach).before_cut();
            assert!(before > 1.02 * variance && higher > 1.002, "{variance}: {before}, {higher}");
        }
    }

    #[test]
    fn the_gaussian_has_the_number_of_taps_of_the_paper() {
        for (sigma, taps) in
            [(0.1, 3), (0.8, 3), (1.0, 5), (1.2, 5), (1.5, 7), (2.0, 11), (10.0, 59)]
        {
            let weights = Weights::gaussian(Sigma::new(sigma).unwrap());
            assert_eq!(2 * weights.reach() + 1, taps, "sigma {sigma}");
        }
    }

    #[test]
    fn the_variance_accounts_for_the_truncation_of_the_gaussian() {
        assert!((Weights::box3().variance() - 2.0 / 3.0).abs() < 1e-4);
        for sigma in [2.0, 3.2, 6.4, 10.0] {
            let ratio = Weights::gaussian(Sigma::new(sigma).unwrap()).variance() / (sigma * sigma);
            assert!((0.85..1.0).contains(&ratio), "sigma {sigma}: {ratio}");
        }
    }

    #[test]
    fn weights_sum_to_one_and_fall_off() {
        for sigma in [0.01, 0.3, 0.5, 0.8, 1.0, 1.5, 3.3, 10.0] {
            let weights = Weights::gaussian(Sigma::new(sigma).unwrap());
            let half = weights.half();
            assert_eq!(half[0] + 2 * half[1..].iter().sum::<u32>(), UNIT);
            assert!(half.is_sorted_by(|a, b| a >= b), "sigma {sigma}: {half:?}");
        }
    }
}

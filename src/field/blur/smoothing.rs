//! The filters that compute the smoothed DIF (section 4.2 of the paper).

use crate::brick::Block;
use crate::field::indicator::IndicatorKind;
use crate::grid::Mirror;
use crate::grid::units::Sigma;

use super::{BlurSample, FieldCount, Filter, Weights, blur};

/// The smoothing of section 4.2: a Gaussian and, for the counting indicator, a box filter after it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Smoothing {
    filters: Vec<Weights>,
}

impl Smoothing {
    /// Makes the smoothing that the paper prescribes for an indicator.
    pub fn new(kind: IndicatorKind, sigma: Sigma) -> Self {
        let gaussian = Weights::gaussian(sigma);
        let filters = match kind {
            IndicatorKind::Symmetry | IndicatorKind::Cloud => vec![gaussian],
            IndicatorKind::Counting => vec![gaussian, Weights::box3()],
        };
        Self { filters }
    }

    /// The standard deviation, in cells, of a smoothed particle along an axis. It includes the
    /// variance of the particle's position within its cell.
    pub fn width(&self) -> f64 {
        (1.0 / 12.0 + self.filters.iter().map(Weights::variance).sum::<f64>()).sqrt()
    }

    /// Smooths a block; the result is smaller by the smoothing's [`halo`](Filter::halo) on every
    /// side.
    pub fn apply<T: BlurSample>(&self, dif: Block<T>, mirror: Option<Mirror>) -> Block<T> {
        self.filters.iter().fold(dif, |block, weights| blur(block, weights, mirror))
    }
}

impl Filter for Smoothing {
    /// The filters run one after the other, so their halos add up.
    fn halo(&self) -> i32 {
        self.filters.iter().map(Weights::reach).sum()
    }

    fn weights(&self) -> &[Weights] {
        &self.filters
    }

    /// Each pass reads one field and writes another.
    fn fields(&self) -> FieldCount {
        FieldCount { host: 2, device: 2 }
    }
}

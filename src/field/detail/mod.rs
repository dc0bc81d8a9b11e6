//! Detail recovery (section 6.2): samples that smoothing reduced to the isovalue or below are
//! smoothed again with a narrower filter.
//!
//! theta_bar(K) = theta(K) where theta_smooth(K) <= c, else 0; then max(theta_smooth,
//! blur(theta_bar)) per cell, where the second blur is a Gaussian of sigma / 2.
//!
//! The reach of detail recovery is the reach of the second Gaussian.

mod cpu;
pub mod vulkan;

pub use cpu::{lost, raise};

use crate::field::blur::{FieldCount, Filter, Weights};
use crate::grid::units::Sigma;

/// The additional filter of detail recovery.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recovery {
    /// The second Gaussian.
    pub fine: Weights,
}

impl Recovery {
    /// Makes the filter for a smoothing with a Gaussian of `sigma`.
    pub fn new(sigma: Sigma) -> Self {
        Self { fine: Weights::gaussian(sigma.half()) }
    }
}

impl Filter for Recovery {
    fn halo(&self) -> i32 {
        self.fine.reach()
    }

    fn weights(&self) -> &[Weights] {
        std::slice::from_ref(&self.fine)
    }

    /// The DIF, the smoothed DIF, theta_bar, and its blur; on a device, the blur goes into the
    /// DIF's buffer.
    fn fields(&self) -> FieldCount {
        FieldCount { host: 4, device: 3 }
    }
}

//! Detail recovery (section 6.2): what smoothing took below the isovalue is smoothed again, less.
//!
//! theta_bar(K) = theta(K) where theta_smooth(K) <= c, else 0; then max(theta_smooth,
//! blur(theta_bar)) per cell, the second blur a Gaussian of sigma / 2.
//!
//! Reaches as far as that second weights.

mod cpu;
pub mod vulkan;

pub use cpu::{lost, raise};

use crate::field::blur::{FieldCount, Filter, Weights};
use crate::grid::units::Sigma;

/// The filter beside those of the smoothing.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recovery {
    /// The second Gaussian.
    pub fine: Weights,
}

impl Recovery {
    /// Beside a Gaussian of `sigma`.
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

    /// The DIF, what is smoothed of it, what that lost, and that blurred, into the DIF's buffer on
    /// a device.
    fn fields(&self) -> FieldCount {
        FieldCount { host: 4, device: 3 }
    }
}

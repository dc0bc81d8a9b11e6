//! Detail recovery (section 6.2 of the paper): samples that smoothing reduced to the isovalue or
//! below are smoothed again with a narrower filter.
//!
//! theta_bar(K) is theta(K) where theta_smooth(K) <= c, and 0 elsewhere. The field of each cell is
//! max(theta_smooth, blur(theta_bar)), where the blur is a second Gaussian, of sigma / 2.
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
    /// Makes the filter that recovers details after smoothing by a Gaussian of `sigma`.
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

    /// The DIF, the smoothed DIF, theta_bar, and the blurred theta_bar, which a device writes into
    /// the DIF's buffer.
    fn fields(&self) -> FieldCount {
        FieldCount { host: 4, device: 3 }
    }
}

//! Detail recovery (section 6.2): what smoothing took below the isovalue is smoothed again, less.
//!
//! theta_bar(K) = theta(K) where theta_smooth(K) <= c, else 0; then max(theta_smooth, blur(theta_bar))
//! per cell, the second blur a Gaussian of sigma / 2.
//!
//! Reaches as far as that second kernel.

mod cpu;
pub mod vulkan;

pub use cpu::{lost, raise};

/// What becomes of details that smoothing loses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Detail {
    Smoothed,
    /// Section 6.2.
    Recovered,
    /// The blur spares them, see [`adaptive`](super::adaptive).
    Spared,
}

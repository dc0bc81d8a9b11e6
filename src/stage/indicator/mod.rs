//! The discrete indicator function (section 4.1), as integers of 0 to 65535.
//!
//! Counting (eq. 6): theta = min(N, mu0) / mu0, rounded to the nearest integer.
//!
//! Symmetry (eq. 7): theta = 1 - 2 |c - p| / (sqrt(3) h). With N particles whose offsets in the cell sum
//! to S in steps of h / F, each offset standing for the middle of its step, the centroid is at
//! (2 S + N) / (2 N F) of the edge, and eq. 7 becomes 1 - |D| / (sqrt(3) N F) with D = |2 S + N - N F|.
//!
//! Both depend on the cell's own particles alone, so this stage has no reach. A full cell's theta is
//! never 0: the farthest centroid is half a step away from a corner.

mod cpu;
pub mod vulkan;

pub use cpu::{DISTANCE_SCALE, THETA_PER_DISTANCE, count_table, indicate, symmetry};

use crate::units::MeanCount;

/// Which indicator, and what it needs to know.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Indicator {
    /// By how far a cell's particles lie from its centre on average (eq. 7).
    Symmetry,
    /// By their number (eq. 6).
    Counting {
        /// `mu0`; measured on the frame itself (eq. 4) where it is `None`.
        mean: Option<MeanCount>,
    },
}

/// Where a spacing is more cells, they hold no particle too often for their symmetry to tell much: the interior fills with
/// bubbles.
const WIDEST_FOR_SYMMETRY: f64 = 1.0 / 0.9;

impl Indicator {
    /// The one that suits particles whose spacing is so many cells, if it is known.
    #[must_use]
    pub fn of_spacing(spacing: Option<f64>) -> Self {
        match spacing {
            Some(spacing) if spacing > WIDEST_FOR_SYMMETRY => Self::Counting { mean: None },
            _ => Self::Symmetry,
        }
    }

    /// What it is called.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Symmetry => "symmetry",
            Self::Counting { .. } => "counting",
        }
    }
}

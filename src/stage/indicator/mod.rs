//! The discrete indicator function (section 4.1), as integers of 0 to 65535.
//!
//! Counting (eq. 6): theta = min(N, mu0) / mu0, rounded to the nearest integer.
//!
//! Symmetry (eq. 7): theta = 1 - 2 |c - p| / (sqrt(3) h). With N particles whose offsets in the cell sum
//! to S in steps of h / F, each offset standing for the middle of its step, the centroid is at
//! (2 S + N) / (2 N F) of the edge, and eq. 7 becomes 1 - |D| / (sqrt(3) N F) with D = |2 S + N - N F|.
//!
//! Both depend on the cell's own particles alone, and jump where a particle passes from one cell to the next: layers of
//! particles that lie along layers of cells move the surface by as much as a cell. A full cell's theta is never 0: the
//! farthest centroid is half a step away from a corner.
//!
//! Cloud, which is this project's: theta = min(rho, 2 mu0) / (2 mu0), where rho counts particles as clouds. A particle
//! lies around its place as the quadratic B-spline does, the triangular-shaped cloud of Hockney and Eastwood (Computer
//! Simulation Using Particles, 1988): at u of a cell's edge along an axis, a share of (1 - u)^2 / 2 falls to the cell
//! below, u^2 / 2 to the one above, and the rest to its own. Cells then hold the particles' number, their centroid and
//! how wide they lie, save for a constant, and nothing jumps. theta can be more than 0 in all cells around a particle's own.

mod cloud;
mod cpu;
pub mod vulkan;

pub use cloud::{RIM, SHARE_BITS, SQUARE_BITS, amount};
pub use cpu::{DISTANCE_SCALE, THETA_PER_DISTANCE, count_table, indicate, symmetry};

use crate::brick::{BrickSide, DifField, PageShape};
use crate::grid::CellBox;
use crate::units::{MeanCount, UnitError};

/// How pages are made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PageRule {
    /// What is stored; one that [waits for its mean](Indicator::waits_for_mean) cannot be.
    pub indicator: Indicator,
    /// How it is stored.
    pub side: BrickSide,
    /// Walls, if the fluid is in a tank.
    pub walls: Option<CellBox>,
}

impl PageRule {
    /// How the samples lie.
    #[must_use]
    pub fn shape(&self) -> PageShape {
        self.indicator.shape(self.side)
    }
}

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
    /// By how much of their clouds lies in a cell.
    Cloud {
        /// As for counting, but known before there is any DIF: some bins tell it of a large frame.
        mean: Option<MeanCount>,
    },
}

impl Default for Indicator {
    fn default() -> Self {
        Self::Cloud { mean: None }
    }
}

impl Indicator {
    /// What it is called.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Symmetry => "symmetry",
            Self::Counting { .. } => "counting",
            Self::Cloud { .. } => "cloud",
        }
    }

    /// Whether it has to know mu0.
    #[must_use]
    pub fn counts(self) -> bool {
        self != Self::Symmetry
    }

    /// mu0, where it is known.
    #[must_use]
    pub fn mean(self) -> Option<MeanCount> {
        match self {
            Self::Symmetry => None,
            Self::Counting { mean } | Self::Cloud { mean } => mean,
        }
    }

    /// The same with another mu0, if it has to know it.
    #[must_use]
    pub fn with_mean(self, mean: Option<MeanCount>) -> Self {
        match self {
            Self::Symmetry => self,
            Self::Counting { .. } => Self::Counting { mean },
            Self::Cloud { .. } => Self::Cloud { mean },
        }
    }

    /// The same with mu0 by eq. 4, if it has to know it and does not.
    ///
    /// # Errors
    /// Those of [`MeanCount::measured`].
    pub fn measured(self, particles: usize, full_cells: u64) -> Result<Self, UnitError> {
        if self == Self::Symmetry || self.mean().is_some() {
            return Ok(self);
        }
        Ok(self.with_mean(Some(MeanCount::measured(particles as u64, full_cells)?)))
    }

    /// How wide a Gaussian suits it, in spacings. Clouds have a width of their own.
    #[must_use]
    pub fn spacings_smoothed(self) -> f64 {
        if matches!(self, Self::Cloud { .. }) { 0.8 } else { 1.0 }
    }

    /// The variance of where a particle is, along an axis, as far as it is known from the DIF, in squared cells: that of a
    /// cloud, or of the cell that it is in.
    #[must_use]
    pub fn variance(self) -> f64 {
        if matches!(self, Self::Cloud { .. }) { 1.0 / 4.0 } else { 1.0 / 12.0 }
    }

    /// The least theta of cells that count as full where details are told from nothing, once mu0 is known: for clouds a
    /// thirtieth of a particle. Cells of a layer of particles then hang together, and no particle is without one.
    #[must_use]
    pub fn least(self) -> u16 {
        match self {
            Self::Cloud { mean: Some(mean) } => (amount(mean) / 30).max(1),
            _ => 1,
        }
    }

    /// Whether mu0 has to be known, and is not, before there is any DIF.
    #[must_use]
    pub fn waits_for_mean(self) -> bool {
        self == Self::Cloud { mean: None }
    }

    /// The bricks that suit it: rims weigh less around large ones.
    #[must_use]
    pub fn brick_side(self) -> BrickSide {
        if matches!(self, Self::Cloud { .. }) { BrickSide::Sixteen } else { BrickSide::default() }
    }

    /// How what it stores lies in pages.
    #[must_use]
    pub fn shape(self, side: BrickSide) -> PageShape {
        PageShape { side, rim: if matches!(self, Self::Cloud { .. }) { RIM } else { 0 } }
    }

    /// The DIF by what was stored, once mu0 is known.
    #[must_use]
    pub fn decode(self, stored: DifField) -> DifField {
        match self {
            Self::Counting { mean: Some(mean) } => stored.with_decode(&count_table(mean)),
            _ => stored,
        }
    }
}

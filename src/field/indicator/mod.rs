//! The discrete indicator function (section 4.1 of the paper), as integers from 0 to 65535.
//!
//! Counting (eq. 6): theta = min(N, mu0) / mu0, rounded to the nearest integer.
//!
//! Symmetry (eq. 7): theta = 1 - 2 |c - p| / (sqrt(3) h). Offsets in the cell are integers from 0
//! to F - 1, in steps of h / F, and each offset stands for the middle of its step. If the offsets
//! of N particles sum to S, the centroid is at (2 S + N) / (2 N F) of the edge, and eq. 7 becomes
//! 1 - |D| / (sqrt(3) N F) with D = |2 S + N - N F|.
//!
//! Counting and symmetry depend only on the particles in the cell, and jump when a particle moves
//! from one cell to the next. If layers of particles are parallel to layers of cells, such a jump
//! moves the surface by up to a cell. theta of a full cell is never 0, because even the farthest
//! centroid is half a step away from a corner.
//!
//! Cloud, which is not in the paper, is a density rather than a share of fluid: rho A, at most
//! 65535, where rho is the sum of the shares of all particles' clouds in the cell, and A is the
//! [`Amount`] for the cell size. A particle is distributed around its position by the quadratic
//! B-spline, the triangular-shaped cloud of Hockney and Eastwood (Computer Simulation Using
//! Particles, 1988): at the fraction u of a cell's edge along an axis, a share of (1 - u)^2 / 2
//! goes to the cell below, u^2 / 2 to the cell above, and the rest to the particle's own cell. The
//! samples then preserve the number of particles, their centroid and, up to a constant, their
//! variance, and no sample jumps. All cells around a particle's own cell can receive a share of the
//! particle. For the surface of clouds, see [`distance`](super::distance).

mod cloud;
mod cpu;
mod sampled;
pub mod vulkan;
mod wide;

pub use cloud::{Amount, CloudWalls, Clouds, GAIN_BITS, GHOST_LAYER, SHARE_BITS, SQUARE_BITS};
pub use cpu::{DISTANCE_SCALE, THETA_PER_DISTANCE, indicate, symmetry};
pub use sampled::SampledDif;
pub use wide::WideCells;

use serde::{Deserialize, Serialize};

use crate::brick::{BrickSide, DifField, PageShape};
use crate::grid::units::{FULL, MeanCount};

/// The kinds of indicators.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum IndicatorKind {
    /// How close the particles' centroid is to the cell's centre: from 0 at a corner to 1 at the
    /// centre.
    Symmetry,
    /// The number of particles in the cell, compared with the number expected inside the fluid.
    Counting,
    /// The density of the particles, after each particle is spread over nearby cells as a cloud.
    #[default]
    Cloud,
}

/// The indicator that computed a field, with `mu0` for counting.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Indicator {
    /// [`IndicatorKind::Symmetry`].
    Symmetry,
    /// [`IndicatorKind::Counting`] with its `mu0`.
    Counting(MeanCount),
    /// [`IndicatorKind::Cloud`].
    Cloud,
}

/// The parameters of pages.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PageRule {
    /// The indicator whose samples are stored: the DIF for symmetry, sums of clouds, or numbers of
    /// particles, which become the DIF once `mu0` is known.
    pub indicator: IndicatorKind,
    /// The particles' spacing in cells, which determines the amount of a cloud.
    pub spacing_cells: f64,
    /// The brick size of pages.
    pub side: BrickSide,
    /// Walls, if the fluid is in a tank.
    pub walls: Option<CloudWalls>,
}

impl PageRule {
    /// The arrangement of the samples.
    pub fn shape(&self) -> PageShape {
        self.indicator.shape(self.side)
    }
}

impl IndicatorKind {
    /// The indicator of this kind, with `mu0` for counting.
    ///
    /// # Errors
    /// If `mean` fails; it is called only for counting.
    pub fn with_mean<E>(self, mean: impl FnOnce() -> Result<MeanCount, E>) -> Result<Indicator, E> {
        match self {
            Self::Symmetry => Ok(Indicator::Symmetry),
            Self::Counting => mean().map(Indicator::Counting),
            Self::Cloud => Ok(Indicator::Cloud),
        }
    }

    /// Returns the name of the kind.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Symmetry => "symmetry",
            Self::Counting => "counting",
            Self::Cloud => "cloud",
        }
    }

    /// Whether the indicator needs mu0.
    #[must_use]
    pub fn counts(self) -> bool {
        self == Self::Counting
    }

    /// The best brick size. For clouds, it is the largest, because ghost layers take less memory
    /// around large bricks.
    #[must_use]
    pub fn brick_side(self) -> BrickSide {
        if self == Self::Cloud { BrickSide::Sixteen } else { BrickSide::default() }
    }

    /// The arrangement of stored samples in pages.
    #[must_use]
    pub fn shape(self, side: BrickSide) -> PageShape {
        PageShape { side, ghost_layer: if self == Self::Cloud { GHOST_LAYER } else { 0 } }
    }
}

impl Indicator {
    /// Returns the kind of the indicator.
    #[must_use]
    pub fn kind(self) -> IndicatorKind {
        match self {
            Self::Symmetry => IndicatorKind::Symmetry,
            Self::Counting(_) => IndicatorKind::Counting,
            Self::Cloud => IndicatorKind::Cloud,
        }
    }

    /// mu0, for counting.
    #[must_use]
    pub fn mean(self) -> Option<MeanCount> {
        match self {
            Self::Symmetry | Self::Cloud => None,
            Self::Counting(mean) => Some(mean),
        }
    }

    /// Converts stored samples to the DIF.
    #[must_use]
    pub fn decode(self, stored: DifField) -> DifField {
        match self {
            Self::Counting(mean) => stored.with_decode(&count_table(mean)),
            _ => stored,
        }
    }
}

/// Eq. 6: theta for each number of particles up to `mean`; for larger numbers theta is 1. Cells
/// store numbers, and [`DifField::gather`] and `gather.wgsl` apply eq. 6 when they cut out blocks.
pub fn count_table(mean: MeanCount) -> Vec<u16> {
    let mean = mean.particles();
    (0..=mean.floor() as u32)
        .map(|n| (f64::from(n) / mean * f64::from(FULL)).round() as u16)
        .collect()
}

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
mod sampled;
pub mod vulkan;

pub use cloud::{RIM, SHARE_BITS, SQUARE_BITS, amount};
pub use cpu::{DISTANCE_SCALE, THETA_PER_DISTANCE, indicate, symmetry};
pub use sampled::SampledDif;

use crate::brick::{BrickSide, DifField, PageShape};
use crate::grid::CellBox;
use crate::units::{FULL, MeanCount};

/// The kinds of indicators.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum IndicatorKind {
    /// By how far a cell's particles lie from its centre on average (eq. 7).
    Symmetry,
    /// By their number (eq. 6).
    Counting,
    /// By how much of their clouds lies in a cell.
    #[default]
    Cloud,
}

/// An indicator as it is asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IndicatorRequest {
    /// Its kind.
    pub kind: IndicatorKind,
    /// `mu0`; measured on the frame itself (eq. 4) where it is `None`. Symmetry has no use for it.
    pub mean: Option<MeanCount>,
}

/// An indicator with what it has to know.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Indicator {
    /// [`IndicatorKind::Symmetry`].
    Symmetry,
    /// [`IndicatorKind::Counting`] with its `mu0`.
    Counting(MeanCount),
    /// [`IndicatorKind::Cloud`] with its `mu0`.
    Cloud(MeanCount),
}

/// Meaning of the samples in pages.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Content {
    /// The DIF by symmetry.
    Symmetry,
    /// Numbers of particles, which become the DIF once `mu0` is known.
    Counts,
    /// Sums of the clouds of a page's own particles, by their `mu0`.
    Clouds(MeanCount),
}

/// How pages are made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PageRule {
    /// The samples that are stored.
    pub content: Content,
    /// How it is stored.
    pub side: BrickSide,
    /// Walls, if the fluid is in a tank.
    pub walls: Option<CellBox>,
}

impl PageRule {
    /// How the samples lie.
    #[must_use]
    pub fn shape(&self) -> PageShape {
        self.content.kind().shape(self.side)
    }
}

impl Content {
    fn kind(self) -> IndicatorKind {
        match self {
            Self::Symmetry => IndicatorKind::Symmetry,
            Self::Counts => IndicatorKind::Counting,
            Self::Clouds(_) => IndicatorKind::Cloud,
        }
    }
}

impl IndicatorKind {
    /// What it is called.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Symmetry => "symmetry",
            Self::Counting => "counting",
            Self::Cloud => "cloud",
        }
    }

    /// Whether it has to know mu0.
    #[must_use]
    pub fn counts(self) -> bool {
        self != Self::Symmetry
    }

    /// How wide a Gaussian suits it, in spacings. Clouds have a width of their own.
    #[must_use]
    pub fn spacings_smoothed(self) -> f64 {
        if self == Self::Cloud { 0.8 } else { 1.0 }
    }

    /// The variance of where a particle is, along an axis, as far as it is known from the DIF, in squared cells: that of a
    /// cloud, or of the cell that it is in.
    #[must_use]
    pub fn variance(self) -> f64 {
        if self == Self::Cloud { 1.0 / 4.0 } else { 1.0 / 12.0 }
    }

    /// The bricks that suit it: rims weigh less around large ones.
    #[must_use]
    pub fn brick_side(self) -> BrickSide {
        if self == Self::Cloud { BrickSide::Sixteen } else { BrickSide::default() }
    }

    /// How what it stores lies in pages.
    #[must_use]
    pub fn shape(self, side: BrickSide) -> PageShape {
        PageShape { side, rim: if self == Self::Cloud { RIM } else { 0 } }
    }

    /// The indicator of this kind by a mu0, of which symmetry has no use.
    #[must_use]
    pub fn by(self, mean: MeanCount) -> Indicator {
        match self {
            Self::Symmetry => Indicator::Symmetry,
            Self::Counting => Indicator::Counting(mean),
            Self::Cloud => Indicator::Cloud(mean),
        }
    }
}

/// Asks for mu0 to be measured.
impl From<IndicatorKind> for IndicatorRequest {
    fn from(kind: IndicatorKind) -> Self {
        Self { kind, mean: None }
    }
}

impl Indicator {
    /// Its kind.
    #[must_use]
    pub fn kind(self) -> IndicatorKind {
        match self {
            Self::Symmetry => IndicatorKind::Symmetry,
            Self::Counting(_) => IndicatorKind::Counting,
            Self::Cloud(_) => IndicatorKind::Cloud,
        }
    }

    /// mu0, where it counts.
    #[must_use]
    pub fn mean(self) -> Option<MeanCount> {
        match self {
            Self::Symmetry => None,
            Self::Counting(mean) | Self::Cloud(mean) => Some(mean),
        }
    }

    /// The least theta of cells that count as full where details are told from nothing: for clouds a thirtieth of a particle.
    /// Cells of a layer of particles then hang together, and no particle is without one.
    #[must_use]
    pub fn least(self) -> u16 {
        match self {
            Self::Cloud(mean) => (amount(mean) / 30).max(1),
            _ => 1,
        }
    }

    /// Meaning of the samples in its pages.
    #[must_use]
    pub fn content(self) -> Content {
        match self {
            Self::Symmetry => Content::Symmetry,
            Self::Counting(_) => Content::Counts,
            Self::Cloud(mean) => Content::Clouds(mean),
        }
    }

    /// The DIF by what was stored.
    #[must_use]
    pub fn decode(self, stored: DifField) -> DifField {
        match self {
            Self::Counting(mean) => stored.with_decode(&count_table(mean)),
            _ => stored,
        }
    }
}

/// Eq. 6: theta by the number of particles, up to `mean`; beyond, it is 1.
#[must_use]
pub fn count_table(mean: MeanCount) -> Vec<u16> {
    let mean = mean.particles();
    (0..=mean.floor() as u32).map(|n| (f64::from(n) / mean * f64::from(FULL)).round() as u16).collect()
}

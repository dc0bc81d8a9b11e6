//! mu0, the mean number of particles in a full cell (eq. 4 of the paper). It is given, or measured
//! before counts are converted to the DIF.
//!
//! Counts are converted to the DIF only after all pages are complete, so mu0 is measured on all
//! pages. Only the counting indicator needs mu0; the density of clouds follows from the particles'
//! spacing.

use thiserror::Error;

use crate::brick::{BrickSide, FrameFacts};
use crate::field::indicator::{CloudWalls, Indicator, IndicatorKind, PageRule};
use crate::grid::units::{MeanCount, UnitError};

/// An error: mu0 cannot be measured on this frame.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[error(
    "the mean number of particles in a non-empty cell (mu0) is out of range: {0}; use a smaller \
     cell size"
)]
pub struct NoMeanCount(#[source] pub(crate) UnitError);

/// A frame's particles on any backend, sorted into bins, from which pages can be made.
#[allow(clippy::missing_errors_doc, reason = "the implementor defines the error")]
pub trait BinnedFrame {
    /// The pages, and any other data that is kept with them.
    type Made;
    /// The error if storage fails.
    type Error: From<NoMeanCount>;

    /// Makes the pages of all bins, and counts the full cells and their particles.
    fn make_pages(self, rule: &PageRule) -> Result<(Fullness, Self::Made), Self::Error>;
}

/// The number of particles and the number of cells that contain them.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Fullness {
    /// Number of particles.
    pub particles: u64,
    /// Number of cells with at least one particle.
    pub cells: u64,
}

/// Makes the pages of an indicator, and measures mu0 unless it is given.
pub fn indicate<B: BinnedFrame>(
    binned: B,
    facts: &FrameFacts,
    kind: IndicatorKind,
    mean: Option<MeanCount>,
    side: BrickSide,
) -> Result<(Indicator, B::Made), B::Error> {
    let spacing_cells = facts.spacing_cells_or_one();
    let rule = PageRule { indicator: kind, spacing_cells, side, walls: CloudWalls::of(facts) };
    let (full, made) = binned.make_pages(&rule)?;
    let measured = || MeanCount::measured(full.particles, full.cells).map_err(NoMeanCount);
    let indicator = kind.with_mean(|| mean.map_or_else(measured, Ok))?;
    Ok((indicator, made))
}

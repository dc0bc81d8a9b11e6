//! mu0, the mean number of particles in a full cell (eq. 4): given, or measured on the way to the
//! DIF.
//!
//! Counts become the DIF when all pages are made, so mu0 is measured on all of them. Only counting
//! has a use for it: what clouds hold is told by the particles' spacing.

use thiserror::Error;

use crate::brick::{BrickSide, FrameFacts};
use crate::field::indicator::{Indicator, IndicatorKind, PageRule};
use crate::grid::units::{MeanCount, UnitError};

/// A frame on which mu0 cannot be measured.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[error("cannot measure mu0 on this frame: {0}")]
pub struct NoMeanCount(#[source] pub(crate) UnitError);

/// A frame's particles in order of their bins, ready to be made into pages, wherever they are kept.
#[allow(clippy::missing_errors_doc, reason = "whatever Error is")]
pub trait BinnedFrame {
    /// The pages, and whatever else is left when they are made.
    type Made;
    /// The errors of the storage.
    type Error: From<NoMeanCount>;

    /// Makes the pages of all bins, and says how many cells are full of how many particles.
    fn make_pages(self, rule: &PageRule) -> Result<(Fullness, Self::Made), Self::Error>;
}

/// How many particles there are, and in how many cells.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Fullness {
    /// Particles.
    pub particles: u64,
    /// Cells that hold any.
    pub cells: u64,
}

/// Makes the pages of an indicator, with its mu0, which is measured where it is not given.
pub fn indicate<B: BinnedFrame>(
    binned: B,
    facts: &FrameFacts,
    kind: IndicatorKind,
    mean: Option<MeanCount>,
    side: BrickSide,
) -> Result<(Indicator, B::Made), B::Error> {
    let spacing_cells = facts.spacing_cells_or_one();
    let rule = PageRule { indicator: kind, spacing_cells, side, walls: facts.walls() };
    let (full, made) = binned.make_pages(&rule)?;
    let measured = || MeanCount::measured(full.particles, full.cells).map_err(NoMeanCount);
    let indicator = kind.with_mean(|| mean.map_or_else(measured, Ok))?;
    Ok((indicator, made))
}

//! mu0, the mean number of particles in a full cell (eq. 4): given, or measured on the way to the DIF.
//!
//! Counts become the DIF when all pages are made, so mu0 is measured on all of them. Clouds are made by it: a stratified sample
//! of bins, which is all of them in a small frame, estimates the number of full cells before.

use thiserror::Error;

use crate::brick::BrickSide;
use crate::grid::CellBox;
use crate::stage::indicator::{Content, Indicator, IndicatorKind, IndicatorRequest, PageRule};
use crate::units::{MeanCount, UnitError};

/// A frame on which mu0 cannot be measured.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[error("cannot measure mu0 on this frame: {0}")]
pub struct NoMeanCount(#[source] UnitError);

/// A frame's particles in order of their bins, ready to be made into pages, wherever they are kept.
#[allow(clippy::missing_errors_doc, reason = "whatever Error is")]
pub trait Binned {
    /// The pages, and whatever else is left when they are made.
    type Made;
    /// Whatever can go wrong.
    type Error: From<NoMeanCount>;

    /// How many there are.
    fn particles(&self) -> usize;

    /// About how many cells hold particles, by a stratified sample of the bins.
    fn full_cells(&self) -> Result<u64, Self::Error>;

    /// Makes the pages of all bins, and says how many cells are full.
    fn make_pages(self, rule: &PageRule) -> Result<(u64, Self::Made), Self::Error>;
}

/// Makes the pages of an indicator, with its mu0, which is measured where it is not given.
///
/// # Errors
/// [`NoMeanCount`], and those of `binned`.
pub fn indicate<B: Binned>(
    binned: B,
    asked: IndicatorRequest,
    side: BrickSide,
    walls: Option<CellBox>,
) -> Result<(Indicator, B::Made), B::Error> {
    let particles = binned.particles() as u64;
    let measured = |full_cells| MeanCount::measured(particles, full_cells).map_err(NoMeanCount);
    let rule = |content| PageRule { content, side, walls };
    Ok(match asked.kind {
        IndicatorKind::Symmetry => {
            let (_, made) = binned.make_pages(&rule(Content::Symmetry))?;
            (Indicator::Symmetry, made)
        }
        IndicatorKind::Counting => {
            let (full_cells, made) = binned.make_pages(&rule(Content::Counts))?;
            (Indicator::Counting(asked.mean.map_or_else(|| measured(full_cells), Ok)?), made)
        }
        IndicatorKind::Cloud => {
            let mean = match asked.mean {
                Some(mean) => mean,
                None => measured(binned.full_cells()?)?,
            };
            let (_, made) = binned.make_pages(&rule(Content::Clouds(mean)))?;
            (Indicator::Cloud(mean), made)
        }
    })
}

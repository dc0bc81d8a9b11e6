//! Calibration: all that has to be known before a surface can be drawn, measured on the frame where nobody says it.
//!
//! Two numbers: mu0 ([`indicate`]), without which there is no DIF, and the isovalue, a share of the [`Plateau`] of the smoothed
//! DIF ([`calibrate`]). Both together are a [`Calibration`]: frames of a simulation are drawn by that of one of them.
//! A packed frame carries mu0; its isovalue depends on the filters, which are chosen later.

mod expected;
mod histogram;
mod interior;
mod mean;
mod plateau;
mod precision;

pub use mean::{Binned, NoMeanCount, indicate};
pub use plateau::Plateau;
pub use precision::{COARSEST_STEP, FINEST_OF_SYMMETRY, ON_CORNERS, Remedy, TooFine, refuse_too_fine_for};

use crate::stage::blur::Smoothing;
use crate::stage::indicator::SampledDif;
use crate::units::{Isovalue, MeanCount};

/// Numbers that were measured, or given, and make frames alike.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Calibration {
    /// `mu0`, where the indicator counts.
    pub mean: Option<MeanCount>,
    /// Where the surface is.
    pub iso: Isovalue,
}

/// A calibration that was measured on a frame, and what it was told by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Calibrated {
    /// Measured, or given.
    pub calibration: Calibration,
    /// The field's interior, measured whether or not the isovalue was given.
    pub plateau: Plateau,
    /// How far one step of the field moves a flat surface, in cells.
    pub step_cells: f64,
}

/// Measures what a surface through a frame has to know, but for an isovalue that is given.
///
/// # Errors
/// [`TooFine`] where the field does not tell finely enough where the surface is.
pub fn calibrate(
    frame: &SampledDif,
    smoothing: &Smoothing,
    iso: Option<Isovalue>,
) -> Result<Calibrated, TooFine> {
    let facts = &frame.facts;
    precision::refuse_symmetry(frame.indicator.kind(), facts.spacing_cells(), facts.grid.cell_size())?;
    let plateau = Plateau::of(frame, smoothing);
    let step_cells = precision::refuse_too_fine(frame, smoothing, plateau)?;
    let calibration = Calibration { mean: frame.indicator.mean(), iso: iso.unwrap_or(plateau.isovalue()) };
    Ok(Calibrated { calibration, plateau, step_cells })
}

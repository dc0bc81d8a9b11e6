//! Calibration: all that has to be known before a surface can be drawn, measured on the frame where
//! nobody says it.
//!
//! Of the paper's indicators two numbers: mu0 ([`indicate`]), without which counts are no DIF, and
//! the isovalue, a share of the [`Plateau`] of the smoothed DIF ([`calibrate`]). Of clouds that
//! plateau alone, in wide cells. Both are a [`Calibration`]: frames of a simulation are drawn by
//! that of one of them. A packed frame carries mu0; the rest depends on the filters, which are
//! chosen later.

mod expected;
mod histogram;
mod interior;
mod mean;
mod plateau;
mod precision;

pub use mean::{BinnedFrame, Fullness, NoMeanCount, indicate};
pub use plateau::Plateau;
pub(crate) use precision::refuse_finest;
pub use precision::{
    COARSEST_STEP, FINEST_OF_SYMMETRY, ON_CORNERS, Remedy, TooFine, refuse_too_fine_for,
};

use crate::brick::DifField;
use crate::field::distance::UNITS;
use crate::field::indicator::{IndicatorKind, SampledDif};
use crate::field::recipe::Filters;
use crate::grid::units::{Isovalue, MeanCount};
use crate::system::control::{Control, Stage};

/// The share of [`Stage::Meshing`] that calibrating is, where it is measured.
pub const CALIBRATING: f64 = 0.1;

/// Numbers that were measured, or given, and make frames alike.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Calibration {
    /// The calibration of an indicator of the paper.
    Indicator {
        /// `mu0`, where the indicator counts.
        mean: Option<MeanCount>,
        /// The isovalue: the field's value where the surface is.
        iso: Isovalue,
    },
    /// The calibration of clouds.
    Clouds {
        /// The sample under the narrowest width deep in the fluid.
        plateau: u16,
    },
}

impl Calibration {
    /// `mu0`, where there is one.
    #[must_use]
    pub fn mean(&self) -> Option<MeanCount> {
        match *self {
            Self::Indicator { mean, .. } => mean,
            Self::Clouds { .. } => None,
        }
    }

    /// Whether it is of this kind of indicator, whose surfaces alone can be drawn by it.
    #[must_use]
    pub fn suits(&self, kind: IndicatorKind) -> bool {
        matches!(self, Self::Clouds { .. }) == (kind == IndicatorKind::Cloud)
    }

    /// The isovalue of an indicator of the paper.
    #[must_use]
    pub fn iso(&self) -> Option<Isovalue> {
        match *self {
            Self::Indicator { iso, .. } => Some(iso),
            Self::Clouds { .. } => None,
        }
    }
}

/// A calibration that was measured on a frame, and what it was told by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeasuredCalibration {
    /// The calibration, as far as it was not given.
    pub calibration: Calibration,
    /// The field's interior, measured whether or not the isovalue was given.
    pub plateau: Plateau,
    /// How far one step of the field moves a flat surface, in cells.
    pub step_cells: f64,
}

impl MeasuredCalibration {
    /// Particles in a cubed spacing deep in the fluid, as a plateau of clouds tells, by the spacing
    /// in cells.
    #[must_use]
    pub fn density(&self, spacing: f64) -> f64 {
        f64::from(self.plateau.value()) / Plateau::nominal(spacing)
    }
}

/// Measures what a surface through a frame has to know, but for an isovalue that is given.
/// `control` hears of the progress. What is measured after the caller has asked for an early end is
/// worth nothing.
///
/// # Errors
/// [`TooFine`] where the field does not tell finely enough where the surface is.
pub fn calibrate(
    frame: &SampledDif,
    filters: &Filters,
    iso: Option<Isovalue>,
    control: &Control,
) -> Result<MeasuredCalibration, TooFine> {
    let facts = &frame.facts;
    let meter = |dif: &DifField| {
        control.meter(Stage::Meshing, Plateau::most_parts(dif)).between(0.0, CALIBRATING)
    };
    match filters {
        Filters::Paper(paper) => {
            let smoothing = &paper.smoothing;
            precision::refuse_symmetry(
                frame.indicator.kind(),
                facts.spacing_cells(),
                facts.grid.cell_size(),
            )?;
            let plateau = Plateau::of(frame, smoothing, &meter(&frame.dif));
            let step_cells = precision::refuse_too_fine(frame, smoothing, plateau)?;
            let iso = iso.unwrap_or(plateau.isovalue());
            let calibration = Calibration::Indicator { mean: frame.indicator.mean(), iso };
            Ok(MeasuredCalibration { calibration, plateau, step_cells })
        }
        Filters::Distances(distances) => {
            refuse_finest(facts.spacing_cells(), facts.grid.cell_size())?;
            let meter = meter(frame.wide(distances.level));
            let plateau = Plateau::of_clouds(frame, distances, &meter);
            let calibration = Calibration::Clouds { plateau: plateau.value() };
            let step_cells = facts.spacing_cells_or_one() / UNITS;
            Ok(MeasuredCalibration { calibration, plateau, step_cells })
        }
    }
}

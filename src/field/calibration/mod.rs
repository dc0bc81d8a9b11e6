//! Calibration: the numbers that a surface needs, measured on the frame unless they are given.
//!
//! The paper's indicators need two numbers: mu0 ([`indicate`]), which turns counts into the DIF,
//! and the isovalue, a fraction of the [`Plateau`] of the smoothed DIF ([`calibrate`]). Clouds need
//! only the plateau of wide cells. A [`Calibration`] holds these numbers. All frames of a
//! simulation use the calibration of one frame. A packed frame stores mu0; the other numbers depend
//! on filters that are chosen later.

mod expected;
mod histogram;
mod interior;
mod mean;
mod plateau;
mod precision;

pub use mean::{BinnedFrame, Fullness, NoMeanCount, indicate};
pub use plateau::Plateau;
pub(crate) use precision::check_finest;
pub use precision::{
    COARSEST_STEP, FINEST_OF_SYMMETRY, ON_CORNERS, Remedy, TooFine, check_cell_size_for,
};

use crate::brick::DifField;
use crate::field::distance::UNITS;
use crate::field::indicator::{IndicatorKind, SampledDif};
use crate::field::recipe::Filters;
use crate::grid::units::{Isovalue, MeanCount};
use crate::system::control::{Control, Stage};

/// The fraction of the progress of [`Stage::Meshing`] that a calibration accounts for.
pub const CALIBRATING: f64 = 0.1;

/// A calibration, measured or given. Frames with the same calibration have comparable surfaces.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Calibration {
    /// The calibration of an indicator of the paper.
    Indicator {
        /// `mu0`, if the indicator counts.
        mean: Option<MeanCount>,
        /// The isovalue: the value of the field on the surface.
        iso: Isovalue,
    },
    /// The calibration of clouds.
    Clouds {
        /// The sample deep in the fluid, smoothed with the narrowest width.
        plateau: u16,
    },
}

impl Calibration {
    /// `mu0`, if the indicator counts.
    #[must_use]
    pub fn mean(&self) -> Option<MeanCount> {
        match *self {
            Self::Indicator { mean, .. } => mean,
            Self::Clouds { .. } => None,
        }
    }

    /// Whether this calibration can be used for an indicator of `kind`. Clouds need
    /// [`Self::Clouds`]; the indicators of the paper need [`Self::Indicator`].
    #[must_use]
    pub fn suits(&self, kind: IndicatorKind) -> bool {
        matches!(self, Self::Clouds { .. }) == (kind == IndicatorKind::Cloud)
    }

    /// The isovalue of an indicator of the paper; `None` for clouds.
    #[must_use]
    pub fn iso(&self) -> Option<Isovalue> {
        match *self {
            Self::Indicator { iso, .. } => Some(iso),
            Self::Clouds { .. } => None,
        }
    }
}

/// A calibration that was measured on a frame, and the evidence for it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeasuredCalibration {
    /// The calibration, including given numbers.
    pub calibration: Calibration,
    /// The plateau of the field; it is measured even if the isovalue is given.
    pub plateau: Plateau,
    /// The distance, in cells, by which a flat surface moves if the field changes by 1, which is
    /// the smallest possible change because the field is stored as integers.
    pub step_cells: f64,
}

impl MeasuredCalibration {
    /// Particles per cubed spacing deep in the fluid, computed from the plateau of clouds.
    /// `spacing` is in cells.
    #[must_use]
    pub fn density(&self, spacing: f64) -> f64 {
        f64::from(self.plateau.value()) / Plateau::nominal(spacing)
    }
}

/// Measures the numbers that the surface of a frame needs, except an isovalue that is given.
/// Reports progress to `control`. After a cancel, the result is meaningless.
///
/// # Errors
/// [`TooFine`] if the field does not locate the surface precisely enough.
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
            precision::check_symmetry(
                frame.indicator.kind(),
                facts.spacing_cells(),
                facts.grid.cell_size(),
            )?;
            let plateau = Plateau::of(frame, smoothing, &meter(&frame.dif));
            let step_cells = precision::check_cell_size(frame, smoothing, plateau)?;
            let iso = iso.unwrap_or(plateau.isovalue());
            let calibration = Calibration::Indicator { mean: frame.indicator.mean(), iso };
            Ok(MeasuredCalibration { calibration, plateau, step_cells })
        }
        Filters::Distances(distances) => {
            check_finest(facts.spacing_cells(), facts.grid.cell_size())?;
            let meter = meter(frame.wide(distances.level));
            let plateau = Plateau::of_clouds(frame, distances, &meter);
            let calibration = Calibration::Clouds { plateau: plateau.value() };
            let step_cells = facts.spacing_cells_or_one() / UNITS;
            Ok(MeasuredCalibration { calibration, plateau, step_cells })
        }
    }
}

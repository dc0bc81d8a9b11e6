//! From a sampled frame to its surface, simplified if it is to be, with whatever there is to know of it.

use crate::error::Error;
use crate::field::calibration::Calibration;
use crate::frame::{Frame as Engine, FrameError, Shortfall};
use crate::surface::mesh::Mesh;
use crate::surface::mesh::source::MeshSource;
use crate::surface::simplify::Simplified;
use crate::surface::stitch::Stitched;
use crate::system::control::Stage;
use crate::system::timings::Timings;

use super::SinglePrecision;
use super::checked::Checked;
use super::report::Report;
use super::warning::{Warning, lost_warning, of_isovalue};

/// A surface that was drawn, but for the threads that it was made by.
pub(crate) struct Drawn {
    pub(crate) mesh: Kept,
    pub(crate) precision: SinglePrecision,
    pub(crate) report: Report,
}

/// A mesh as it is kept: in memory, or in scratch files as far as it exceeds its share of that.
pub(crate) enum Kept {
    /// The mesh of a frame that has no surface.
    Empty(Mesh),
    Whole(Stitched),
    Reduced(Simplified),
}

impl Kept {
    /// The mesh, piece by piece.
    pub(crate) fn source(&self) -> &dyn MeshSource {
        match self {
            Self::Empty(mesh) => mesh,
            Self::Whole(mesh) => mesh,
            Self::Reduced(mesh) => mesh,
        }
    }
}

impl Checked {
    /// Draws the surface of a frame, by a calibration that is known or measured on it, and leaves out what is to be.
    pub(crate) fn draw(
        &self,
        engine: &Engine,
        known: Option<&Calibration>,
        timings: &mut Timings,
    ) -> Result<Drawn, Error> {
        let (surface, mut report) = self.draw_whole(engine, known, timings)?;
        let precision = SinglePrecision::of(&surface);
        let mesh = self.reduce(engine, surface, &mut report, timings)?;
        Ok(Drawn { mesh, precision, report })
    }

    /// Draws the whole surface of a frame.
    pub(crate) fn draw_whole(
        &self,
        engine: &Engine,
        known: Option<&Calibration>,
        timings: &mut Timings,
    ) -> Result<(Stitched, Report), FrameError> {
        let control = &self.resources.control;
        control.during(Stage::Meshing, || {
            let calibrated = engine.calibrate(&self.surfacing, known, timings)?.heard_by(control);
            let measured = calibrated.measured();
            let surface = calibrated.surface(timings)?;
            let mut report = Report::of(engine, &self.surfacing);
            report.measured = measured;
            let by = known.copied().or(measured.map(|measured| measured.calibration));
            report.calibration = by.filter(|_| report.indicator.is_some());
            report.on_device = engine.on_device();
            report.lost = engine.lost(&surface)?;
            self.judge(&mut report, &surface, engine.shortfall(&surface)?);
            Ok((surface, report))
        })
    }

    /// Adds to a report what there is to doubt of a surface, of which it says already how many particles are in none.
    pub(super) fn judge(&self, report: &mut Report, surface: &Stitched, shortfall: Option<Shortfall>) {
        let doubt = report.measured.and_then(|measured| of_isovalue(&measured, self.surfacing.iso));
        report.warnings.extend(doubt);
        let clouds = report.is_clouds();
        let smoothed = report.indicator.is_some() && !clouds;
        report.warnings.extend(lost_warning(report.lost, report.facts.census.binned, smoothed));
        let warning = |shortfall| Warning::Shortfall { shortfall, clouds, measured_on: None };
        report.warnings.extend(shortfall.map(warning));
        report.whole_triangles = surface.triangle_count();
    }

    /// Simplifies a surface, and leaves out components, as far as that was asked for.
    pub(crate) fn reduce(
        &self,
        engine: &Engine,
        surface: Stitched,
        report: &mut Report,
        timings: &mut Timings,
    ) -> Result<Kept, FrameError> {
        if self.reduction.is_none() {
            return Ok(Kept::Whole(surface));
        }
        let simplified = engine.simplify(surface, &self.reduction, &self.resources.control, timings)?;
        report.too_small = Some(simplified.too_small());
        Ok(Kept::Reduced(simplified))
    }
}

impl From<FrameError> for Error {
    fn from(fault: FrameError) -> Self {
        match fault {
            FrameError::Cancelled => Self::Cancelled,
            fault => Self::Frame { path: None, fault },
        }
    }
}

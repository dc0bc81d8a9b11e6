//! Makes the surface of a sampled frame, simplifies it if requested, and collects its report and
//! warnings.

use crate::error::Error;
use crate::field::calibration::{Calibration, MeasuredCalibration};
use crate::frame::{Engine, FrameError, Normals, Shortfall};
use crate::grid::Grid;
use crate::particles::AttributeInfo;
use crate::surface::mesh::source::{EmptyMesh, Lattice, MeshSource};
use crate::surface::mesh::{Mesh, VertexAttribute};
use crate::surface::simplify::SimplifiedSurface;
use crate::surface::stitch::StitchedSurface;
use crate::system::control::Stage;
use crate::system::timings::Timings;

use super::SinglePrecision;
use super::checked::CheckedRequest;
use super::report::Report;
use super::warning::{EmptyReason, Warning, isovalue_warning, lost_warning};

/// A surface, without the threads that made it.
pub(crate) struct ExtractedSurface {
    pub(crate) mesh: ExtractedMesh,
    pub(crate) precision: SinglePrecision,
    pub(crate) report: Report,
}

/// Measurements on a whole surface and its frame.
pub(crate) struct Findings {
    /// The calibration of the surface, given or measured.
    pub(crate) calibration: Option<Calibration>,
    /// The values measured for the calibration; `None` if the caller supplied the calibration.
    pub(crate) measured: Option<MeasuredCalibration>,
    /// Lower bound on the number of particles outside the surface.
    pub(crate) lost: u64,
    pub(crate) shortfall: Option<Shortfall>,
}

/// A mesh in memory, or in scratch files if it exceeds the memory that is planned for it.
pub(crate) enum ExtractedMesh {
    /// The mesh of a frame that has no surface.
    Empty(EmptyMesh),
    Whole(StitchedSurface),
    Reduced(SimplifiedSurface),
}

impl ExtractedMesh {
    /// The mesh, piece by piece.
    pub(crate) fn source(&self) -> &dyn MeshSource {
        match self {
            Self::Empty(mesh) => mesh,
            Self::Whole(mesh) => mesh,
            Self::Reduced(mesh) => mesh,
        }
    }
}

impl CheckedRequest {
    /// Makes the surface of a frame with the calibration `known`, or with a calibration that is
    /// measured on this frame if `known` is `None`. Then simplifies the surface and removes small
    /// components, if requested.
    pub(crate) fn extract(
        &self,
        engine: &Engine,
        known: Option<&Calibration>,
        timings: &mut Timings,
    ) -> Result<ExtractedSurface, Error> {
        let (surface, report) = self.extract_whole(engine, known, timings)?;
        Ok(self.reduce_of(engine, surface, report, timings)?)
    }

    /// Works like [`extract`](Self::extract), for one of many frames. A frame without a surface
    /// gives an empty mesh with the attributes `infos`, and a warning with the reason.
    /// `calibration_frame` is the frame on which the calibration was measured.
    pub(crate) fn extract_or_empty(
        &self,
        engine: &Engine,
        known: Option<&Calibration>,
        infos: Vec<AttributeInfo>,
        calibration_frame: Option<i64>,
        timings: &mut Timings,
    ) -> Result<ExtractedSurface, FrameError> {
        let extracted = self.extract_whole(engine, known, timings).and_then(|(surface, report)| {
            let whole = report.clone();
            match self.reduce_of(engine, surface, report, timings) {
                Err(FrameError::NothingLeft(all)) => {
                    let report = Report { too_small: Some(all), ..whole };
                    Ok(self.empty(
                        report,
                        EmptyReason::TooSmall(all),
                        (infos.clone(), engine.facts().grid),
                        calibration_frame,
                    ))
                }
                extracted => extracted,
            }
        });
        match extracted {
            Err(fault) => {
                let why = EmptyReason::of(&fault).ok_or(fault)?;
                let mut report = Report::of(engine, &self.surfacing);
                report.calibration = known.copied().filter(|_| report.indicator.is_some());
                report.lost = engine.facts().census.binned as u64;
                Ok(self.empty(report, why, (infos, engine.facts().grid), calibration_frame))
            }
            extracted => extracted,
        }
    }

    /// The empty mesh of a frame without a surface, with a warning that gives the reason.
    fn empty(
        &self,
        mut report: Report,
        why: EmptyReason,
        (infos, grid): (Vec<AttributeInfo>, Grid),
        calibration_frame: Option<i64>,
    ) -> ExtractedSurface {
        let clouds = report.is_clouds();
        report.warnings.push(Warning::Empty { why, clouds, calibration_frame });
        ExtractedSurface {
            mesh: self.empty_mesh(infos, grid),
            precision: SinglePrecision::Enough,
            report,
        }
    }

    /// An empty mesh on `grid` that has the attributes `infos`, and normals if they are requested.
    pub(crate) fn empty_mesh(&self, infos: Vec<AttributeInfo>, grid: Grid) -> ExtractedMesh {
        let mesh = Mesh {
            normals: (self.surfacing.normals == Normals::Gradient).then(Vec::new),
            attributes: infos.into_iter().map(VertexAttribute::without_values).collect(),
            ..Mesh::default()
        };
        ExtractedMesh::Empty(EmptyMesh { mesh, lattice: Lattice::of(grid) })
    }

    /// Extracts the whole surface of a frame.
    fn extract_whole(
        &self,
        engine: &Engine,
        known: Option<&Calibration>,
        timings: &mut Timings,
    ) -> Result<(StitchedSurface, Report), FrameError> {
        let control = &self.resources.control;
        control.during(Stage::Meshing, || {
            let calibrated = engine.calibrate_for(&self.surfacing, known, control, timings)?;
            let measured = calibrated.measured();
            let surface = calibrated.surface(timings)?;
            let found = Findings {
                calibration: known.copied().or(measured.map(|measured| measured.calibration)),
                measured,
                lost: engine.lost(&surface)?,
                shortfall: engine.shortfall(&surface)?,
            };
            let mut report = Report::of(engine, &self.surfacing);
            report.on_device = engine.on_device();
            self.add_findings(&mut report, &surface, found);
            Ok((surface, report))
        })
    }

    /// Adds the findings about a surface to its report, with the warnings that follow from them.
    pub(super) fn add_findings(
        &self,
        report: &mut Report,
        surface: &StitchedSurface,
        found: Findings,
    ) {
        let Findings { calibration, measured, lost, shortfall } = found;
        report.calibration = calibration.filter(|_| report.indicator.is_some());
        (report.measured, report.lost) = (measured, lost);
        let bubbles = measured.and_then(|measured| isovalue_warning(&measured, self.surfacing.iso));
        report.warnings.extend(bubbles);
        report.warnings.extend(self.solid_warnings(&report.facts));
        let clouds = report.is_clouds();
        let smoothed = report.indicator.is_some() && !clouds;
        report.warnings.extend(lost_warning(lost, report.facts.census.binned, smoothed));
        let warning = |shortfall| Warning::Shortfall { shortfall, clouds, calibration_frame: None };
        report.warnings.extend(shortfall.map(warning));
        report.whole_triangles = surface.triangle_count();
    }

    fn reduce_of(
        &self,
        engine: &Engine,
        surface: StitchedSurface,
        report: Report,
        timings: &mut Timings,
    ) -> Result<ExtractedSurface, FrameError> {
        let control = &self.resources.control;
        self.reduce(surface, report, |surface| {
            engine.simplify(surface, &self.reduction, control, timings)
        })
    }

    /// Simplifies a surface and removes small components, if requested.
    pub(crate) fn reduce(
        &self,
        surface: StitchedSurface,
        mut report: Report,
        simplify: impl FnOnce(StitchedSurface) -> Result<SimplifiedSurface, FrameError>,
    ) -> Result<ExtractedSurface, FrameError> {
        let precision = SinglePrecision::of(&surface);
        if self.reduction.is_none() {
            return Ok(ExtractedSurface { mesh: ExtractedMesh::Whole(surface), precision, report });
        }
        let simplified = simplify(surface)?;
        report.too_small = Some(simplified.too_small());
        Ok(ExtractedSurface { mesh: ExtractedMesh::Reduced(simplified), precision, report })
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

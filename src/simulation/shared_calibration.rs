//! Grid and calibration that all frames of a simulation share.

use serde::{Deserialize, Serialize};

use crate::brick::FrameFacts;
use crate::error::Error;
use crate::field::calibration::{Calibration, MeasuredCalibration, Plateau, TooFine};
use crate::field::indicator::{IndicatorKind, SampledDif};
use crate::frame::{Engine, FrameError, Method, Resources, Sampling, Surfacing};
use crate::grid::Grid;
use crate::grid::units::UnitError;
use crate::io::mnf::PackedFrame;
pub use crate::io::stamp::Stamp;
use crate::particles::Particles;
use crate::particles::kind::SettledKind;
use crate::particles::sizes::Sizes;
use crate::reconstruction::{
    Cells, CheckedRequest, FoundWalls, Slab, as_numbers, moved, origin_for_lattice,
};
use crate::system::timings::Timings;

use super::frame_file::FrameFile;

/// Measurements that are made on one frame and shared by all frames.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SharedCalibration {
    /// The number of the calibration frame.
    pub frame: i64,
    /// The stamp of that frame's file.
    pub input: Stamp,
    /// Distance between neighbouring particles, if known.
    pub spacing: Option<f64>,
    /// Source of the spacing, as text.
    pub spacing_source: Option<String>,
    /// Edge length of a cell.
    pub cell_size: f64,
    /// Origin of the grid.
    pub origin: [f64; 3],
    /// The slab that is meshed if all particles lie in a plane.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub slab: Option<Slab>,
    /// The sizes of the particles, if there are several.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sizes: Option<Sizes>,
    /// The walls of the tank, if the request searches for walls.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub walls: Option<FoundWalls>,
    /// The calibration; `None` for kernel methods.
    #[serde(flatten, with = "as_numbers")]
    pub calibration: Option<Calibration>,
    /// The kinds of the vertex attributes, such as colours.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub kinds: Vec<SettledKind>,
}

/// Maximum relative difference between the cells of a packed frame and those of the calibration
/// frame. A difference of 5% between the cells changes the volume of the surface by about 5%. The
/// estimated spacings of similar frames differ by less than this maximum.
const SAME_CELLS: f64 = 0.05;

impl SharedCalibration {
    /// Rejects a packed frame whose cells or spacing differ from those of the calibration frame. If
    /// particles have several sizes, accepts every frame, because the spacing is then the smallest
    /// size, which may differ between frames.
    pub(super) fn check_cells(&self, facts: &FrameFacts) -> Result<(), FrameError> {
        if self.sizes.is_some() {
            return Ok(());
        }
        let own = [facts.grid.cell_size(), facts.spacing.unwrap_or_default()];
        let calibrated = [self.cell_size, self.spacing.unwrap_or_default()];
        // A spacing of 0 stands for an unknown spacing.
        let differs = |(own, calibrated): (f64, f64)| {
            own > 0.0 && calibrated > 0.0 && (own - calibrated).abs() > SAME_CELLS * calibrated
        };
        if own.into_iter().zip(calibrated).any(differs) {
            return Err(FrameError::OtherCells { own, calibrated });
        }
        Ok(())
    }
}

/// Whether the grid may be moved to suit the particles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// The grid may move by up to half a cell.
    Free,
    /// The grid keeps its given origin.
    Given,
}

/// Measurements that are made on one frame and hold for all frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameMeasurements {
    /// The grid for all frames.
    pub grid: Grid,
    /// The measured or given calibration; `None` for kernel methods.
    pub calibration: Option<Calibration>,
    /// How well the calibration frame represents the other frames.
    pub trust: Trust,
}

/// How well a calibration frame represents the other frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Trust {
    /// Almost no fluid is deeper than the reach of the filters.
    Shallow,
    /// The particles are on a lattice, where all counts are equal, unlike in later frames.
    Lattice,
    /// The frame represents all others.
    Sound,
}

/// Calibrates a simulation on `particles`, with the chosen `cells`. If `lattice` is given, it
/// replaces the grid of `cells` and the method of the request. It holds the grid and the method of
/// an earlier frame whose particles form a lattice.
pub(super) fn measure_in(
    cells: &Cells,
    lattice: Option<(Grid, Method)>,
    particles: &dyn Particles,
    checked: &CheckedRequest,
    resources: Resources,
) -> Result<FrameMeasurements, Error> {
    let request = &checked.sampling;
    let (grid, method) = match lattice {
        Some(known) => known,
        None => (request.grid_of(cells)?, request.method),
    };
    let in_slab = request.in_walls(cells.found()).in_slab(cells.slab);
    let sampling = in_slab.sampling_on(grid, method, cells.lengths(), Vec::new(), resources)?;
    let sampling = sampling.sized(cells.sizes.as_ref(), particles)?;
    let is_settled = lattice.is_some() || request.origin.is_some();
    let origin = if is_settled { Origin::Given } else { Origin::Free };
    Ok(measure(particles, &sampling, origin, &checked.surfacing)?)
}

/// Measures a frame, to calibrate its simulation on it.
///
/// The particles of the first frame often form a lattice in a special position relative to the
/// grid. Such a frame is measured on a moved grid, on which it is sampled like disordered fluid. If
/// the origin is free, all frames are sampled on the moved grid: see
/// [`lattice_origin`](crate::particles::lattice::lattice_origin). For the indicator symmetry, the
/// moved grid suffices. For counting, the isovalue must come from a disordered frame. The indicator
/// cloud does not depend on the position of the grid.
///
/// # Errors
/// [`FrameError::TooFine`], and the errors of [`Sampling::check_fit`] and of [`Engine::sample`].
pub fn measure(
    particles: &dyn Particles,
    sampling: &Sampling,
    origin: Origin,
    surfacing: &Surfacing,
) -> Result<FrameMeasurements, FrameError> {
    sampling.check_fit(surfacing)?;
    let given = sampling.grid;
    let lattice = origin_for_lattice(particles, sampling);
    let moved_sampling =
        lattice.and_then(|origin| moved(sampling, origin)).unwrap_or_else(|| sampling.clone());
    let grid = if origin == Origin::Free { moved_sampling.grid } else { given };
    let uncalibrated = FrameMeasurements { grid, calibration: None, trust: Trust::Sound };
    if moved_sampling.method.indicator().is_none() {
        return Ok(uncalibrated);
    }
    let frame = Engine::sample(
        particles,
        &Sampling { carried: Vec::new(), ..moved_sampling },
        &mut Timings::default(),
    )?;
    match frame.dif() {
        Some(sampled) => Ok(FrameMeasurements {
            grid,
            ..measure_sampled(sampled, surfacing, lattice.is_some())?
        }),
        None => {
            let measured = frame.calibrate(surfacing, None, &mut Timings::default())?.measured();
            Ok(measured.map_or(uncalibrated, |measured| measured_of(grid, &measured, false)))
        }
    }
}

/// Measures a sampled frame, to calibrate its simulation on it. `lattice` says whether the
/// frame's particles are on a lattice.
pub fn measure_sampled(
    frame: &SampledDif,
    surfacing: &Surfacing,
    lattice: bool,
) -> Result<FrameMeasurements, TooFine> {
    let lattice = lattice && frame.indicator.kind() == IndicatorKind::Counting;
    Ok(measured_of(frame.facts.grid, &surfacing.calibrate(frame)?, lattice))
}

/// Measures a packed frame, to calibrate its simulation on it.
pub(super) fn measure_packed(
    frame: &PackedFrame,
    surfacing: &Surfacing,
) -> Result<FrameMeasurements, TooFine> {
    match frame {
        PackedFrame::Dif(sampled) => measure_sampled(sampled, surfacing, false),
        PackedFrame::Octaves(sampled) => {
            Ok(measured_of(sampled.facts.grid, &sampled.calibrated(), false))
        }
    }
}

/// Adds the grid and the trust to a calibration. `lattice` says whether the particles of the
/// measured frame are on a lattice.
fn measured_of(grid: Grid, measured: &MeasuredCalibration, lattice: bool) -> FrameMeasurements {
    let trust = match measured.plateau {
        Plateau::Shallow { .. } => Trust::Shallow,
        Plateau::Interior { .. } if lattice => Trust::Lattice,
        Plateau::Interior { .. } => Trust::Sound,
    };
    FrameMeasurements { grid, calibration: Some(measured.calibration), trust }
}

impl SharedCalibration {
    /// Returns the calibration frame if its file exists and has changed since the frame was
    /// measured. If file names contain times, an unchanged calibration frame may have a different
    /// number now.
    pub(super) fn changed_in<'f>(&self, frames: &'f [FrameFile]) -> Option<&'f FrameFile> {
        let is_same = |frame: &FrameFile| frame.stamp().is_ok_and(|stamp| stamp == self.input);
        let measured = frames.iter().find(|frame| frame.number == self.frame)?;
        let changed = measured.stamp().is_ok() && !is_same(measured);
        let moved = || measured.time.is_some() && frames.iter().any(is_same);
        (changed && !moved()).then_some(measured)
    }

    /// The grid of all frames.
    ///
    /// # Errors
    /// [`UnitError`] for invalid numbers.
    pub fn grid(&self) -> Result<Grid, UnitError> {
        Grid::new(self.origin.into(), self.cell_size)
    }
}

//! Grid and calibration, measured once and the same for every frame.

use serde::{Deserialize, Serialize};

use crate::error::Error;
use crate::field::calibration::{Calibrated, Calibration, Plateau, TooFine};
use crate::field::indicator::{IndicatorKind, SampledDif};
use crate::frame::{Engine, FrameError, Method, Resources, Sampling, Surfacing};
use crate::grid::Grid;
use crate::grid::units::UnitError;
pub use crate::io::stamp::Stamp;
use crate::particles::Particles;
use crate::particles::kind::SettledKind;
use crate::particles::sizes::Sizes;
use crate::reconstruction::{
    Cells, Checked, FoundWalls, Slab, as_numbers, moved, origin_for_lattice,
};
use crate::system::timings::Timings;

use super::frame_file::FrameFile;

/// Measured on one frame, the same for all.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Frozen {
    /// The number of the frame that it was measured on.
    pub frame: i64,
    /// The stamp of that frame's file.
    pub input: Stamp,
    /// Distance between neighbouring particles, where it is known.
    pub spacing: Option<f64>,
    /// Where the spacing comes from, for people.
    pub spacing_source: Option<String>,
    /// Edge of a cell.
    pub cell_size: f64,
    /// Origin of the grid.
    pub origin: [f64; 3],
    /// The slab that particles in a plane stand for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub slab: Option<Slab>,
    /// The particles' sizes, where they have several.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sizes: Option<Sizes>,
    /// The walls of the tank, where they were to be found.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub walls: Option<FoundWalls>,
    /// Makes the frames alike; `None` for kernels, which have nothing to measure.
    #[serde(flatten, with = "as_numbers")]
    pub calibration: Option<Calibration>,
    /// The kinds of the attributes that go to the vertices.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub kinds: Vec<SettledKind>,
}

/// Whether the grid may be moved to suit the particles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// The grid may move by up to half a cell.
    Free,
    /// The grid stays where it was asked for.
    Given,
}

/// Measurements on one frame that hold for all.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measured {
    /// The grid for all frames.
    pub grid: Grid,
    /// Measured, or given; `None` for kernels, which have nothing to measure.
    pub calibration: Option<Calibration>,
    /// Whether a later frame would know better.
    pub trust: Trust,
}

/// How reliable a calibration frame is for the others.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Trust {
    /// Next to none of the fluid is deeper than the filters reach.
    Shallow,
    /// Counts on a lattice are all the same, as they will not be in disorder.
    Lattice,
    /// The frame is like all others.
    Sound,
}

/// Measures particles for their whole simulation, in cells that were chosen for them, or on the
/// grid and by the field of a `lattice` that came before.
pub(super) fn measure_in(
    cells: &Cells,
    lattice: Option<(Grid, Method)>,
    particles: &(impl Particles + ?Sized),
    checked: &Checked,
    resources: Resources,
) -> Result<Measured, Error> {
    let request = &checked.sampling;
    let (grid, method) = match lattice {
        Some(known) => known,
        None => (request.grid_of(cells)?, request.method),
    };
    let in_slab = request.in_walls(cells.found()).in_slab(cells.slab);
    let sampling = in_slab.sampling_on(grid, method, cells.spacing(), Vec::new(), resources)?;
    let sampling = sampling.sized(cells.sizes.as_ref(), particles)?;
    let is_settled = lattice.is_some() || request.origin.is_some();
    let origin = if is_settled { Origin::Given } else { Origin::Free };
    Ok(measure(particles, &sampling, origin, &checked.surfacing)?)
}

/// Measures a frame for its whole simulation.
///
/// A first frame often is a lattice, and one that falls on the grid in a way that no later frame
/// will. It is measured, and with a free origin all frames are sampled, on a grid that holds it as
/// it will hold the fluid in disorder: see
/// [`sound_origin`](crate::particles::lattice::sound_origin). That does for symmetry; for counting
/// the isovalue has to come from disorder. Clouds are the same wherever they fall.
///
/// # Errors
/// [`FrameError::TooFine`], and the errors of [`Sampling::refuse_unfit`] and of [`Engine::sample`].
pub fn measure(
    particles: &(impl Particles + ?Sized),
    sampling: &Sampling,
    origin: Origin,
    surfacing: &Surfacing,
) -> Result<Measured, FrameError> {
    sampling.refuse_unfit(surfacing)?;
    let given = sampling.grid;
    let lattice = origin_for_lattice(particles, sampling);
    let sound =
        lattice.and_then(|origin| moved(sampling, origin)).unwrap_or_else(|| sampling.clone());
    let grid = if origin == Origin::Free { sound.grid } else { given };
    let nothing = Measured { grid, calibration: None, trust: Trust::Sound };
    if sound.method.indicator().is_none() {
        return Ok(nothing);
    }
    let frame = Engine::sample(
        particles,
        &Sampling { carried: Vec::new(), ..sound },
        &mut Timings::default(),
    )?;
    match frame.dif() {
        Some(sampled) => {
            Ok(Measured { grid, ..measure_sampled(sampled, surfacing, lattice.is_some())? })
        }
        None => {
            let measured = frame.calibrate(surfacing, None, &mut Timings::default())?.measured();
            Ok(measured.map_or(nothing, |measured| measured_of(grid, &measured, false)))
        }
    }
}

/// Measures a sampled frame for its whole simulation, by whether its particles stand on a lattice.
pub fn measure_sampled(
    frame: &SampledDif,
    surfacing: &Surfacing,
    lattice: bool,
) -> Result<Measured, TooFine> {
    let lattice = lattice && frame.indicator.kind() == IndicatorKind::Counting;
    Ok(measured_of(frame.facts.grid, &surfacing.calibrate(frame)?, lattice))
}

/// A measurement on a grid, by whether counts on a lattice tell it.
fn measured_of(grid: Grid, measured: &Calibrated, lattice: bool) -> Measured {
    let trust = match measured.plateau {
        Plateau::Shallow { .. } => Trust::Shallow,
        Plateau::Interior { .. } if lattice => Trust::Lattice,
        Plateau::Interior { .. } => Trust::Sound,
    };
    Measured { grid, calibration: Some(measured.calibration), trust }
}

impl Frozen {
    /// The frame that was measured, if its file is there and has changed since. A frame at a time may
    /// have another number by now.
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
    /// [`UnitError`] for numbers that cannot have been measured.
    pub fn grid(&self) -> Result<Grid, UnitError> {
        Grid::new(self.origin.into(), self.cell_size)
    }
}

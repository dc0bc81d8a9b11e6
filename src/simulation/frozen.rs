//! Grid and calibration, measured once and the same for every frame.

use std::io;
use std::path::Path;
use std::time::UNIX_EPOCH;

use serde::{Deserialize, Serialize};

use crate::field::calibration::{Calibrated, Calibration, Plateau, TooFine};
use crate::field::indicator::{IndicatorKind, IndicatorRequest, SampledDif};
use crate::frame::{FieldRequest, Frame, FrameError, Sampling, Surfacing};
use crate::grid::Grid;
use crate::grid::units::UnitError;
use crate::io::frame_files::files_of;
use crate::particles::Particles;
use crate::reconstruction::{moved, origin_for_lattice};
use crate::system::timings::Timings;

/// A file's size and time, which tell an input from an earlier one of its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stamp {
    /// Bytes of the file.
    pub bytes: u64,
    /// When it was written, in nanoseconds.
    pub modified: u64,
}

impl Stamp {
    /// Takes the stamp of the file as it is now, with all frames that it may hold, and of all its pieces that are there.
    ///
    /// # Errors
    /// Where the system has none.
    pub fn of(path: &Path) -> io::Result<Self> {
        let mut all = Self { bytes: 0, modified: 0 };
        for file in files_of(path) {
            let metadata = file.metadata()?;
            let since = metadata.modified()?.duration_since(UNIX_EPOCH).unwrap_or_default();
            all.bytes += metadata.len();
            all.modified = all.modified.max(since.as_nanos() as u64);
        }
        Ok(all)
    }
}

/// Measured on one frame, the same for all.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Frozen {
    /// The number of the frame that it was measured on.
    pub frame: u64,
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
    /// Makes the frames alike; `None` for kernels, which have nothing to measure.
    #[serde(flatten, with = "as_numbers")]
    pub calibration: Option<Calibration>,
}

/// A calibration as the state file has it: mu0 where the indicator counts, and the isovalue as a fraction of 1; or the plateau
/// of clouds.
mod as_numbers {
    use serde::de::Error;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    use crate::field::calibration::Calibration;
    use crate::grid::units::{Isovalue, MeanCount, UnitError};

    #[derive(Serialize, Deserialize)]
    struct Numbers {
        mu0: Option<f64>,
        isovalue: Option<f64>,
        plateau: Option<u16>,
    }

    pub fn serialize<S: Serializer>(known: &Option<Calibration>, to: S) -> Result<S::Ok, S::Error> {
        let mu0 = known.and_then(|known| known.mean()).map(MeanCount::particles);
        let isovalue = known.and_then(|known| known.iso()).map(Isovalue::value);
        let plateau = match known {
            Some(Calibration::Clouds { plateau }) => Some(*plateau),
            _ => None,
        };
        Numbers { mu0, isovalue, plateau }.serialize(to)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Calibration>, D::Error> {
        let Numbers { mu0, isovalue, plateau } = Numbers::deserialize(from)?;
        let calibration = |iso| {
            let mean = mu0.map(MeanCount::new).transpose()?;
            Ok::<_, UnitError>(Calibration::Indicator { mean, iso: Isovalue::new(iso)? })
        };
        match (plateau, isovalue) {
            (Some(0), _) => Err(D::Error::custom("a plateau of 0")),
            (Some(plateau), None) => Ok(Some(Calibration::Clouds { plateau })),
            (Some(_), Some(_)) => Err(D::Error::custom("both a plateau and an isovalue")),
            (None, isovalue) => isovalue.map(calibration).transpose().map_err(D::Error::custom),
        }
    }
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

/// How much a frame can tell of those to come.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Trust {
    /// Next to none of the fluid is deeper than the filters reach.
    Shallow,
    /// Counts on a lattice are all the same, as they will not be in disorder.
    Lattice,
    /// The frame is like all others.
    Sound,
}

/// Measures a frame for its whole sequence.
///
/// A first frame often is a lattice, and one that falls on the grid in a way that no later frame will. It is
/// measured, and with a free origin all frames are sampled, on a grid that holds it as it will hold the fluid in
/// disorder: see [`sound_origin`](crate::particles::lattice::sound_origin). That does for symmetry; for counting the isovalue has to come from disorder. Clouds are
/// the same wherever they fall.
///
/// # Errors
/// [`FrameError::TooFine`], and the errors of [`Sampling::refuse_unfit`] and of [`Frame::sample`].
pub fn measure(
    particles: &(impl Particles + ?Sized),
    sampling: &Sampling,
    origin: Origin,
    surfacing: &Surfacing,
) -> Result<Measured, FrameError> {
    sampling.refuse_unfit(surfacing)?;
    let given = sampling.grid;
    let lattice = origin_for_lattice(particles, sampling);
    let sound = lattice.and_then(|origin| moved(sampling, origin)).unwrap_or_else(|| sampling.clone());
    let grid = if origin == Origin::Free { sound.grid } else { given };
    let nothing = Measured { grid, calibration: None, trust: Trust::Sound };
    if sound.field.indicator().is_none() {
        return Ok(nothing);
    }
    let frame =
        Frame::sample(particles, &Sampling { carried: Vec::new(), ..sound }, &mut Timings::default())?;
    match frame.dif() {
        Some(sampled) => Ok(Measured { grid, ..measure_sampled(sampled, surfacing, lattice.is_some())? }),
        None => Ok(nothing),
    }
}

/// Measures a sampled frame for its whole sequence, by whether its particles stand on a lattice.
///
/// # Errors
/// [`TooFine`].
pub fn measure_sampled(
    frame: &SampledDif,
    surfacing: &Surfacing,
    lattice: bool,
) -> Result<Measured, TooFine> {
    let Calibrated { calibration, plateau, .. } = surfacing.calibrate(frame)?;
    let trust = match (plateau, frame.indicator.kind()) {
        (Plateau::Shallow { .. }, _) => Trust::Shallow,
        (Plateau::Interior { .. }, IndicatorKind::Counting) if lattice => Trust::Lattice,
        (Plateau::Interior { .. }, _) => Trust::Sound,
    };
    Ok(Measured { grid: frame.facts.grid, calibration: Some(calibration), trust })
}

impl Frozen {
    /// The grid of all frames.
    ///
    /// # Errors
    /// [`UnitError`] for numbers that cannot have been measured.
    pub fn grid(&self) -> Result<Grid, UnitError> {
        Grid::new(self.origin.into(), self.cell_size)
    }

    /// The maker of the field of all frames: an indicator by the mu0 that was measured.
    #[must_use]
    pub fn field(&self, asked: FieldRequest) -> FieldRequest {
        known_field(asked, self.calibration.as_ref())
    }
}

/// The maker of a field by a calibration: an indicator has the mu0 that was measured.
#[must_use]
pub fn known_field(asked: FieldRequest, known: Option<&Calibration>) -> FieldRequest {
    match (asked, known) {
        (FieldRequest::Indicator(asked), Some(known)) => {
            FieldRequest::Indicator(IndicatorRequest { mean: known.mean(), ..asked })
        }
        _ => asked,
    }
}

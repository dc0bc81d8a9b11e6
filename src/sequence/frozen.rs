//! What is measured once and holds for every frame: mu0, the isovalue, and the grid.

use std::io;
use std::path::Path;
use std::time::UNIX_EPOCH;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::frame::{Frame, FrameError, Sampling, Surfacing};
use crate::grid::{Domain, Grid};
use crate::io::input::file_and_step;
use crate::laps::Laps;
use crate::lattice::sound_origin;
use crate::particles::Particles;
use crate::plateau::Plateau;
use crate::stage::indicator::Indicator;
use crate::units::{Isovalue, MeanCount, UnitError};

/// What tells an input from what it was before.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stamp {
    /// Its size.
    pub bytes: u64,
    /// When it was written, in nanoseconds.
    pub modified: u64,
}

impl Stamp {
    /// Of the file as it is now, with all frames that it may hold.
    ///
    /// # Errors
    /// Where the system has none.
    pub fn of(path: &Path) -> io::Result<Self> {
        let metadata = file_and_step(path).0.metadata()?;
        let since = metadata.modified()?.duration_since(UNIX_EPOCH).unwrap_or_default();
        Ok(Self { bytes: metadata.len(), modified: since.as_nanos() as u64 })
    }
}

/// Measured on one frame, the same for all.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Frozen {
    /// The number of the frame that it was measured on.
    pub frame: u64,
    /// That frame's file.
    pub input: Stamp,
    /// Of the particles, where it is known.
    pub spacing: Option<f64>,
    /// Where the spacing comes from, for people.
    pub spacing_source: Option<String>,
    /// Edge of a cell.
    pub cell_size: f64,
    /// Of the grid.
    pub origin: [f64; 3],
    /// Where the indicator counts.
    pub mu0: Option<f64>,
    /// As a fraction of 1, for DIFs.
    pub isovalue: Option<f64>,
}

/// Whether the grid may be moved to suit the particles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// As far as half a cell.
    Free,
    /// It was asked for where it is.
    Given,
}

/// What a frame says about all others.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measured {
    /// Of the grid for all frames.
    pub grid: Grid,
    /// Where the indicator counts.
    pub mean: Option<MeanCount>,
    /// Given, or a share of the plateau.
    pub iso: Isovalue,
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
    /// It is like all others.
    Sound,
}

/// Measures a frame for its whole sequence.
///
/// A first frame often is a lattice, and one that falls on the grid in a way that no later frame will. It is
/// measured, and with a free origin all frames are sampled, on a grid that holds it as it will hold the fluid in
/// disorder: see [`sound_origin`]. That does for symmetry; for counting the isovalue has to come from disorder. Clouds are
/// the same wherever they fall.
///
/// # Errors
/// Those of [`Frame::sample`], and [`FrameError::TooFine`].
pub fn measure(
    particles: &(impl Particles + ?Sized),
    sampling: &Sampling,
    origin: Origin,
    surfacing: &Surfacing,
) -> Result<Measured, FrameError> {
    surfacing.refuse_too_fine(sampling.indicator, sampling.spacing, &sampling.grid)?;
    let given = sampling.grid;
    let lattice = of_lattice(particles, sampling);
    let sound = lattice.and_then(|origin| moved(sampling, origin)).unwrap_or_else(|| sampling.clone());
    let frame =
        Frame::sample(particles, &Sampling { carried: Vec::new(), ..sound.clone() }, &mut Laps::default())?;
    let (recipe, plateau) = frame.recipe(surfacing)?;
    Ok(Measured {
        grid: if origin == Origin::Free { sound.grid } else { given },
        mean: frame.mean_count(),
        iso: recipe.iso,
        trust: match (plateau, sampling.indicator) {
            (Plateau::Shallow { .. }, _) => Trust::Shallow,
            (Plateau::Interior { .. }, Indicator::Counting { .. }) if lattice.is_some() => Trust::Lattice,
            (Plateau::Interior { .. }, _) => Trust::Sound,
        },
    })
}

/// The sampling of a frame on a grid that holds a lattice as it would hold the fluid in disorder, where its particles stand on
/// one and the indicator tells where that lies: see [`sound_origin`].
#[must_use]
pub fn on_sound_grid(particles: &(impl Particles + ?Sized), sampling: Sampling) -> Sampling {
    of_lattice(particles, &sampling).and_then(|origin| moved(&sampling, origin)).unwrap_or(sampling)
}

/// Where the grid should be for a lattice, if there is one and it matters.
fn of_lattice(particles: &(impl Particles + ?Sized), sampling: &Sampling) -> Option<DVec3> {
    match sampling.indicator {
        Indicator::Cloud { .. } => None,
        _ => sound_origin(particles, sampling.grid.origin(), sampling.grid.cell_size()),
    }
}

/// The same sampling on a grid with another origin; `None` where its walls have no cells.
fn moved(sampling: &Sampling, origin: DVec3) -> Option<Sampling> {
    let grid = Grid::new(origin, sampling.grid.cell_size()).ok()?;
    let domain = match &sampling.domain {
        None => None,
        Some(domain) => {
            let [lo, hi] = domain.walls();
            Some(Domain::new(&grid, lo, hi).ok()?)
        }
    };
    Some(Sampling { grid, domain, ..sampling.clone() })
}

impl Frozen {
    /// The grid of all frames.
    ///
    /// # Errors
    /// [`UnitError`] for numbers that cannot have been measured.
    pub fn grid(&self) -> Result<Grid, UnitError> {
        Grid::new(self.origin.into(), self.cell_size)
    }

    /// `indicator` with the mean count of all frames.
    ///
    /// # Errors
    /// [`UnitError`] for a number that cannot have been measured.
    pub fn indicator(&self, indicator: Indicator) -> Result<Indicator, UnitError> {
        Ok(indicator.with_mean(self.mu0.map(MeanCount::new).transpose()?))
    }

    /// The isovalue of all frames.
    ///
    /// # Errors
    /// [`UnitError`] for a number that cannot have been measured, or none.
    pub fn iso(&self) -> Result<Isovalue, UnitError> {
        Isovalue::new(self.isovalue.unwrap_or(f64::NAN))
    }
}

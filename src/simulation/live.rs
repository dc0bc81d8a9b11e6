//! Frames of a simulation that are never files: surfaces while it runs, all alike.

use std::sync::Arc;

use crate::error::Error;
use crate::field::calibration::Calibration;
use crate::frame::{Counted, FieldRequest, Frame};
use crate::grid::Grid;
use crate::io::UpAxis;
use crate::particles::Particles;
use crate::reconstruction::{self, Checked, Ready, Reconstruction, Surface};
use crate::system::control::Stage;
use crate::system::timings::Timings;

use super::frozen::{Measured, Origin, Trust, known_field, measure};

/// A simulation whose frames come from memory, one after the other.
///
/// Cells, grid and calibration are measured on the first frame with fluid deeper than the filters reach, for the counting indicator
/// also in disorder, and frozen: the frames from then on are alike. Until then [`is_settled`](Self::is_settled) is false, and each frame is measured anew
/// and drawn by what it says itself, such as single drops.
///
/// ```
/// use meniscus::{LiveSimulation, Reconstruction};
///
/// let steps = || (-6..=6).map(f64::from);
/// let lattice = steps().flat_map(|x| steps().flat_map(move |y| steps().map(move |z| [x, y, z])));
/// let mut water: Vec<[f64; 3]> = lattice.filter(|p| p.iter().map(|c| c * c).sum::<f64>() < 36.0).collect();
///
/// let mut simulation = LiveSimulation::new(&Reconstruction::new().spacing(1.0))?;
/// for _ in 0..2 {
///     let surface = simulation.frame(&water[..])?;
///     assert!(surface.mesh().triangle_count() > 0);
///     water.iter_mut().for_each(|p| p[1] -= 0.1);
/// }
/// # Ok::<(), meniscus::Error>(())
/// ```
#[derive(Debug)]
pub struct LiveSimulation {
    ready: Ready,
    known: Option<Known>,
    settled: bool,
}

/// Measurements that the frames share.
#[derive(Debug, Clone, Copy)]
struct Known {
    grid: Grid,
    field: FieldRequest,
    spacing: Option<f64>,
    calibration: Option<Calibration>,
    trust: Trust,
}

impl LiveSimulation {
    /// Starts threads for a simulation, of which nothing is known yet.
    ///
    /// # Errors
    /// [`Error::Unit`], [`Error::Unfit`], [`Error::Domain`], [`Error::LittleMemory`] and [`Error::Threads`].
    pub fn new(request: &Reconstruction) -> Result<Self, Error> {
        let checked = request.checked()?;
        checked.refuse_of_indicator()?;
        Ok(Self { ready: checked.on_threads()?, known: None, settled: false })
    }

    /// Whether all that frames have in common is frozen: cells, grid and calibration.
    #[must_use]
    pub fn is_settled(&self) -> bool {
        self.settled
    }

    /// Reconstructs the surface of the next frame, from particles that are borrowed.
    ///
    /// # Errors
    /// Those of [`Reconstruction::run`]; the next frame may do better.
    pub fn frame(&mut self, particles: &(impl Particles + ?Sized)) -> Result<Surface, Error> {
        let Self { ready, known, settled } = self;
        let threads = Arc::clone(&ready.threads);
        let drawn = threads.install(|| {
            let checked = &ready.checked;
            checked.go_on()?;
            let mut timings = Timings::default();
            if !*settled {
                let found = measured(ready, particles, known.as_ref())?;
                *settled = found.trust == Trust::Sound;
                *known = Some(found);
                timings.done("measure");
            }
            let Some(Known { grid, field, spacing, calibration, .. }) = *known else {
                return Err(Error::NoSpacing { path: None, particles: particles.len() });
            };
            let carried = checked.asked.carried(particles.attributes(), None)?;
            let resources = checked.resources.clone();
            let sampling = checked.sampling.sampling_on(grid, field, spacing, carried, resources)?;
            checked.resources.control.begins(Stage::Counting);
            let counted = Counted::for_surface(particles, &sampling, &checked.surfacing)?;
            checked.resources.control.ends(Stage::Counting);
            timings.done("count");
            let engine = Frame::sample_counted(counted, checked.resources.budget, &mut timings)?;
            let mut drawn = checked.draw(&engine, calibration.as_ref(), &mut timings)?;
            drawn.report.timings = timings;
            checked.go_on()?;
            Ok(drawn)
        })?;
        let Checked { asked, resources, .. } = &*ready.checked;
        let (asked, control) = (asked.clone(), resources.control.clone());
        Ok(Surface { drawn, threads, asked, control, particles_up: UpAxis::Y })
    }
}

/// Measures a frame for all, on the grid of a lattice that came before, if one did.
fn measured(
    ready: &Ready,
    particles: &(impl Particles + ?Sized),
    before: Option<&Known>,
) -> Result<Known, Error> {
    let checked = &ready.checked;
    let request = &checked.sampling;
    let lattice = before.filter(|known| known.trust == Trust::Lattice);
    let cells = request.cells(particles, reconstruction::Source::default())?;
    let (grid, field, spacing) = match lattice {
        Some(known) => (known.grid, known.field, known.spacing),
        None => (request.grid(cells.size)?, request.field, cells.spacing()),
    };
    let sampling =
        request.sampling_on(grid, field, cells.spacing(), Vec::new(), checked.resources.clone())?;
    let stays = if lattice.is_some() || request.origin.is_some() { Origin::Given } else { Origin::Free };
    let Measured { grid, calibration, trust } = measure(particles, &sampling, stays, &checked.surfacing)?;
    Ok(Known { grid, field: known_field(request.field, calibration.as_ref()), spacing, calibration, trust })
}

//! Makes surfaces of a running simulation in memory, without files, with one calibration.

use std::sync::Arc;

use crate::brick::{Census, FrameFacts};
use crate::error::{Error, NoEstimate};
use crate::field::calibration::Calibration;
use crate::frame::{FrameError, Method, Sampling};
use crate::grid::Grid;
use crate::io::UpAxis;
use crate::particles::Particles;
use crate::particles::alike::AlikeParticles;
use crate::particles::kind::{SettledKind, determine, known_of, settled_for_all};
use crate::particles::sizes::Sizes;
use crate::reconstruction::{
    self, ExtractedSurface, FoundWalls, Reconstruction, Report, SinglePrecision, Slab,
    SpacingWarning, StartedRequest, Surface, Warning, alpha_warnings, missing_attributes,
};
use crate::system::timings::Timings;

use super::shared_calibration::{FrameMeasurements, Trust, measure_in};

/// A simulation whose frames come from memory, in order.
///
/// Cells, grid and calibration are measured on the first frame with fluid deeper than the reach of
/// the filters, and kept for all later frames. With the indicator counting, this frame must also
/// have particles that do not form a lattice. Before this frame, [`is_settled`](Self::is_settled)
/// is false, and each frame is measured separately.
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
    started: StartedRequest,
    known: Option<KnownCalibration>,
    settled: bool,
}

/// The calibration that the frames share.
#[derive(Debug, Clone)]
struct KnownCalibration {
    kinds: Vec<SettledKind>,
    grid: Grid,
    method: Method,
    spacing: Option<f64>,
    slab: Option<Slab>,
    walls: Option<FoundWalls>,
    sizes: Option<Sizes>,
    calibration: Option<Calibration>,
    trust: Trust,
}

impl LiveSimulation {
    /// Starts a simulation and its threads.
    ///
    /// # Errors
    /// [`Error::Unit`], [`Error::SettingConflict`], [`Error::Domain`], [`Error::LittleMemory`] and
    /// [`Error::Threads`].
    pub fn new(request: &Reconstruction) -> Result<Self, Error> {
        let checked = request.checked()?;
        checked.check_indicator()?;
        Ok(Self { started: checked.on_threads()?, known: None, settled: false })
    }

    /// Whether cells, grid and calibration are fixed.
    #[must_use]
    pub fn is_settled(&self) -> bool {
        self.settled
    }

    /// Uses the cancel handle and the progress callback of another request for the next frames.
    ///
    /// ```
    /// use meniscus::{Cancel, LiveSimulation, Reconstruction};
    ///
    /// let request = Reconstruction::new().spacing(1.0);
    /// let mut simulation = LiveSimulation::new(&request)?;
    /// let cancel = Cancel::new();
    /// simulation.set_control(&request.cancel(cancel.clone()));
    /// cancel.cancel();
    /// assert!(simulation.frame(&[[0.0; 3]]).is_err());
    /// # Ok::<(), meniscus::Error>(())
    /// ```
    pub fn set_control(&mut self, request: &Reconstruction) {
        Arc::make_mut(&mut self.started.checked).resources.control = request.control.clone();
    }

    /// Reconstructs the surface of the next frame from borrowed particles.
    ///
    /// A frame without particles, or without a surface, gives an empty mesh.
    ///
    /// # Errors
    /// The errors of [`Reconstruction::run`], except those for missing particles or a missing
    /// surface. Later frames can still succeed.
    pub fn frame(&mut self, particles: &(impl Particles + ?Sized)) -> Result<Surface, Error> {
        self.frame_of(&particles)
    }

    fn frame_of(&mut self, particles: &dyn Particles) -> Result<Surface, Error> {
        let threads = Arc::clone(&self.started.threads);
        self.started.checked.check_cancelled()?;
        let extracted = threads.install(|| match self.started.checked.selected(particles)? {
            Some((selected, none)) => {
                let mut extracted = self.extracted_or_empty(&selected)?;
                extracted.report.warnings.extend(none.map(Warning::NoneSelected));
                Ok(extracted)
            }
            None => self.extracted_or_empty(particles),
        })?;
        Ok(Surface::new(extracted, &self.started.checked, &threads, UpAxis::Y))
    }

    /// Makes the surface of a frame, or an empty mesh for a frame without particles.
    fn extracted_or_empty(&mut self, particles: &dyn Particles) -> Result<ExtractedSurface, Error> {
        match self.extracted(particles) {
            Err(Error::Frame { fault: FrameError::NoParticles(census), .. }) => {
                self.empty(particles, self.facts(census)?)
            }
            extracted => extracted,
        }
    }

    fn extracted(&mut self, particles: &dyn Particles) -> Result<ExtractedSurface, Error> {
        let Self { started, known, settled } = self;
        let checked = &started.checked;
        let mut timings = Timings::default();
        let mut spacing_warnings = Vec::new();
        let is_measured = !*settled;
        if is_measured {
            let found;
            (found, spacing_warnings) = measured(started, particles, known.as_ref())?;
            *settled = found.trust == Trust::Sound;
            *known = Some(found);
            timings.done("measure");
        }
        let is_undetermined =
            |known: &&mut KnownCalibration| known.kinds.iter().any(|kind| !kind.is_evident);
        if let Some(known) =
            known.as_mut().filter(is_undetermined).filter(|_| !particles.is_empty())
        {
            let carried = checked.settings.carried(particles, None)?;
            determine(&mut known.kinds, settled_for_all(particles, &carried));
        }
        let Some(&KnownCalibration {
            grid,
            method,
            spacing,
            slab,
            walls: ref known_walls,
            ref sizes,
            calibration,
            ref kinds,
            ..
        }) = known.as_ref()
        else {
            let (particles, why) = (particles.len(), NoEstimate::TooFew);
            return Err(Error::NoSpacing { path: None, particles, why, suggested: None });
        };
        let carried = checked.settings.carried(particles, None)?;
        let particles =
            &AlikeParticles::of(particles, &carried, kinds).map_err(FrameError::from)?;
        let infos = known_of(particles, &carried, kinds);
        let missing = missing_attributes(&infos, kinds, None);
        let alpha = alpha_warnings(particles);
        let resources = checked.resources.clone();
        let request = &checked.sampling;
        if !is_measured {
            let known = (spacing, sizes.as_ref());
            spacing_warnings.extend(request.warning_of_sizes(known, particles)?);
        }
        let (request, crossed) =
            request.in_walls_around(known_walls.as_ref(), particles, spacing, &grid);
        let request = request.in_slab(slab.filter(|slab| slab.holds(particles)));
        let sampling =
            request.sampling_on(grid, method, (spacing, sizes.as_ref()), carried, resources)?;
        let sampling = sampling.sized(sizes.as_ref(), particles)?;
        let sampling = Sampling { kinds: kinds.clone(), ..sampling };
        let engine = checked.engine(particles, &sampling, None, &mut timings)?;
        let mut extracted =
            checked.extract_or_empty(&engine, calibration.as_ref(), infos, None, &mut timings)?;
        extracted.report.timings = timings;
        let crossed = crossed.into_iter().map(Warning::BeyondWall);
        let first =
            spacing_warnings.into_iter().map(Warning::Spacing).chain(crossed).chain(missing);
        let first = first.chain(alpha);
        extracted.report.warnings.splice(0..0, first);
        Ok(extracted)
    }

    /// Returns the facts of a frame without particles. Before the first frame with particles, the
    /// request determines the cell size if it sets a spacing. Otherwise, the cell size is 1.
    fn facts(&self, census: Census) -> Result<FrameFacts, Error> {
        let request = &self.started.checked.sampling;
        let (grid, spacing) = match &self.known {
            Some(known) => (known.grid, known.spacing),
            None => {
                let none: [[f64; 3]; 0] = [];
                let cells = request.cells(&none, reconstruction::SpacingHints::default());
                (request.grid(cells.map_or(1.0, |cells| cells.size))?, request.spacing)
            }
        };
        Ok(FrameFacts { grid, domain: None, periodic: None, census, spacing })
    }

    /// Returns the empty mesh of a frame without a surface, with the same attributes as other
    /// frames.
    fn empty(
        &self,
        particles: &dyn Particles,
        facts: FrameFacts,
    ) -> Result<ExtractedSurface, Error> {
        let checked = &self.started.checked;
        let carried = checked.settings.carried(particles, None)?;
        let kinds = self.known.as_ref().map_or(&[][..], |known| &known.kinds);
        let particles = AlikeParticles::of(particles, &carried, kinds).map_err(FrameError::from)?;
        let infos = known_of(&particles, &carried, kinds);
        let mesh = checked.empty_mesh(infos, facts.grid);
        let report =
            Report::of_facts(facts, None, &checked.surfacing, checked.resources.backend.name());
        Ok(ExtractedSurface { mesh, precision: SinglePrecision::Enough, report })
    }
}

/// Measures a frame, to calibrate all frames on it. If the particles of the previously measured
/// frame form a lattice, uses the grid, the method and the spacing of that frame. Also returns
/// warnings about the spacing.
fn measured(
    started: &StartedRequest,
    particles: &dyn Particles,
    before: Option<&KnownCalibration>,
) -> Result<(KnownCalibration, Vec<SpacingWarning>), Error> {
    let checked = &started.checked;
    let request = &checked.sampling;
    let lattice = before.filter(|known| known.trust == Trust::Lattice);
    let cells = request.cells(particles, reconstruction::SpacingHints::default())?;
    let known = lattice.map(|known| (known.grid, known.method));
    let measured = measure_in(&cells, known, particles, checked, checked.resources.clone())?;
    let FrameMeasurements { grid, calibration, trust } = measured;
    let (slab, spacing) = (cells.slab, lattice.map_or(cells.spacing(), |known| known.spacing));
    let method = request.method.calibrated(calibration.as_ref());
    let carried = checked.settings.carried(particles, None)?;
    let kinds = settled_for_all(particles, &carried);
    let reconstruction::Cells { sizes, warnings, walls, .. } = cells;
    Ok((
        KnownCalibration { kinds, grid, method, spacing, slab, walls, sizes, calibration, trust },
        warnings,
    ))
}

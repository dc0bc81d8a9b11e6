//! A sampled frame, which can be packed, and meshed repeatedly with different settings.

use std::path::PathBuf;
use std::sync::Arc;

use crate::brick::BinPlan;
use crate::error::{Conflict, Error, Setting, SettingConflict};
use crate::frame::{CountedFrame, Engine, FrameError, Sampling};
use crate::io::mnf::write_frame;
use crate::io::{UnreadPart, UpAxis};
use crate::particles::Particles;
use crate::particles::selection::{SelectedParticles, SelectionFault, select};
use crate::system::control::Stage;
use crate::system::timings::Timings;

use super::builder::Reconstruction;
use super::checked::{CheckedRequest, StartedRequest};
use super::output::PackedOutput;
use super::surface::Surface;
use super::warning::{Warning, of_frame, with_spacing_warnings};
use super::{Cells, ChosenSampling, PackReport, SpacingHints};
use crate::settings::{Settings, Where};

/// A sampled frame: its discrete indicator function, and the particle data that surfaces need.
#[derive(Debug)]
pub struct Frame {
    pub(super) path: Option<PathBuf>,
    pub(super) up: UpAxis,
    pub(super) request: StartedRequest,
    pub(super) sampled: FrameSamples,
    pub(super) timings: Timings,
}

/// The samples with their cells.
#[derive(Debug)]
pub(super) struct FrameSamples {
    pub(super) engine: Engine,
    pub(super) cells: Option<Cells>,
    pub(super) moved: bool,
    /// The unexpected parts of the file that were not read.
    pub(super) left_out: Vec<UnreadPart>,
}

impl StartedRequest {
    pub(super) fn sample(self, particles: &dyn Particles) -> Result<Frame, Error> {
        let selected = self.threads.install(|| self.checked.selected(particles))?;
        match selected {
            Some((_, Some(none))) => Err(none.into()),
            Some((selected, None)) => self.sample_all(&selected),
            None => self.sample_all(particles),
        }
    }

    fn sample_all(self, particles: &dyn Particles) -> Result<Frame, Error> {
        let checked = &self.checked;
        let mut timings = Timings::default();
        checked.check_indicator()?;
        let sampled = self.threads.install(|| {
            let choose = || checked.choose_and_plan(particles, SpacingHints::default());
            let chosen = checked.resources.control.during(Stage::Reading, choose)?;
            timings.done(chosen.stage());
            checked.sampled(particles, chosen, &mut timings)
        })?;
        Ok(Frame { path: None, up: UpAxis::Y, request: self, sampled, timings })
    }
}

impl CheckedRequest {
    /// The particles in memory that satisfy the conditions; `None` if the request has no
    /// conditions. If there are particles but none satisfies the conditions, also returns a fault
    /// that reports this.
    pub(crate) fn selected<'a>(
        &self,
        particles: &'a dyn Particles,
    ) -> Result<Option<(SelectedParticles<'a>, Option<SelectionFault>)>, Error> {
        let conditions = self.settings.conditions();
        if conditions.is_empty() {
            return Ok(None);
        }
        let sieve = select(particles, conditions.iter().flat_map(Where::conditions), || {
            self.check_cancelled().is_ok()
        })?;
        let selected = SelectedParticles::new(particles, sieve);
        let none = (selected.is_empty() && !particles.is_empty())
            .then(|| SelectionFault::none(particles, conditions));
        Ok(Some((selected, none)))
    }

    /// Samples `particles` with the `chosen` sampling.
    pub(super) fn sampled(
        &self,
        particles: &dyn Particles,
        chosen: ChosenSampling,
        timings: &mut Timings,
    ) -> Result<FrameSamples, Error> {
        let ChosenSampling { sampling, cells, moved, plan } = chosen;
        let engine = self.engine(particles, &sampling, plan, timings)?;
        Ok(FrameSamples { engine, cells: Some(cells), moved, left_out: Vec::new() })
    }

    /// Counts particles, unless `plan` already contains their counts, and samples their field.
    pub(crate) fn engine(
        &self,
        particles: &dyn Particles,
        sampling: &Sampling,
        plan: Option<BinPlan>,
        timings: &mut Timings,
    ) -> Result<Engine, FrameError> {
        let counted_now = plan.is_none();
        let count = || CountedFrame::for_surface(particles, sampling, &self.surfacing, plan);
        let counted = self.resources.control.during(Stage::Counting, count)?;
        if counted_now {
            timings.done("count");
        }
        Engine::sample_counted(counted, sampling.resources.budget, timings)
    }
}

impl Frame {
    /// Warnings about the frame, its spacing, its attributes, and the parts of its file that were
    /// not read.
    #[must_use]
    pub fn warnings(&self) -> Vec<Warning> {
        let cells = self.sampled.cells.as_ref();
        let of_engine = self
            .request
            .threads
            .install(|| with_spacing_warnings(cells, of_frame(&self.sampled.engine)));
        self.parts_left_out().chain(of_engine).collect()
    }

    fn parts_left_out(&self) -> impl Iterator<Item = Warning> {
        self.sampled.left_out.iter().cloned().map(Warning::LeftOut)
    }

    /// The axis that points up in the particles, as requested or as the file format implies.
    #[must_use]
    pub fn particles_up(&self) -> UpAxis {
        self.request.checked.settings.particles_up.unwrap_or(self.up)
    }

    /// Makes the surface that was requested when the particles were sampled.
    ///
    /// # Errors
    /// [`Error::Frame`] if there is no surface, or scratch files fail, and [`Error::Cancelled`].
    pub fn surface(&self) -> Result<Surface, Error> {
        self.extract(&self.request.checked, self.timings.clone())
    }

    /// Makes a surface with other settings, from smoothing to simplifying. Settings that need the
    /// particles cannot change.
    ///
    /// The surface uses the memory limit, the threads and the backend of the frame.
    ///
    /// # Errors
    /// [`Error::Unit`], [`Error::SettingConflict`], for example if a setting that needs the
    /// particles has changed, and the errors of [`surface`](Self::surface).
    pub fn surface_by(&self, request: &Reconstruction) -> Result<Surface, Error> {
        let mut checked = request.checked()?;
        let kind = self.sampled.engine.method().indicator();
        checked.settings.check_sampled(&Settings {
            indicator: kind,
            ..self.request.checked.settings.clone()
        })?;
        kind.map_or(Ok(()), |kind| checked.settings.check_indicator_settings(kind))?;
        checked.resources = self.request.checked.resources.clone();
        checked.resources.control = request.control.clone();
        self.extract(&Arc::new(checked), Timings::default())
    }

    fn extract(
        &self,
        checked: &Arc<CheckedRequest>,
        mut timings: Timings,
    ) -> Result<Surface, Error> {
        timings.skip();
        let threads = &self.request.threads;
        let extracted = threads.install(|| {
            let known = checked.calibration.as_ref();
            checked.extract(&self.sampled.engine, known, &mut timings)
        });
        let mut extracted = extracted.map_err(|error| match &self.path {
            Some(path) => error.of_file(path),
            None => error,
        })?;
        let report = &mut extracted.report;
        report.add_cells(self.sampled.cells.clone(), self.sampled.moved);
        report.warnings.splice(..0, self.parts_left_out());
        (report.timings, report.threads) = (timings, threads.current_num_threads());
        Ok(Surface::new(extracted, checked, threads, self.up))
    }

    /// Writes the frame's samples to a file, from which surfaces can be made later.
    ///
    /// # Errors
    /// [`Error::SettingConflict`] for kernel methods, which have no samples, [`Error::Write`] and
    /// [`Error::Cancelled`].
    pub fn pack(&self, output: PackedOutput) -> Result<PackReport, Error> {
        let StartedRequest { checked, threads } = &self.request;
        let Some(samples) = self.sampled.engine.packable() else {
            let (setting, with) = (Setting::named("method"), Conflict::Packing);
            return Err(SettingConflict { setting, with }.into());
        };
        let mut timings = self.timings.clone();
        timings.skip();
        let control = &checked.resources.control;
        let write = || output.write(control, |out| write_frame(out, samples).map(drop));
        let bytes = threads.install(write)?;
        timings.done("write");
        Ok(PackReport {
            bytes,
            cells: samples.volumes().iter().map(|(_, field)| field.full_cells()).sum(),
            bricks: samples.fields().iter().map(|(_, field)| field.bricks()).sum(),
            census: samples.facts().census,
            timings,
        })
    }
}

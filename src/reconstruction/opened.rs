//! An opened input.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use crate::error::Error;
use crate::field::indicator::IndicatorKind;
use crate::field::walls::GapAtWall;
use crate::frame::{Engine, FrameError};
use crate::io::input::open_joined;
use crate::io::mnf::{PackedFrame, is_packed, open_frame};
use crate::io::output::MeshFormat;
use crate::io::{ParticleFile, ReadError, UnreadPart};
use crate::particles::kind::settled;
use crate::particles::{MeteredParticles, Particles};
use crate::system::control::Stage;
use crate::system::timings::Timings;

use super::attributes::NoVelocity;
use super::checked::{CheckedRequest, StartedRequest};
use super::frame::{Frame, FrameSamples};
use super::{Cells, ChosenSampling, FoundWalls, Output, SamplingRequest, SpacingHints, WallSearch};

/// An opened input that is not sampled yet.
#[derive(Debug)]
pub struct OpenedFrame {
    path: PathBuf,
    pub(super) request: StartedRequest,
    pub(super) input: Input,
    /// Walls that meniscus found, if the settings neither set walls nor ask to find walls.
    hint: Option<FoundWalls>,
    gaps: Vec<GapAtWall>,
    pub(super) timings: Timings,
}

#[derive(Debug)]
pub(super) enum Input {
    Particles { file: Box<ParticleFile>, chosen: Box<ChosenSampling> },
    Packed(Box<PackedFrame>),
}

impl StartedRequest {
    /// Opens one file, or several as one frame.
    pub(super) fn open(self, paths: &[&Path]) -> Result<OpenedFrame, Error> {
        let path =
            *paths.first().ok_or_else(|| Error::Request("no input file; name one".into()))?;
        let checked = &self.checked;
        let mut timings = Timings::default();
        if let Some(packed) = paths.iter().filter(|_| paths.len() > 1).find(|path| is_packed(path))
        {
            let what = "packed frames cannot be joined; join their particle files instead";
            return Err(Error::Request(format!("{}: {what}", packed.display())));
        }
        let open = || {
            if let [path] = paths
                && is_packed(path)
            {
                checked.settings.check_packed(path)?;
                let scratch = Some(&*checked.resources.scratch);
                let packed = open_frame(path, checked.resources.budget.0 / 4, scratch)?;
                timings.done("open");
                checked.settings.check_indicator_settings(packed.indicator().kind())?;
                return Ok(Input::Packed(Box::new(packed)));
            }
            checked.check_indicator()?;
            let file = open_joined(paths, checked.wanted(), checked.unpacking())?;
            let file = file.require_selected().map_err(|fault| ReadError::new(path, fault))?;
            timings.done("open");
            let source = SpacingHints { path: Some(path), spacing: file.spacing };
            let chosen = checked.with_wall_search().choose_and_plan(&file.particles, source);
            let chosen =
                chosen.map_err(|error| error.of_file(path).with_skipped_part(&file.left_out))?;
            timings.done(chosen.stage());
            Ok::<_, Error>(Input::Particles { file: Box::new(file), chosen: Box::new(chosen) })
        };
        let control = &checked.resources.control;
        let mut input = self.threads.install(|| control.during(Stage::Reading, open))?;
        let (mut hint, mut gaps) = (None, Vec::new());
        if let Input::Particles { chosen, .. } = &mut input
            && checked.sampling.search != WallSearch::Walls
        {
            let found = chosen.cells.walls.take();
            match (checked.sampling.walls, &found) {
                (None, _) => hint = found,
                (Some(walls), Some(found)) => {
                    let spacing =
                        chosen.cells.spacing.as_ref().map_or(0.0, |(spacing, _)| *spacing);
                    gaps = found.gaps(walls, spacing);
                }
                (Some(_), None) => {}
            }
        }
        Ok(OpenedFrame { path: path.to_owned(), request: self, input, hint, gaps, timings })
    }
}

impl CheckedRequest {
    /// Returns the request, with [`WallSearch::Hint`] if it does not search for walls and has no
    /// periodic box. If the request sets a domain, the found walls show whether the fluid reaches
    /// the walls of the domain.
    fn with_wall_search(&self) -> Cow<'_, Self> {
        let request = &self.sampling;
        if request.search != WallSearch::Never || request.periodic.is_some() {
            return Cow::Borrowed(self);
        }
        let sampling = SamplingRequest { search: WallSearch::Hint, ..request.clone() };
        Cow::Owned(Self { sampling, ..self.clone() })
    }

    fn metered<'a>(&'a self, particles: &'a dyn Particles) -> MeteredParticles<'a> {
        let metered = MeteredParticles::new(particles, &self.resources.control, Stage::Reading);
        metered.readings(self.sampling.readings(particles.len()))
    }

    /// Returns an error if the work was cancelled.
    pub(crate) fn check_cancelled(&self) -> Result<(), Error> {
        Ok(self.resources.control.cancel.go_on()?)
    }

    /// Chooses how to sample particles, without counting them.
    pub(super) fn choose(
        &self,
        particles: &dyn Particles,
        source: SpacingHints<'_>,
    ) -> Result<ChosenSampling, Error> {
        let carried = self.settings.carried(particles, None)?;
        let particles = self.metered(particles);
        self.sampling.sampling(&particles, source, carried, self.resources.clone())
    }

    /// Chooses how to sample particles for [`sampled`](Self::sampled), and counts them at the same
    /// time if possible.
    pub(super) fn choose_and_plan(
        &self,
        particles: &dyn Particles,
        source: SpacingHints<'_>,
    ) -> Result<ChosenSampling, Error> {
        let carried = self.settings.carried(particles, None)?;
        let particles = self.metered(particles);
        self.sampling.sampling_and_plan(&particles, source, carried, self.resources.clone())
    }
}

impl OpenedFrame {
    /// The number of particles; for a packed frame, the number of particles from which it was made.
    #[must_use]
    pub fn particles(&self) -> usize {
        match &self.input {
            Input::Particles { file, .. } => file.particles.len(),
            Input::Packed(packed) => packed.facts().census.binned,
        }
    }

    /// The number of ghost particles, which are copies from other pieces and are left out.
    #[must_use]
    pub fn ghosts(&self) -> usize {
        match &self.input {
            Input::Particles { file, .. } => file.ghosts,
            Input::Packed(_) => 0,
        }
    }

    /// The number of particles that do not satisfy the conditions in the settings.
    #[must_use]
    pub fn unselected(&self) -> usize {
        match &self.input {
            Input::Particles { file, .. } => file.unselected,
            Input::Packed(_) => 0,
        }
    }

    /// Parts of the input that were not read.
    #[must_use]
    pub fn left_out(&self) -> &[UnreadPart] {
        match &self.input {
            Input::Particles { file, .. } => &file.left_out,
            Input::Packed(_) => &[],
        }
    }

    /// The name of the file format.
    #[must_use]
    pub fn format(&self) -> &str {
        match &self.input {
            Input::Particles { file, .. } => file.format,
            Input::Packed(_) => "packed frame",
        }
    }

    /// The names of the particle types in the input. The first is the type that is read. Empty for a
    /// packed frame, and if the input has a single type without a name.
    #[must_use]
    pub fn particle_types(&self) -> &[String] {
        match &self.input {
            Input::Particles { file, .. } => &file.particle_types,
            Input::Packed(_) => &[],
        }
    }

    /// The chosen cells; `None` for a packed frame, whose cells were chosen when it was packed.
    #[must_use]
    pub fn cells(&self) -> Option<&Cells> {
        match &self.input {
            Input::Particles { chosen, .. } => Some(&chosen.cells),
            Input::Packed(_) => None,
        }
    }

    /// The walls that were found, and whether the fluid ends at them: true if the request asks to
    /// find walls, false if the walls are only a hint. `None` if meniscus found no walls, if it
    /// did not search for walls, or if the request sets walls.
    #[must_use]
    pub fn walls(&self) -> Option<(&FoundWalls, bool)> {
        let requested = self.cells().and_then(|cells| cells.walls.as_ref());
        let hint = self.hint.as_ref().map(|walls| (walls, false));
        requested.map(|walls| (walls, true)).or(hint)
    }

    /// The walls of the domain that the fluid almost reaches, so that the surface there can be
    /// ragged.
    #[must_use]
    pub fn gaps_at_walls(&self) -> &[GapAtWall] {
        &self.gaps
    }

    /// The indicator; `None` for kernel methods.
    #[must_use]
    pub fn indicator(&self) -> Option<IndicatorKind> {
        match &self.input {
            Input::Particles { chosen, .. } => chosen.sampling.method.indicator(),
            Input::Packed(packed) => Some(packed.indicator().kind()),
        }
    }

    /// The origin to which the grid was moved because all particles are on a lattice.
    #[must_use]
    pub fn moved_to(&self) -> Option<[f64; 3]> {
        match &self.input {
            Input::Particles { chosen, .. } => {
                chosen.moved.then(|| chosen.sampling.grid.origin().to_array())
            }
            Input::Packed(_) => None,
        }
    }

    /// The attributes of the input, if a mesh in `format` would have a velocity by default, but none
    /// of the attributes is a velocity.
    #[must_use]
    pub fn no_velocity(&self, format: MeshFormat) -> Option<NoVelocity> {
        match &self.input {
            Input::Particles { file, .. } => {
                self.request.checked.settings.no_velocity(file, Some(format))
            }
            Input::Packed(_) => None,
        }
    }

    /// Checks, before the particles are sampled, that the format of `output` can store the
    /// attributes that the settings name. This check may read the values of these attributes,
    /// because whether integers can be stored as a colour depends on their values.
    ///
    /// # Errors
    /// [`Error::SettingConflict`], and [`Error::Frame`] for values that a mesh cannot store.
    pub fn check_output(&self, output: &Output) -> Result<(), Error> {
        let StartedRequest { checked, threads } = &self.request;
        let attributes = || match &self.input {
            Input::Packed(_) => Ok(Vec::new()),
            Input::Particles { file, chosen } => {
                let settle = || settled(&file.particles, &chosen.sampling.carried, &[]);
                threads.install(settle).map_err(|fault| self.in_file(fault.into()))
            }
        };
        checked.settings.check_attributes(output.path(), output.format(), attributes)
    }

    pub(super) fn in_file(&self, fault: FrameError) -> Error {
        Error::from(fault).of_file(&self.path)
    }

    /// Samples the particles. Several surfaces can be made from the result.
    ///
    /// # Errors
    /// [`Error::Frame`] for particles that cannot be placed on the grid or do not fit into the
    /// memory limit, and [`Error::Cancelled`].
    pub fn sample(self) -> Result<Frame, Error> {
        let Self { path, request, input, mut timings, .. } = self;
        let checked = &request.checked;
        let up = checked.settings.usual_up(&path);
        let sampled = request.threads.install(|| match input {
            Input::Packed(packed) => {
                let engine =
                    Engine::from_packed(*packed, &checked.surfacing, checked.resources.clone());
                Ok(FrameSamples { engine, cells: None, moved: false, left_out: Vec::new() })
            }
            Input::Particles { file, chosen } => {
                let sampled = checked.sampled(&file.particles, *chosen, &mut timings)?;
                let left_out = file.left_out.into_iter().filter(UnreadPart::is_unexpected);
                Ok::<_, Error>(FrameSamples { left_out: left_out.collect(), ..sampled })
            }
        });
        let sampled = sampled.map_err(|error| error.of_file(&path))?;
        Ok(Frame { path: Some(path), up, request, sampled, timings })
    }
}

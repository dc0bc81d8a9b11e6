//! One frame on its way: read and counted beside others, meshed beside them too where it fits, else
//! alone.

use std::mem::take;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

use super::conversion::{Conversion, Settled};
use super::event::{Event, LeftOut};
use super::frame_file::FrameFile;
use super::frozen::{Frozen, Stamp};
use super::gate::Permit;
use super::records::{Record, Records};
use super::small_meshes::SmallMeshes;
use crate::error::Error;
use crate::frame::{Counted, Engine, FrameError, Resources};
use crate::grid::units::MemoryBudget;
use crate::io::bytes::Unpacking;
use crate::io::input::file_and_step;
use crate::io::mnf::{is_packed, open_frame};
use crate::io::series::SeriesFrame;
use crate::io::whole::{FilledFile, Replace};
use crate::io::{ParticleFile, ReadError, ReadFault, WriteError, WriteFault};
use crate::particles::kind::known_of;
use crate::particles::{AttributeInfo, Particles, carried_infos};
use crate::reconstruction::{
    Checked, Doubt, Drawn, Held, Orientation, Output, Report, SinglePrecision, SpacingSource,
    Warning, coordinate_width, made_of, refuse_same_file,
};
use crate::surface::mesh::Mesh;
use crate::surface::mesh::source::Bounded;
use crate::system::control::Stage;
use crate::system::timings::Timings;

/// A frame that was converted.
pub(super) struct Done {
    pub(super) mesh: SeriesFrame,
    pub(super) time: Option<f64>,
    pub(super) report: Option<Report>,
    pub(super) left_out: LeftOut,
    pub(super) warnings: Vec<Warning>,
    pub(super) seconds: f64,
}

/// A frame whose mesh is written, but not known to be on disk.
pub(super) struct Filled {
    file: FilledFile,
    held: Held,
    target: PathBuf,
    replaces: Replaces,
    record: Record,
    /// For the sheet, if one is drawn of a format that is not read again.
    small: Option<Mesh>,
    done: Done,
}

/// The files whose place a mesh may take.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Replaces {
    Nothing,
    /// Meshes that this conversion made.
    Own,
    Anything,
}

/// A frame that was opened, and the output that waits for its mesh.
pub(super) struct Opened {
    input: Stamp,
    target: PathBuf,
    replaces: Replaces,
    orientation: Orientation,
    output: Output,
    /// `None` where it was sampled before.
    particles: Option<ParticleFile>,
    timings: Timings,
}

/// A frame that waits to be meshed.
struct Ready<'a> {
    /// `None` where there are no particles.
    frame: Option<Engine>,
    left_out: LeftOut,
    /// Doubts about the input.
    warnings: Vec<Warning>,
    /// The attributes of its vertices.
    infos: Vec<AttributeInfo>,
    time: Option<f64>,
    permit: Permit<'a>,
}

impl Conversion<'_> {
    /// Makes sure that a frame's mesh can be written, in place of one that was made before if it is
    /// made `again`, and opens the frame, unless its particles are open already.
    pub(super) fn open(
        &self,
        checked: &Checked,
        frame: &FrameFile,
        particles: Option<ParticleFile>,
        again: bool,
    ) -> Result<Opened, Error> {
        let mut timings = Timings::default();
        let simulation = self.setup.simulation;
        let path = &frame.path;
        let input = frame.stamp()?;
        let replaces = if simulation.overwrite || again {
            Replaces::Anything
        } else if simulation.resume {
            Replaces::Own
        } else {
            Replaces::Nothing
        };
        let replace = if replaces == Replaces::Nothing { Replace::Refuse } else { Replace::Allow };
        let target = self.output(frame);
        for path in frame.paths().chain(frame.solids.iter().map(PathBuf::as_path)) {
            refuse_same_file(&target, file_and_step(path).0)?;
        }
        let orientation =
            checked.settings.orientation(checked.settings.usual_up(path), self.format);
        let output = Output::prepare(&checked.settings, &target, replace, self.cancel())?;
        let output = output.with_layout(checked.settings.layout(orientation));
        let open = || {
            if is_packed(path) {
                checked.settings.refuse_of_packed(path)?;
                return Ok(None);
            }
            let scratch = &checked.resources.scratch;
            let unpacking = Unpacking {
                in_memory: self.division.unpacked(),
                scratch,
                control: Some(&checked.resources.control),
            };
            let file = particles.map_or_else(|| frame.open(checked.wanted(), unpacking), Ok)?;
            timings.done("open");
            Ok::<_, Error>(Some(file))
        };
        let particles = checked.resources.control.during(Stage::Reading, open)?;
        Ok(Opened { input, target, replaces, orientation, output, particles, timings })
    }

    /// Converts a frame with the threads of its lane, or where it has to be alone with all.
    pub(super) fn convert(
        &self,
        checked: &Checked,
        frame: &FrameFile,
        opened: Opened,
        settled: &Settled,
    ) -> Result<Filled, Error> {
        let simulation = self.setup.simulation;
        let path = &frame.path;
        let frozen = &settled.state.frozen;
        let Opened { input, target, replaces, orientation, output, particles, mut timings } =
            opened;
        timings.skip();
        let ready = match particles {
            Some(file) => self.sample(checked, path, file, frozen, &mut timings),
            None => self.unpack(checked, path, &mut timings),
        };
        let Ready { frame: sampled, mut left_out, mut warnings, infos, time, permit } = ready?;
        let (mesh, precision, mut report) = match &sampled {
            Some(sampled) => {
                let draw = || Self::surface(checked, path, sampled, frozen, infos, &mut timings);
                let Drawn { mesh, precision, report } = permit.run(draw)?;
                (mesh, precision, Some(report))
            }
            None => (checked.empty_mesh(infos), SinglePrecision::Enough, None),
        };
        if let Some(report) = &report {
            left_out.lost = report.lost;
            left_out.drops = report.too_small.map_or(0, |too_small| too_small.drops);
        }
        let mesh = mesh.source();
        let width = coordinate_width(precision, self.format, &target)?;
        warnings.extend(report.iter_mut().flat_map(|report| take(&mut report.warnings)));
        warnings.extend(made_of(mesh, self.format, &target)?);
        let turned = orientation.turned(mesh);
        let bounded = Bounded::new(&turned);
        let (file, held) =
            permit.run(|| output.fill(&bounded, width, &checked.resources.control))?;
        if frame.stamp().ok() != Some(input) {
            return Err(ReadError::new(path, ReadFault::Changed).into());
        }
        let bytes = file.bytes();
        let small = if simulation.sheet && !self.format.is_read() {
            let memory = self.division.share.0 / 8;
            let small = permit.run(|| SmallMeshes::of(&turned, bounded.bounds(), memory));
            small.map_err(|fault| WriteError::new(&target, fault))?
        } else {
            None
        };
        drop(permit);
        timings.done("write");

        let particles = sampled.as_ref().map_or(0, |sampled| sampled.facts().census.binned);
        let listed = SeriesFrame {
            frame: frame.number,
            time,
            file: target.file_name().unwrap_or_default().to_string_lossy().into_owned(),
            bytes,
            particles: particles as u64,
            vertices: mesh.vertex_count(),
            triangles: mesh.triangle_count(),
            bounds: orientation.shown_bounds(bounded.bounds()),
            normals: mesh.has_normals(),
            attributes: mesh.attributes(),
        };
        let (time, seconds) =
            (time.or(simulation.fps.map(|fps| frame.number as f64 / fps)), timings.total());
        if let Some(report) = &mut report {
            report.timings = timings;
            report.threads = checked.threads;
        }
        let fingerprint = settled.fingerprint;
        let record = Record { input, fingerprint, mesh: listed.clone(), crc: file.crc() };
        let done = Done { mesh: listed, time, report, left_out, warnings, seconds };
        Ok(Filled { file, held, target, replaces, record, small, done })
    }

    /// Waits until the frame's mesh is on disk, gives it its name, and keeps its record.
    pub(super) fn finish(&self, filled: Filled) -> Result<Done, Error> {
        let Filled { file, held, target, replaces, record, small, done } = filled;
        if replaces == Replaces::Own && self.is_foreign(&target, &record) {
            return Err(WriteError::new(&target, WriteFault::Exists).into());
        }
        if !self.format.is_read() {
            // Before the mesh: a small mesh is of the mesh that has a record, or of a later one.
            self.small_meshes().keep(record.mesh.frame, small.as_ref())?;
        }
        file.keep()?;
        drop(held);
        self.cancel().undisturbed(|| self.store.log.keep(&record))?;
        Ok(done)
    }

    /// Whether a file stands in the place of a mesh that this conversion has not made: there is no
    /// record of it. Where a process was killed between a mesh and its record, the mesh has the
    /// bytes that it is made with again.
    fn is_foreign(&self, target: &Path, made: &Record) -> bool {
        let is_own = || {
            let before = self.before.get_or_init(|| Records::read(self.store.folder()));
            before.names(target) || made.is_whole(target)
        };
        target.symlink_metadata().is_ok() && !is_own()
    }

    /// Reads a frame that was sampled before.
    fn unpack(
        &self,
        checked: &Checked,
        path: &Path,
        timings: &mut Timings,
    ) -> Result<Ready<'_>, Error> {
        let budget = self.frame_budget(checked, self.division.share);
        let permit = self.gate.enter();
        let scratch = &checked.resources.scratch;
        let sampled = open_frame(path, budget.0 / 4)?.with_scratch(scratch);
        timings.done("open");
        checked.settings.refuse_of_others(sampled.indicator.kind())?;
        let resources = Resources { budget, ..checked.resources.clone() };
        let frame = Engine::from_sampled(sampled, &checked.surfacing, resources);
        Ok(Ready {
            frame: Some(frame),
            left_out: LeftOut::default(),
            warnings: Vec::new(),
            infos: Vec::new(),
            time: None,
            permit,
        })
    }

    /// Samples the particles of a frame.
    fn sample(
        &self,
        checked: &Checked,
        path: &Path,
        file: ParticleFile,
        frozen: &Frozen,
        timings: &mut Timings,
    ) -> Result<Ready<'_>, Error> {
        let Checked { settings, surfacing, resources, .. } = checked;
        let control = &resources.control;
        let in_file = |fault: FrameError| Error::from(fault).of_file(path);
        let [share, alone] = [self.division.share, self.division.alone]
            .map(|whole| self.frame_budget(checked, whole));
        let opening = Resources { budget: self.division.opening, ..resources.clone() };
        let carried = settings.carried(file.particles.attributes(), Some(self.format));
        let carried = carried.map_err(|error| error.of_file(path))?;
        let infos = carried_infos(file.particles.attributes(), &carried);
        let infos = known_of(infos, &frozen.kinds);
        let (mut sampling, past) =
            self.setup.sampling(frozen, &file.particles, carried, opening)?;
        // Particles of several sizes have no one spacing to check.
        let known = frozen.spacing.filter(|_| frozen.sizes.is_none());
        if let Some(spacing) = known.filter(|_| self.unchecked.swap(false, Ordering::Relaxed)) {
            let doubts = Doubt::of_known(spacing, &SpacingSource::State, &file.particles);
            doubts
                .iter()
                .for_each(|doubt| self.setup.tell(Event::Doubted(Box::new(doubt.clone()))));
        }
        control.begin(Stage::Counting);
        let mut counted = Counted::for_surface(&file.particles, &sampling, surfacing, None);
        timings.done("count");
        let fits = match &counted {
            Ok(counted) => counted.estimate().in_core() <= share.0,
            Err(FrameError::OverBudget(_)) => false,
            Err(_) => true,
        };
        let beside = resources.backend.executor().divides() && fits;
        control.begin(Stage::Waiting);
        let permit = if beside { self.gate.enter() } else { self.gate.enter_alone() };
        let budget = if beside { share } else { alone };
        timings.done("wait");
        if matches!(counted, Err(FrameError::OverBudget(_))) {
            drop(counted);
            sampling.resources.budget = budget;
            counted = Counted::for_surface(&file.particles, &sampling, surfacing, None);
        }
        let (frame, census) = match counted {
            Err(FrameError::NoParticles(census)) => (None, census),
            counted => {
                let counted = counted.map_err(in_file)?;
                let census = counted.census();
                let sample = || Engine::sample_counted(counted, budget, timings).map_err(in_file);
                (Some(permit.run(sample)?), census)
            }
        };
        let left_out = LeftOut { unselected: file.unselected as u64, ..census.into() };
        let parts = file.left_out.iter().cloned().map(Warning::LeftOut);
        let none_selected = file.none_selected.clone().map(Warning::NoneSelected);
        let warnings = past.into_iter().chain(none_selected).chain(parts).collect();
        Ok(Ready { frame, left_out, warnings, infos, time: file.time, permit })
    }

    /// The part of a lane's memory that is left for the frame, where as much as its surface takes
    /// is needed beside it: for the triangles that are left, or for a writer that holds them all.
    /// Solids of its own take of it as well.
    fn frame_budget(&self, checked: &Checked, lane: MemoryBudget) -> MemoryBudget {
        let Checked { settings, reduction, surfacing, .. } = self.setup.checked;
        let own = checked.surfacing.solid.as_ref().filter(|_| surfacing.solid.is_none());
        let lane = MemoryBudget(lane.0.saturating_sub(own.map_or(0, |solid| solid.bytes())));
        let holds = settings.holds_whole_mesh(self.format);
        if self.division.lanes > 1 && (holds || !reduction.is_none()) {
            MemoryBudget(lane.0 / 2)
        } else {
            lane
        }
    }

    /// The mesh of a frame, empty if it has no surface, and a report on it.
    fn surface(
        checked: &Checked,
        path: &Path,
        sampled: &Engine,
        frozen: &Frozen,
        infos: Vec<AttributeInfo>,
        timings: &mut Timings,
    ) -> Result<Drawn, Error> {
        let known = frozen.calibration.as_ref();
        let measured_on = known.filter(|_| checked.surfacing.iso.is_none()).map(|_| frozen.frame);
        let drawn = checked.draw_or_empty(sampled, known, infos, measured_on, timings);
        let mut drawn = drawn.map_err(|fault| Error::from(fault).of_file(path))?;
        // The sum over all frames is reported at the end.
        drawn.report.warnings.retain(|warning| !matches!(warning, Warning::Lost { .. }));
        for warning in &mut drawn.report.warnings {
            if let Warning::Shortfall { measured_on: by, .. } = warning {
                *by = measured_on;
            }
        }
        Ok(drawn)
    }
}

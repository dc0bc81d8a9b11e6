//! Converts one frame. The frame is read, and its particles are counted, in parallel with other
//! frames. If the backend and the memory allow, the frame is also meshed in parallel with other
//! frames, and otherwise alone.

use std::mem::take;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

use super::conversion::{Conversion, SharedMeasurements};
use super::event::{Event, OmittedCounts};
use super::frame_file::FrameFile;
use super::gate::Permit;
use super::records::{Record, Records};
use super::shared_calibration::{SharedCalibration, Stamp};
use super::small_meshes::SmallMeshes;
use crate::error::Error;
use crate::frame::{CountedFrame, Engine, FrameError, Resources};
use crate::grid::units::MemoryBudget;
use crate::io::bytes::Unpacking;
use crate::io::input::file_and_step;
use crate::io::mnf::{is_packed, open_frame};
use crate::io::series::SeriesFrame;
use crate::io::time_codes::FRAMES_PER_SECOND;
use crate::io::whole::{FilledFile, Replace};
use crate::io::{ParticleFile, ReadError, ReadFault, WriteError, WriteFault};
use crate::particles::AttributeInfo;
use crate::particles::alike::AlikeParticles;
use crate::particles::kind::known_of;
use crate::reconstruction::{
    CheckedRequest, ExtractedSurface, Orientation, Output, Report, SinglePrecision, SpacingSource,
    SpacingWarning, TemporaryOutput, Warning, alpha_warnings, coordinate_width, format_warnings,
    missing_attributes, refuse_same_file,
};
use crate::surface::mesh::source::BoundedMesh;
use crate::system::control::Stage;
use crate::system::timings::Timings;

/// A converted frame.
pub(super) struct ConvertedFrame {
    pub(super) mesh: SeriesFrame,
    pub(super) time: Option<f64>,
    pub(super) particle_types: Vec<String>,
    pub(super) report: Option<Report>,
    pub(super) left_out: OmittedCounts,
    pub(super) warnings: Vec<Warning>,
    pub(super) seconds: f64,
}

/// A frame whose mesh is written, but may not be on disk yet.
pub(super) struct WrittenFrame {
    file: FilledFile,
    temporary: TemporaryOutput,
    target: PathBuf,
    replaces: ReplaceableFiles,
    record: Record,
    /// The bytes of a small mesh file for the contact sheet, if this library cannot read the format
    /// of the mesh.
    small: Option<Vec<u8>>,
    done: ConvertedFrame,
}

/// The files that a mesh may replace.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ReplaceableFiles {
    Nothing,
    /// Meshes that this conversion made.
    Own,
    Anything,
}

/// An open frame with its prepared output.
pub(super) struct PreparedFrame {
    input: Stamp,
    target: PathBuf,
    replaces: ReplaceableFiles,
    orientation: Orientation,
    output: Output,
    /// `None` for a packed frame.
    particles: Option<ParticleFile>,
    timings: Timings,
}

/// A frame that is ready to be meshed.
struct MeshableFrame<'a> {
    /// `None` if the frame has no particles.
    frame: Option<Engine>,
    left_out: OmittedCounts,
    particle_types: Vec<String>,
    /// Warnings about the input.
    warnings: Vec<Warning>,
    /// The attributes of the vertices.
    infos: Vec<AttributeInfo>,
    time: Option<f64>,
    permit: Permit<'a>,
}

impl Conversion<'_> {
    /// Checks that a frame's mesh can be written, and opens the frame, unless its particles are
    /// already open. If `may_replace` is true, the mesh may replace any existing file.
    pub(super) fn open(
        &self,
        checked: &CheckedRequest,
        frame: &FrameFile,
        particles: Option<ParticleFile>,
        may_replace: bool,
    ) -> Result<PreparedFrame, Error> {
        let mut timings = Timings::default();
        let simulation = self.setup.simulation;
        let path = &frame.path;
        let input = frame.stamp()?;
        let replaces = if simulation.overwrite || may_replace {
            ReplaceableFiles::Anything
        } else if simulation.resume {
            ReplaceableFiles::Own
        } else {
            ReplaceableFiles::Nothing
        };
        let replace =
            if replaces == ReplaceableFiles::Nothing { Replace::Refuse } else { Replace::Allow };
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
                checked.settings.check_packed(path)?;
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
        Ok(PreparedFrame { input, target, replaces, orientation, output, particles, timings })
    }

    /// Converts a frame. If several frames are converted at a time, each uses its share of the
    /// threads; otherwise, the frame uses all threads.
    pub(super) fn convert(
        &self,
        checked: &CheckedRequest,
        frame: &FrameFile,
        opened: PreparedFrame,
        settled: &SharedMeasurements,
    ) -> Result<WrittenFrame, Error> {
        let simulation = self.setup.simulation;
        let path = &frame.path;
        let shared = &settled.state.shared;
        let PreparedFrame { input, target, replaces, orientation, output, particles, mut timings } =
            opened;
        timings.skip();
        let meshable = match particles {
            Some(file) => self.sample(checked, frame, file, shared, &mut timings),
            None => self.unpack(checked, path, shared, &mut timings),
        }?;
        let MeshableFrame { frame: sampled, infos, time, permit, particle_types, .. } = meshable;
        let (mut left_out, mut warnings) = (meshable.left_out, meshable.warnings);
        let (mesh, precision, mut report) = match &sampled {
            Some(sampled) => {
                let extract = || Self::surface(checked, path, sampled, shared, infos, &mut timings);
                let ExtractedSurface { mesh, precision, report } = permit.run(extract)?;
                (mesh, precision, Some(report))
            }
            None => {
                let mesh = checked.empty_mesh(infos, shared.grid()?);
                (mesh, SinglePrecision::Enough, None)
            }
        };
        if let Some(report) = &report {
            left_out.lost = report.lost;
            left_out.drops = report.too_small.map_or(0, |too_small| too_small.drops);
        }
        let mesh = mesh.source();
        checked.settings.check_attributes(&target, self.format, || Ok(mesh.attributes()))?;
        let width = coordinate_width(precision, self.format, &target)?;
        warnings.extend(report.iter_mut().flat_map(|report| take(&mut report.warnings)));
        warnings.extend(format_warnings(mesh, precision, self.format, &target)?);
        let turned = orientation.turned(mesh);
        let bounded = BoundedMesh::new(&turned);
        let number = frame.number as f64;
        let shown = time.or(settled.state.fps().map(|fps| number / fps));
        let output = output.at(shown.unwrap_or(number / FRAMES_PER_SECOND));
        let (file, temporary) =
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
        let seconds = timings.total();
        if let Some(report) = &mut report {
            report.timings = timings;
            report.threads = checked.threads;
        }
        let fingerprint = settled.fingerprint;
        let record = Record { input, fingerprint, mesh: listed.clone(), crc: file.crc() };
        let done = ConvertedFrame {
            mesh: listed,
            time: shown,
            particle_types,
            report,
            left_out,
            warnings,
            seconds,
        };
        Ok(WrittenFrame { file, temporary, target, replaces, record, small, done })
    }

    /// Waits until the frame's mesh is on disk, renames it, and stores its record.
    pub(super) fn finish(&self, filled: WrittenFrame) -> Result<ConvertedFrame, Error> {
        let WrittenFrame { file, temporary, target, replaces, record, small, done } = filled;
        if replaces == ReplaceableFiles::Own && self.is_foreign(&target, &record) {
            return Err(WriteError::new(&target, WriteFault::Exists).into());
        }
        if !self.format.is_read() {
            // The small mesh is stored before the record, so that it is never older than the
            // record.
            self.small_meshes().store(record.mesh.frame, small.as_deref())?;
        }
        file.keep()?;
        drop(temporary);
        self.cancel().undisturbed(|| self.store.log.append(&record))?;
        Ok(done)
    }

    /// Whether a file that this conversion did not write already exists at the path of the mesh.
    /// Files of this conversion have a record. If a process was killed between writing a mesh and
    /// its record, the existing file has the same bytes as the new mesh, so it counts as a file of
    /// this conversion.
    fn is_foreign(&self, target: &Path, made: &Record) -> bool {
        let is_own = || {
            let records = self.records_before.get_or_init(|| Records::read(self.store.folder()));
            records.names(target) || made.is_whole(target)
        };
        target.symlink_metadata().is_ok() && !is_own()
    }

    /// Reads a packed frame.
    fn unpack(
        &self,
        checked: &CheckedRequest,
        path: &Path,
        shared: &SharedCalibration,
        timings: &mut Timings,
    ) -> Result<MeshableFrame<'_>, Error> {
        let budget = self.frame_budget(checked, self.division.share);
        let permit = self.gate.enter();
        let packed = open_frame(path, budget.0 / 4, Some(&checked.resources.scratch))?;
        timings.done("open");
        checked.settings.check_indicator_settings(packed.indicator().kind())?;
        shared.check_cells(packed.facts()).map_err(|fault| Error::from(fault).of_file(path))?;
        let resources = Resources { budget, ..checked.resources.clone() };
        let frame = Engine::from_packed(packed, &checked.surfacing, resources);
        Ok(MeshableFrame {
            frame: Some(frame),
            left_out: OmittedCounts::default(),
            particle_types: Vec::new(),
            warnings: Vec::new(),
            infos: Vec::new(),
            time: None,
            permit,
        })
    }

    /// Samples the particles of a frame.
    fn sample(
        &self,
        checked: &CheckedRequest,
        frame: &FrameFile,
        file: ParticleFile,
        shared: &SharedCalibration,
        timings: &mut Timings,
    ) -> Result<MeshableFrame<'_>, Error> {
        let CheckedRequest { settings, surfacing, resources, .. } = checked;
        let (control, path) = (&resources.control, &frame.path);
        let in_file = |fault: FrameError| Error::from(fault).of_file(path);
        let [share, alone] = [self.division.share, self.division.alone]
            .map(|whole| self.frame_budget(checked, whole));
        let opening = Resources { budget: self.division.opening, ..resources.clone() };
        let carried = settings.carried(&file.particles, Some(self.format));
        let carried =
            carried.map_err(|error| error.of_file(path).with_skipped_part(&file.left_out))?;
        let alike = AlikeParticles::of(&file.particles, &carried, &shared.kinds);
        let particles = alike.map_err(|fault| in_file(fault.into()))?;
        let infos = known_of(&particles, &carried, &shared.kinds);
        let missing = missing_attributes(&infos, &shared.kinds, Some(shared.frame));
        let alpha = alpha_warnings(&particles);
        let (mut sampling, wall_warnings) =
            self.setup.sampling(shared, &particles, carried, opening)?;
        // Particles of several sizes have no single spacing to check.
        let known = shared.spacing.filter(|_| shared.sizes.is_none());
        if let Some(spacing) = known.filter(|_| self.unchecked.swap(false, Ordering::Relaxed)) {
            let warnings = SpacingWarning::of_known(spacing, &SpacingSource::State, &particles);
            warnings.iter().for_each(|warning| {
                self.setup.send(Event::SpacingWarning(Box::new(warning.clone())))
            });
        }
        let (spacing, sizes) = (shared.spacing, shared.sizes.as_ref());
        // The sizes of the calibration frame were checked when the frame was measured.
        let of_sizes = if frame.number == shared.frame {
            None
        } else {
            let of_sizes = checked.sampling.warning_of_sizes((spacing, sizes), &particles);
            of_sizes.map_err(|error| error.of_file(path))?
        };
        control.begin(Stage::Counting);
        let mut counted = CountedFrame::for_surface(&particles, &sampling, surfacing, None);
        timings.done("count");
        let fits = match &counted {
            Ok(counted) => counted.estimate().in_core() <= share.0,
            Err(FrameError::OverBudget(_)) => false,
            Err(_) => true,
        };
        let in_parallel = resources.backend.executor().divides() && fits;
        control.begin(Stage::Waiting);
        let permit = if in_parallel { self.gate.enter() } else { self.gate.enter_alone() };
        let budget = if in_parallel { share } else { alone };
        timings.done("wait");
        if matches!(counted, Err(FrameError::OverBudget(_))) {
            drop(counted);
            sampling.resources.budget = budget;
            counted = CountedFrame::for_surface(&particles, &sampling, surfacing, None);
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
        let left_out = OmittedCounts { unselected: file.unselected as u64, ..census.into() };
        let parts = file.left_out.iter().filter(|part| part.is_unexpected()).cloned();
        let parts = parts.map(Warning::LeftOut);
        let none_selected = file.none_selected.clone().map(Warning::NoneSelected);
        let of_sizes = of_sizes.map(Warning::Spacing);
        let of_input = none_selected.into_iter().chain(parts).chain(missing).chain(alpha);
        let warnings = wall_warnings.into_iter().chain(of_sizes).chain(of_input).collect();
        let (time, particle_types) = (file.time, file.particle_types.clone());
        Ok(MeshableFrame { frame, left_out, particle_types, warnings, infos, time, permit })
    }

    /// Returns the part of a lane's memory that the frame itself may use. The remaining memory is
    /// for simplifying, for a writer that holds the whole mesh, and for the frame's own solids.
    fn frame_budget(&self, checked: &CheckedRequest, lane: MemoryBudget) -> MemoryBudget {
        let CheckedRequest { settings, reduction, surfacing, .. } = self.setup.checked;
        let own = checked.surfacing.solid.as_ref().filter(|_| surfacing.solid.is_none());
        let lane = MemoryBudget(lane.0.saturating_sub(own.map_or(0, |solid| solid.bytes())));
        let holds_whole_mesh = settings.holds_whole_mesh(self.format);
        if self.division.lanes > 1 && (holds_whole_mesh || !reduction.is_none()) {
            MemoryBudget(lane.0 / 2)
        } else {
            lane
        }
    }

    /// Returns the mesh of a frame, which may be empty, with a report.
    fn surface(
        checked: &CheckedRequest,
        path: &Path,
        sampled: &Engine,
        shared: &SharedCalibration,
        infos: Vec<AttributeInfo>,
        timings: &mut Timings,
    ) -> Result<ExtractedSurface, Error> {
        let known = shared.calibration.as_ref();
        let calibration_frame =
            known.filter(|_| checked.surfacing.iso.is_none()).map(|_| shared.frame);
        let extracted = checked.extract_or_empty(sampled, known, infos, calibration_frame, timings);
        let mut extracted = extracted.map_err(|fault| Error::from(fault).of_file(path))?;
        // Lost particles are reported at the end, as a sum over all frames.
        extracted.report.warnings.retain(|warning| !matches!(warning, Warning::Lost { .. }));
        for warning in &mut extracted.report.warnings {
            if let Warning::Shortfall { calibration_frame: by, .. } = warning {
                *by = calibration_frame;
            }
        }
        Ok(extracted)
    }
}

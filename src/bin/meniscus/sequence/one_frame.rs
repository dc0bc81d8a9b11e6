//! One frame on its way: read and counted beside others, meshed beside them too where it fits, else alone.

use std::path::{Path, PathBuf};

use meniscus::error::Error;
use meniscus::field::calibration::Calibration;
use meniscus::frame::{Counted, Frame, FrameError, Normals, Resources};
use meniscus::grid::units::MemoryBudget;
use meniscus::io::bytes::Unpacking;
use meniscus::io::input::{file_and_step, open_particles};
use meniscus::io::mnf::open_frame;
use meniscus::io::output::MeshOutput;
use meniscus::io::series::SeriesFrame;
use meniscus::io::whole::{FilledFile, Replace};
use meniscus::io::{CoordinateWidth, ParticleFile, ReadError, ReadFault};
use meniscus::particles::{AttributeInfo, Particles, carried_infos};
use meniscus::simulation::frozen::{Frozen, Stamp};
use meniscus::simulation::inputs::FrameFile;
use meniscus::simulation::records::Record;
use meniscus::surface::mesh::bounds::Bounded;
use meniscus::surface::mesh::source::MeshSource;
use meniscus::surface::mesh::{Mesh, VertexAttribute};
use meniscus::system::timings::Timings;
use serde_json::{Value, json};

use crate::identity::refuse_same_file;
use crate::interrupt::{self, Unfinished};
use crate::lanes::Permit;
use crate::report::coordinate_width;
use crate::report::{self, LeftOut, advice, limits};
use crate::run::Notes;
use crate::up::Orientation;
use meniscus::io::mnf::is_packed;

use super::setup::Setup;
use super::shared::{Conversion, Settled};

/// A frame that was converted.
pub struct Done {
    pub mesh: SeriesFrame,
    /// Where statistics are asked for.
    pub stats: Option<Value>,
    pub seconds: f64,
    pub left_out: LeftOut,
    pub warnings: Vec<String>,
}

/// A frame whose mesh is written, but not known to be on disk.
pub struct Filled {
    file: FilledFile,
    unfinished: Unfinished,
    record: Record,
    stats: Option<Value>,
    seconds: f64,
    left_out: LeftOut,
    warnings: Vec<String>,
}

/// A frame that was opened, and the output that waits for its mesh.
pub struct Opened {
    input: Stamp,
    target: PathBuf,
    orientation: Orientation,
    output: MeshOutput,
    unfinished: Unfinished,
    /// `None` where it was sampled before.
    particles: Option<ParticleFile>,
    timings: Timings,
}

/// A frame that waits to be meshed.
struct Ready<'a> {
    /// `None` where there are no particles.
    frame: Option<Frame>,
    left_out: LeftOut,
    /// What its vertices carry.
    infos: Vec<AttributeInfo>,
    time: Option<f64>,
    permit: Permit<'a>,
}

/// A mesh, and how wide its coordinates are.
type Found = (Box<dyn MeshSource + Send>, CoordinateWidth);

impl Conversion<'_> {
    /// Makes sure that a frame's mesh can be written, in place of one that was made before if it is made `again`, and opens the frame,
    /// unless its particles are open already.
    pub fn open(
        &self,
        frame: &FrameFile,
        particles: Option<ParticleFile>,
        again: bool,
        stage: &dyn Fn(&str),
    ) -> Result<Opened, Error> {
        let mut timings = Timings::default();
        let Setup { options, resources, .. } = self.setup;
        let path = &frame.path;
        let input = Stamp::of(path).map_err(|e| ReadError::new(path, e.into()))?;
        let allowed = options.sequence.resume || options.run.overwrite || again;
        let replace = if allowed { Replace::Allow } else { Replace::Refuse };
        let target = self.output(frame);
        refuse_same_file(file_and_step(path).0, &target)?;
        let orientation = options.up.orientation(path, self.format);
        let layout = options.layout(orientation);
        let prepare = || MeshOutput::prepare(&target, replace).map(|output| output.with_layout(layout));
        let (output, unfinished) = interrupt::guard(prepare, MeshOutput::temporary)?;
        stage("reading");
        let particles = if is_packed(path) {
            options.validate_frame_input(path)?;
            None
        } else {
            let unpacking = Unpacking { in_memory: self.division.unpacked(), scratch: &resources.scratch };
            let file = particles.map_or_else(|| open_particles(path, unpacking), Ok)?;
            timings.done("open");
            Some(file)
        };
        Ok(Opened { input, target, orientation, output, unfinished, particles, timings })
    }

    /// Converts a frame with the threads of its lane, or where it has to be alone with all.
    pub fn convert(
        &self,
        frame: &FrameFile,
        opened: Opened,
        settled: &Settled,
        stage: &dyn Fn(&str),
    ) -> Result<Filled, Error> {
        let options = self.setup.options;
        let path = &frame.path;
        let frozen = &settled.state.frozen;
        let Opened { input, target, orientation, output, unfinished, particles, mut timings } = opened;
        timings.skip();
        let ready = match particles {
            Some(file) => self.sample(path, file, frozen, stage, &mut timings),
            None => self.unpack(path, &mut timings),
        };
        let Ready { frame: sampled, mut left_out, infos, time, permit } = ready?;
        let mut warnings = Vec::new();
        let surface = match &sampled {
            None => None,
            Some(sampled) => {
                stage("meshing");
                let surface = permit
                    .run(|| self.surface(path, sampled, frozen, &mut left_out, &mut warnings, &mut timings));
                warnings.extend(report::warnings(sampled));
                surface?
            }
        };

        stage("writing");
        let (mesh, width) = surface.unwrap_or_else(|| {
            (Box::new(empty_mesh(self.setup.surfacing.normals, infos)), CoordinateWidth::F32)
        });
        warnings.extend(report::merged(&*mesh, self.format, &target)?);
        let turned = orientation.turned(&*mesh);
        let bounded = Bounded::new(&turned);
        let file = permit.run(|| output.fill(&bounded, width))?;
        if Stamp::of(path).ok() != Some(input) {
            let what = "it has changed while it was read; --resume makes it again".to_owned();
            return Err(ReadError::new(path, ReadFault::Unsupported(what)).into());
        }
        let bytes = file.bytes();
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
        let record = Record { input, fingerprint: settled.fingerprint, mesh: listed, crc: file.crc() };
        let stats = options.stats.is_some().then(|| {
            let mut stats = match &sampled {
                Some(sampled) => options.record(
                    [path, &target],
                    sampled,
                    frozen.calibration.and_then(|known| known.iso()),
                    &*mesh,
                    bytes,
                    &timings,
                ),
                None => {
                    json!({ "input": path, "output": target, "particles": 0, "vertices": 0, "triangles": 0 })
                }
            };
            stats["frame"] = json!(frame.number);
            stats["in_no_surface"] = json!(left_out.lost);
            stats["time"] = json!(time.or(options.sequence.fps.map(|fps| frame.number as f64 / fps)));
            stats
        });
        Ok(Filled { file, unfinished, record, stats, seconds: timings.total(), left_out, warnings })
    }

    /// Waits until the frame's mesh is on disk, gives it its name, and keeps its record.
    pub fn finish(&self, filled: Filled) -> Result<Done, Error> {
        let Filled { file, unfinished, record, stats, seconds, left_out, warnings } = filled;
        file.keep()?;
        drop(unfinished);
        interrupt::undisturbed(|| self.store.log.keep(&record))?;
        Ok(Done { mesh: record.mesh, stats, seconds, left_out, warnings })
    }

    /// Reads a frame that was sampled before.
    fn unpack(&self, path: &Path, timings: &mut Timings) -> Result<Ready<'_>, Error> {
        let budget = self.frame_budget(self.division.share);
        let permit = self.gate.enter();
        let sampled = open_frame(path, budget.0 / 4)?;
        timings.done("open");
        self.setup.options.refuse_of_others(sampled.indicator.kind())?;
        let resources = Resources { budget, ..self.setup.resources.clone() };
        let frame = Frame::from_sampled(sampled, &self.setup.surfacing, resources);
        Ok(Ready { frame: Some(frame), left_out: LeftOut::default(), infos: Vec::new(), time: None, permit })
    }

    /// Samples the particles of a frame.
    fn sample(
        &self,
        path: &Path,
        file: ParticleFile,
        frozen: &Frozen,
        stage: &dyn Fn(&str),
        timings: &mut Timings,
    ) -> Result<Ready<'_>, Error> {
        let Setup { options, surfacing, resources, .. } = self.setup;
        let in_file = |fault: FrameError| Error::Frame { path: Some(path.to_owned()), fault };
        let [share, alone] = [self.division.share, self.division.alone].map(|whole| self.frame_budget(whole));
        let opening = Resources { budget: self.division.opening, ..resources.clone() };
        let carried = options.carried(path, &file, self.format)?;
        let infos = carried_infos(file.particles.attributes(), &carried);
        let mut sampling = self.setup.sampling(frozen, carried, opening)?;
        stage("counting");
        let mut counted = Counted::for_surface(&file.particles, &sampling, surfacing);
        timings.done("count");
        let fits = match &counted {
            Ok(counted) => counted.estimate().in_core() <= share.0,
            Err(FrameError::OverBudget(_)) => false,
            Err(_) => true,
        };
        let beside = resources.backend.divides() && fits;
        stage("waiting");
        let permit = if beside { self.gate.enter() } else { self.gate.enter_alone() };
        let budget = if beside { share } else { alone };
        timings.done("wait");
        if matches!(counted, Err(FrameError::OverBudget(_))) {
            drop(counted);
            sampling.resources.budget = budget;
            counted = Counted::for_surface(&file.particles, &sampling, surfacing);
        }
        stage("sampling");
        let (frame, census) = match counted {
            Err(FrameError::NoParticles(census)) => (None, census),
            counted => {
                let counted = counted.map_err(in_file)?;
                let census = counted.census();
                let sample = || Frame::sample_counted(counted, budget, timings).map_err(in_file);
                (Some(permit.run(sample)?), census)
            }
        };
        Ok(Ready { frame, left_out: census.into(), infos, time: file.time, permit })
    }

    /// What is left of a lane's memory for the frame, where as much as its surface takes is needed beside it: for the
    /// triangles that are left, or for a writer that holds them all.
    fn frame_budget(&self, lane: MemoryBudget) -> MemoryBudget {
        let Setup { options, reduction, .. } = self.setup;
        let holds = self.format.holds_whole_mesh() || options.compress;
        if self.division.lanes > 1 && (holds || !reduction.is_none()) {
            MemoryBudget(lane.0 / 2)
        } else {
            lane
        }
    }

    /// The mesh of a frame; `None` where it is empty.
    fn surface(
        &self,
        path: &Path,
        sampled: &Frame,
        frozen: &Frozen,
        left_out: &mut LeftOut,
        warnings: &mut Vec<String>,
        timings: &mut Timings,
    ) -> Result<Option<Found>, Error> {
        let reduction = &self.setup.reduction;
        let mut warn = |text: String| warnings.push(text);
        let empty = |why: &str| format!("{why}: an empty mesh");
        let binned = sampled.facts().census.binned as u64;
        let in_file = |fault| Error::Frame { path: Some(path.to_owned()), fault };
        let drawn = sampled.calibrate(&self.setup.surfacing, frozen.calibration.as_ref(), timings);
        let surface = match drawn.and_then(|frame| frame.surface(timings)) {
            Err(FrameError::NoSurface { .. }) => {
                left_out.lost = binned;
                warn(empty("the field is nowhere above the isovalue") + &self.advice(frozen));
                return Ok(None);
            }
            Err(FrameError::NoKernelSurface | FrameError::NoDistanceSurface) => {
                left_out.lost = binned;
                warn(empty("no cell's centre is inside of the surface"));
                return Ok(None);
            }
            surface => surface.map_err(in_file)?,
        };
        left_out.lost = sampled.lost(&surface).map_err(in_file)?;
        if let Some(shortfall) = sampled.shortfall(&surface).map_err(in_file)? {
            warn(format!("{shortfall}{}", self.advice(frozen)));
        }
        let width = coordinate_width(&surface, self.format, &Notes::none())?;
        if reduction.is_none() {
            return Ok(Some((Box::new(surface), width)));
        }
        match sampled.simplify(surface, reduction, timings) {
            Err(FrameError::NothingLeft(all)) => {
                left_out.drops = all.drops;
                warn(empty(&format!("all components are below {}", limits(all))));
                Ok(None)
            }
            Err(fault) => Err(in_file(fault)),
            Ok(simplified) => {
                left_out.drops = simplified.dropped().drops;
                Ok(Some((Box::new(simplified), width)))
            }
        }
    }

    /// Advises on a surface that holds less than its particles.
    fn advice(&self, frozen: &Frozen) -> String {
        let measured = self.setup.surfacing.iso.is_none() && frozen.calibration.is_some();
        let is_cloud = matches!(frozen.calibration, Some(Calibration::Clouds { .. }));
        advice(self.setup.options, is_cloud, measured.then_some(frozen.frame))
    }
}

/// What is written where there is no surface: every program can load it, and finds what it expects.
fn empty_mesh(normals: Normals, infos: Vec<AttributeInfo>) -> Mesh {
    let attribute = |info: AttributeInfo| VertexAttribute {
        name: info.name,
        components: info.components,
        values: Vec::new(),
    };
    Mesh {
        normals: (normals == Normals::Gradient).then(Vec::new),
        attributes: infos.into_iter().map(attribute).collect(),
        ..Mesh::default()
    }
}

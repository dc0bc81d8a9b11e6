//! `meniscus reconstruct`: a frame of particles to a mesh; each frame of a simulation is one, see `sequence`.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use bytesize::ByteSize;
use clap::{Args, value_parser};
use meniscus::backend::Cpu;
use meniscus::error::Error;
use meniscus::field::indicator::{IndicatorKind, SampledDif};
use meniscus::frame::estimate::{Estimate, SMALLEST_BUDGET};
use meniscus::frame::{Counted, Detail, Frame, FrameError, Normals, Resources, Surfacing};
use meniscus::grid::units::{Isovalue, Sigma, Smooth, Tolerance};
use meniscus::io::glb::{Compression, Layout};
use meniscus::io::input::{file_and_step, open_particles};
use meniscus::io::mnf::open_frame;
use meniscus::io::output::{MeshFormat, MeshOutput};
use meniscus::io::whole::Replace;
use meniscus::io::{CoordinateWidth, ParticleFile};
use meniscus::particles::{Particles, velocity_attribute};
use meniscus::simulation::inputs::Inputs;
use meniscus::simulation::naming::Naming;
use meniscus::simulation::state::Settings;
use meniscus::surface::mesh::source::MeshSource;
use meniscus::surface::simplify::{BYTES_A_THREAD, Reduction};
use meniscus::surface::stitch::Stitched;
use meniscus::system::timings::Timings;
use serde_json::json;

use crate::Verdict;
use crate::identity::refuse_same_file;
use crate::interrupt;
use crate::method::MethodName;
use crate::report::{
    LeftOut, advice, merged, report_calibration, report_device, report_laps, report_lattice,
    report_simplified, warnings,
};
use crate::run::{Notes, RunOptions, bytes_of, unpacking};
use crate::sampling::{SamplingOptions, SamplingRequest};
use crate::sequence::{self, SequenceOptions};
use crate::up::{Orientation, UpOptions};

#[derive(Args)]
pub struct Options {
    /// The particles: .bgeo, .vtk, .ply, .npy, .csv, .xyz or .bi4, gzipped or not; or a .mnf that `pack` made. The
    /// frames of a simulation: files, a folder, a glob, a name with {} for the number, or a .h5part of several steps.
    #[arg(required = true, value_name = "INPUT")]
    inputs: Vec<PathBuf>,
    /// The mesh: .ply, .obj, .vtk, .vtp, .stl, .usdc or .glb. Of a simulation: a name with {} or {:04} for the number, or a folder.
    #[arg(short, long)]
    pub output: PathBuf,
    #[command(flatten)]
    pub sequence: SequenceOptions,
    #[command(flatten)]
    pub sampling: SamplingOptions,
    /// How the field is made: by discrete indicator functions, or by a kernel method to compare them with.
    #[arg(long, value_enum, default_value = "dif")]
    pub method: MethodName,
    /// How calm the water is: the width, in spacings, under which particles make one surface [default: 1.6]. More for the noise
    /// of FLIP, less to see every ripple.
    #[arg(long, value_name = "SPACINGS", allow_negative_numbers = true)]
    pub smooth: Option<f64>,
    /// Width of the Gaussian, for --indicator counting and symmetry [default: a spacing, and a cell at the least].
    #[arg(long, value_name = "CELLS", allow_negative_numbers = true)]
    pub sigma: Option<f64>,
    /// Where the surface is, between 0 and 1, for --indicator counting and symmetry and for kernel methods; auto: 0.47 of the
    /// field deep in the fluid, or of what the spacing tells it to be where no fluid is deep.
    #[arg(long, value_name = "VALUE|auto", value_parser = isovalue, default_value = "auto", allow_hyphen_values = true)]
    pub iso: IsoOption,
    /// Recover details that smoothing loses, such as drops, for --indicator counting and symmetry.
    #[arg(long)]
    pub detail: bool,
    /// Use fewer triangles, as long as no part of the surface moves farther than this.
    #[arg(long, value_name = "CELLS", allow_negative_numbers = true)]
    pub simplify: Option<f64>,
    /// Leave out whole components, drops or bubbles, of less than this volume, in cells.
    #[arg(long, value_name = "CELLS3", allow_negative_numbers = true)]
    pub drop_smaller: Option<f64>,
    /// Leave out drops of fewer particles, as told by their volume [default: 1, which leaves out none].
    #[arg(long, value_name = "PARTICLES", value_parser = value_parser!(u32).range(1..))]
    pub smallest_drop: Option<u32>,
    /// Write a .glb file quantized and compressed (EXT_meshopt_compression).
    #[arg(long)]
    pub compress: bool,
    #[command(flatten)]
    pub up: UpOptions,
    /// Vertex normals, from the field's gradient.
    #[arg(long)]
    pub normals: bool,
    /// Particle attributes to carry to the vertices, or none [default: velocity, where the format can hold it].
    #[arg(long, value_name = "NAME,...", value_delimiter = ',')]
    attributes: Option<Vec<String>>,
    /// Say what would be done and what it would take, and do nothing.
    #[arg(long)]
    pub dry_run: bool,
    /// Append a JSON record of counts, times and settings to this file, a line for each frame.
    #[arg(long, value_name = "FILE")]
    pub stats: Option<PathBuf>,
    #[command(flatten)]
    pub run: RunOptions,
}

#[derive(Clone, Copy)]
pub enum IsoOption {
    Auto,
    Value(Isovalue),
}

fn isovalue(text: &str) -> Result<IsoOption, String> {
    if text == "auto" {
        return Ok(IsoOption::Auto);
    }
    let value: f64 = text.parse().map_err(|_| "a number between 0 and 1, or auto".to_owned())?;
    Isovalue::new(value).map(IsoOption::Value).map_err(|e| e.to_string())
}

/// Whether a file is a frame that `pack` made.
pub fn is_frame(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("mnf"))
}

impl Options {
    /// What was asked for and tells in the bytes of the mesh, by the options' names.
    pub fn settings(&self) -> Settings {
        let mut settings = self.sampling.settings();
        let iso = match self.iso {
            IsoOption::Auto => json!("auto"),
            IsoOption::Value(value) => json!(value.value()),
        };
        for (name, value) in [
            ("method", json!(self.method)),
            ("smooth", json!(self.smooth)),
            ("sigma", json!(self.sigma)),
            ("iso", iso),
            ("detail", json!(self.detail)),
            ("normals", json!(self.normals)),
            ("attributes", json!(self.attributes)),
            ("simplify", json!(self.simplify)),
            ("drop-smaller", json!(self.drop_smaller)),
            ("smallest-drop", json!(self.smallest_drop)),
            ("compress", json!(self.compress)),
        ] {
            settings.insert(name.to_owned(), value);
        }
        self.up.settings(&mut settings);
        settings
    }

    pub fn surfacing(&self) -> Result<Surfacing, Error> {
        Ok(Surfacing {
            smooth: self.smooth.map_or(Ok(Smooth::USUAL), Smooth::new)?,
            sigma: self.sigma.map(Sigma::new).transpose()?,
            iso: match self.iso {
                IsoOption::Auto => None,
                IsoOption::Value(value) => Some(value),
            },
            detail: if self.detail { Detail::Recovered } else { Detail::Smoothed },
            normals: if self.normals { Normals::Gradient } else { Normals::None },
        })
    }

    /// Whether all inputs are packed frames.
    pub fn packed(&self) -> bool {
        self.inputs.iter().all(|input| is_frame(input))
    }

    /// Refuses options of another indicator's surface.
    pub fn refuse_of_others(&self, kind: IndicatorKind) -> Result<(), Error> {
        let (given, why) = match kind {
            IndicatorKind::Cloud => (
                [
                    ("--sigma", self.sigma.is_some()),
                    ("--iso", matches!(self.iso, IsoOption::Value(_))),
                    ("--detail", self.detail),
                ],
                "is for --indicator counting and symmetry: the surface lies where distances told by clouds are 0, and --smooth \
                 says how calm it is",
            ),
            IndicatorKind::Counting | IndicatorKind::Symmetry => (
                [("--smooth", self.smooth.is_some()), ("", false), ("", false)],
                "is for --indicator cloud: --sigma says how smooth the surface of others is",
            ),
        };
        match given.into_iter().find(|&(_, given)| given) {
            None => Ok(()),
            Some((option, _)) => Err(Error::Request(format!("{option} {why}"))),
        }
    }

    /// Refuses what a frame that is sampled already cannot give.
    pub fn validate_frame_input(&self, input: &Path) -> Result<(), Error> {
        let refuse = |what: &str| {
            Err(Error::Request(format!("{}: {what} needs the particles themselves", input.display())))
        };
        if let Some(option) = self.sampling.given() {
            return refuse(option);
        }
        if self.method != MethodName::Dif {
            return refuse("--method");
        }
        if self.attributes.as_ref().is_some_and(|names| names != &["none"]) {
            return refuse("--attributes");
        }
        Ok(())
    }

    /// What a frame may take of the machine. Kernel methods run on the processor.
    pub fn resources(
        &self,
        output: &Path,
        input_bytes: impl FnOnce() -> Option<u64>,
    ) -> Result<Resources, Error> {
        let resources = self.run.resources(output, input_bytes)?;
        Ok(match self.method {
            MethodName::Dif => resources,
            _ => Resources { backend: Arc::new(Cpu), ..resources },
        })
    }

    /// What is to be left out of the surface.
    pub fn reduction(&self) -> Result<Reduction, Error> {
        if let Some(volume) = self.drop_smaller.filter(|volume| !(volume.is_finite() && *volume > 0.0)) {
            return Err(Error::Request(format!("--drop-smaller must be a positive volume; {volume} is not")));
        }
        Ok(Reduction {
            tolerance: self.simplify.map(Tolerance::new).transpose()?,
            least_volume_cells: self.drop_smaller,
            smallest_drop: self.smallest_drop.filter(|&particles| particles > 1),
        })
    }

    /// Chunks are simplified whole, and every thread has its own.
    pub fn validate_memory(&self, reduction: &Reduction, resources: &Resources) -> Result<(), Error> {
        let least = SMALLEST_BUDGET.0 + BYTES_A_THREAD * rayon::current_num_threads() as u64;
        if reduction.tolerance.is_some() && resources.budget.0 < least {
            let (least, threads) = (ByteSize(least), rayon::current_num_threads());
            return Err(Error::Request(format!(
                "--simplify with {threads} threads needs --memory of {least}; fewer --threads need less"
            )));
        }
        Ok(())
    }

    /// How the file is laid out, where the format leaves a choice.
    pub fn layout(&self, orientation: Orientation) -> Layout {
        let compression = if self.compress { Compression::Meshopt } else { Compression::None };
        Layout { up: orientation.file, compression }
    }

    /// Refuses what is asked for and the format cannot hold.
    pub fn validate_format(&self, format: MeshFormat) -> Result<(), Error> {
        let refuse = |what: &str| {
            Err(Error::Request(format!("{}: {format} cannot hold {what}", self.output.display())))
        };
        if !matches!(format, MeshFormat::Glb(_)) && self.compress {
            return Err(Error::Request(format!("{}: --compress goes with .glb", self.output.display())));
        }
        self.up.validate(format)?;
        if self.normals && !format.holds_normals() {
            return refuse("vertex normals");
        }
        if self.attributes.as_ref().is_some_and(|a| a != &["none"]) && !format.holds_attributes() {
            return refuse("vertex attributes");
        }
        Ok(())
    }

    /// The numbers of the attributes to carry.
    pub fn carried(
        &self,
        input: &Path,
        file: &ParticleFile,
        format: MeshFormat,
    ) -> Result<Vec<usize>, Error> {
        let attributes = file.particles.attributes();
        let velocity = velocity_attribute(attributes);
        let Some(names) = &self.attributes else {
            return Ok(velocity.filter(|_| format.holds_attributes()).into_iter().collect());
        };
        if names == &["none"] {
            return Ok(Vec::new());
        }
        let mut carried = Vec::new();
        for name in names {
            let named = attributes.iter().position(|a| a.name == *name);
            let found = named.or(velocity.filter(|_| name == "velocity")).ok_or_else(|| {
                let known: Vec<_> = attributes.iter().map(|a| a.name.as_str()).collect();
                let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
                Error::Request(format!("{}: no attribute {name:?}; there are: {known}", input.display()))
            })?;
            if !carried.contains(&found) {
                carried.push(found);
            }
        }
        Ok(carried)
    }

    /// What simplifying and writing take beyond the surface, in words.
    fn further_needs(&self, format: MeshFormat, estimate: &Estimate) -> String {
        let mut needs = String::new();
        if self.simplify.is_some() {
            let threads = BYTES_A_THREAD * rayon::current_num_threads() as u64;
            // Two passes hold the triangles that are left as three numbers of 64 bits.
            needs += &format!(
                "\nsimplifying takes up to {} more, and {} of memory or scratch",
                ByteSize(threads),
                ByteSize(3 * estimate.surface)
            );
        }
        if format.holds_whole_mesh() {
            let bytes = ByteSize(3 * estimate.surface);
            needs += &format!("\n{format} is written from memory: up to {bytes} more");
        }
        needs
    }

    /// The frame, from particles or as it was packed; `None` where only an estimate was asked for.
    fn frame(
        &self,
        input: &Path,
        (request, surfacing): (&SamplingRequest, &Surfacing),
        format: MeshFormat,
        resources: Resources,
        timings: &mut Timings,
        notes: &Notes,
    ) -> Result<Option<Frame>, Error> {
        let in_file = |fault: FrameError| Error::Frame { path: input.to_owned(), fault };
        if is_frame(input) {
            let sampled = open_frame(input, resources.budget.0 / 4)?;
            timings.done("open");
            self.refuse_of_others(sampled.indicator.kind())?;
            let particles = sampled.facts.census.binned;
            notes.say(format!("{}: {particles} particles, packed frame", input.display()));
            if self.dry_run {
                let output = self.output.display();
                crate::print(&format!("would reconstruct {particles} particles into {output}"))?;
                return Ok(None);
            }
            return Ok(Some(Frame::from_sampled(sampled, surfacing, resources)));
        }
        let file = open_particles(input, unpacking(&resources))?;
        timings.done("open");
        notes.say(format!("{}: {} particles, {}", input.display(), file.particles.len(), file.format));
        let carried = self.carried(input, &file, format)?;
        let sampling = request.sampling(input, &file, carried, resources, notes)?;
        timings.done("spacing");
        let counted = Counted::for_surface(&file.particles, &sampling, surfacing).map_err(in_file)?;
        timings.done("count");
        if self.dry_run {
            let (estimate, budget) = (counted.estimate(), sampling.resources.budget);
            let plan = estimate.plan(budget);
            crate::print(&format!(
                "would reconstruct {} particles with cells of {} into {}\n\
                 memory: about {} of {}; all in memory would take {}\nscratch: at most about {} in {}{}",
                counted.census().binned,
                sampling.grid.cell_size(),
                self.output.display(),
                ByteSize(estimate.peak(plan)),
                ByteSize(budget.0),
                ByteSize(estimate.in_core()),
                ByteSize(file.particles.scratch_bytes() + estimate.scratch(plan)),
                sampling.resources.scratch.display(),
                self.further_needs(format, &estimate),
            ))?;
            return Ok(None);
        }
        Frame::sample_counted(counted, sampling.resources.budget, timings).map(Some).map_err(in_file)
    }
}

/// Runs the command.
pub fn run(options: &Options) -> Result<Verdict, Error> {
    let inputs = Inputs::of(&options.inputs)?;
    let naming = Naming::of(&options.output)?;
    match (inputs, naming) {
        (None, None) => run_frame(options, &options.inputs[0]),
        (inputs, Some(naming)) => {
            let inputs = inputs.unwrap_or_else(|| Inputs::Files(options.inputs.clone()));
            sequence::run(options, &inputs, &naming)
        }
        (Some(inputs), None) => Err(Error::Request(format!(
            "{}: one file for the frames of {}; write {{}} where their numbers go, or name a folder",
            options.output.display(),
            inputs.describe()
        ))),
    }
}

fn run_frame(options: &Options, input: &Path) -> Result<Verdict, Error> {
    let notes = options.run.notes();
    options.sequence.refuse_for_one_frame()?;
    let request = options.request()?;
    let surfacing = options.surfacing()?;
    let reduction = options.reduction()?;
    if is_frame(input) {
        options.validate_frame_input(input)?;
    }
    let resources = options.resources(&options.output, || bytes_of([input]))?;
    options.validate_memory(&reduction, &resources)?;
    refuse_same_file(file_and_step(input).0, &options.output)?;
    if let Some(stats) = &options.stats {
        refuse_same_file(input, stats)?;
        refuse_same_file(&options.output, stats)?;
        options.prepare_stats()?;
    }
    let replace = if options.run.overwrite { Replace::Allow } else { Replace::Refuse };
    let prepare = || MeshOutput::prepare(&options.output, replace);
    let (output, unfinished) = interrupt::guard(prepare, MeshOutput::temporary)?;
    options.validate_format(output.format())?;
    let orientation = options.up.orientation(input, output.format());
    let output = output.with_layout(options.layout(orientation));
    let format = output.format();

    let mut timings = Timings::default();
    let in_file = |fault| Error::Frame { path: input.to_owned(), fault };
    let backend = Arc::clone(&resources.backend);
    let made = options.frame(input, (&request, &surfacing), format, resources, &mut timings, &notes)?;
    let Some(frame) = made else { return Ok(Verdict::Good) };
    report_lattice(&frame, &notes);
    let calibrated = frame.calibrate(&surfacing, None, &mut timings).map_err(in_file)?;
    let measured = calibrated.measured();
    let mesh = calibrated.surface(&mut timings).map_err(in_file)?;
    warnings(&frame).iter().for_each(|warning| notes.say(format!("warning: {warning}")));
    measured.iter().for_each(|measured| report_calibration(&frame, measured, surfacing.iso, &notes));
    let lost = frame.lost(&mesh).map_err(in_file)?;
    LeftOut { lost, ..frame.facts().census.into() }.say(request.field, &notes);
    if let Some(shortfall) = frame.shortfall(&mesh).map_err(in_file)? {
        notes.say(format!(
            "warning: {shortfall}{}",
            advice(options, frame.dif().is_some_and(SampledDif::is_clouds), None)
        ));
    }
    let width = coordinate_width(&mesh, mesh.grid().cell_size(), format, &notes)?;
    let mesh: Box<dyn MeshSource> = if reduction.is_none() {
        Box::new(mesh)
    } else {
        let simplified = frame.simplify(mesh, &reduction, &mut timings).map_err(in_file)?;
        report_simplified(&simplified, &reduction, &notes);
        Box::new(simplified)
    };
    if let Some(warning) = merged(&*mesh, format, &options.output)? {
        notes.say(format!("warning: {warning}"));
    }
    let bytes = output.write(&orientation.turned(&*mesh), width)?;
    drop(unfinished);
    timings.done("write");
    notes.say(format!(
        "{}: {} vertices, {} triangles, {} in {:.2} s",
        options.output.display(),
        mesh.vertex_count(),
        mesh.triangle_count(),
        ByteSize(bytes),
        timings.total(),
    ));
    report_laps(&timings, &notes);
    report_device(&*backend, 1, &notes);
    if options.stats.is_some() {
        let iso = measured.and_then(|measured| measured.calibration.iso());
        let mut record = options.record([input, &options.output], &frame, iso, &*mesh, bytes, &timings);
        record["in_no_surface"] = json!(lost);
        options.append_stats(&record)?;
    }
    Ok(Verdict::Good)
}

/// f64 where f32 would move vertices by more than 1 / 256 of a cell, or not hold them, if the format can.
pub fn coordinate_width(
    surface: &Stitched,
    cell_size: f64,
    format: MeshFormat,
    notes: &Notes,
) -> Result<CoordinateWidth, Error> {
    let farthest = surface.farthest_coordinate();
    let step = cell_size / 256.0;
    let holds = farthest <= f64::from(f32::MAX) && step >= f64::from(f32::MIN_POSITIVE);
    if holds && farthest * f64::from(f32::EPSILON) <= step {
        return Ok(CoordinateWidth::F32);
    }
    if format.holds_f64() {
        notes.detail("coordinates are written as f64: f32 is too coarse for them");
        return Ok(CoordinateWidth::F64);
    }
    if !holds {
        return Err(Error::Request(format!(
            "{format} holds coordinates as f32, which these exceed; use .ply"
        )));
    }
    notes.say(format!("warning: {format} holds coordinates as f32, too coarse for these; .ply holds f64"));
    Ok(CoordinateWidth::F32)
}

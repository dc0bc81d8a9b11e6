//! `meniscus reconstruct` for the frames of a simulation: side by side, whatever single frames bring, and resumable.

mod watch;

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError, mpsc};
use std::time::{Duration, Instant};

use bytesize::ByteSize;
use clap::Args;
use meniscus::error::{Cause, Error};
use meniscus::frame::{
    self, Counted, Frame, FrameError, Normals, Resources, Sampling, Surfacing, carried_infos,
};
use meniscus::io::bytes::Unpacking;
use meniscus::io::input::open_particles;
use meniscus::io::mnf::open_frame;
use meniscus::io::output::{MeshFormat, MeshOutput};
use meniscus::io::whole::{Replace, sweep};
use meniscus::io::{CoordinateWidth, ReadError, WriteError, WriteFault};
use meniscus::laps::Laps;
use meniscus::mesh::source::MeshSource;
use meniscus::mesh::{Mesh, VertexAttribute};
use meniscus::particles::Particles;
use meniscus::plateau::{Plateau, recipe_at};
use meniscus::sequence::SequenceError;
use meniscus::sequence::frozen::{Frozen, Measured, Origin, Trust, measure};
use meniscus::sequence::inputs::{FrameFile, Inputs, Selection, gaps, missing_path};
use meniscus::sequence::naming::Naming;
use meniscus::sequence::series::{Listed, Manifest, Series};
use meniscus::sequence::state::{Record, Settings, Stamp, State, Store};
use rayon::ThreadPool;
use serde_json::{Value, json};

use crate::Verdict;
use crate::interrupt;
use crate::lanes::{Division, Gate};
use crate::progress::{Progress, ProgressMode};
use crate::reconstruct::{Options, coordinate_width, is_frame};
use crate::run::Notes;
use crate::sampling::SamplingRequest;

use watch::Watch;

/// Frames that are looked at for one that is deep enough to measure.
const LOOKED_AT: usize = 64;
/// Between two writings of what lists all frames, at the least.
const SERIES_PAUSE: Duration = Duration::from_secs(1);
/// Between two looks at a simulation that runs.
const POLL: Duration = Duration::from_millis(250);

#[derive(Args)]
#[command(next_help_heading = "Sequences")]
pub struct SequenceOptions {
    /// The first frame of the sequence.
    #[arg(long, value_name = "N")]
    start: Option<u64>,
    /// The last frame of the sequence.
    #[arg(long, value_name = "N")]
    end: Option<u64>,
    /// Every Nth frame.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    step: Option<u64>,
    /// Convert these frames of the sequence only, both ends included, as one of several jobs.
    #[arg(long, value_name = "A..B", value_parser = range)]
    frames: Option<(u64, u64)>,
    /// Go on: skip what is done, whole, and made with the same settings; make the rest.
    #[arg(long)]
    resume: bool,
    /// Follow a simulation that runs, until --end, or until nothing has come for so many seconds.
    #[arg(long, value_name = "SECONDS", num_args = 0..=1, require_equals = true, default_missing_value = "inf")]
    watch: Option<f64>,
    /// Frames a second, for times where the files have none.
    #[arg(long, value_name = "RATE")]
    fps: Option<f64>,
    /// Measure what all frames have in common, write the state file, print the frames' numbers, one a line, and stop.
    #[arg(long, conflicts_with_all = ["watch", "dry_run"])]
    plan: bool,
    /// Bars on a terminal, or a line for each frame.
    #[arg(long, value_enum, default_value_t = ProgressMode::Auto)]
    progress: ProgressMode,
}

fn range(text: &str) -> Result<(u64, u64), String> {
    let numbers = text.split_once("..").and_then(|(a, b)| Some((a.parse().ok()?, b.parse().ok()?)));
    numbers.filter(|(a, b)| a <= b).ok_or_else(|| "two numbers in order, as 100..199".to_owned())
}

impl SequenceOptions {
    /// Refuses what has no meaning for a single frame.
    pub fn refuse_for_one_frame(&self) -> Result<(), Error> {
        let given = [
            ("--start", self.start.is_some()),
            ("--end", self.end.is_some()),
            ("--step", self.step.is_some()),
            ("--frames", self.frames.is_some()),
            ("--resume", self.resume),
            ("--watch", self.watch.is_some()),
            ("--fps", self.fps.is_some()),
            ("--plan", self.plan),
        ];
        match given.into_iter().find(|(_, given)| *given) {
            None => Ok(()),
            Some((name, _)) => Err(Error::Request(format!("{name} needs a sequence: an output with {{}}"))),
        }
    }

    fn validate(&self) -> Result<(), Error> {
        if let Some(fps) = self.fps.filter(|fps| !(fps.is_finite() && *fps > 0.0)) {
            return Err(Error::Request(format!("--fps must be a positive number; {fps} is not")));
        }
        if let Some(seconds) = self.watch.filter(|seconds| seconds.is_nan() || *seconds < 0.0) {
            return Err(Error::Request(format!("--watch takes seconds; {seconds} are none")));
        }
        Ok(())
    }

    fn selection(&self) -> Selection {
        let all = Selection::default();
        Selection {
            start: self.start.unwrap_or(all.start),
            end: self.end.unwrap_or(all.end),
            step: self.step.unwrap_or(all.step),
        }
    }

    /// Whether a frame of the sequence is one of those that this run converts.
    fn wants(&self, number: u64) -> bool {
        self.frames.is_none_or(|(first, last)| (first..=last).contains(&number))
    }
}

/// What is known before any frame is read.
struct Setup<'a> {
    options: &'a Options,
    inputs: &'a Inputs,
    naming: Naming,
    request: SamplingRequest,
    surfacing: Surfacing,
    resources: Resources,
    notes: Notes,
}

/// Runs the command.
pub fn run(options: &Options, inputs: &Inputs, naming: Naming) -> Result<Verdict, Error> {
    options.sequence.validate()?;
    let setup = Setup {
        options,
        inputs,
        request: options.sampling.validate()?,
        surfacing: options.surfacing()?,
        resources: options.run.resources(&naming.folder().join("frame"))?,
        notes: options.run.notes(),
        naming,
    };
    let frames = setup.frames()?;
    let Some(first) = frames.first() else {
        if options.sequence.watch.is_none() {
            return Err(SequenceError::NoFrames(inputs.describe()).into());
        }
        return setup.wait_for_first();
    };
    setup.run(first, &frames)
}

impl Setup<'_> {
    /// The frames of the sequence that are there now.
    fn frames(&self) -> Result<Vec<FrameFile>, Error> {
        Ok(self.options.sequence.selection().of(self.inputs.list()?))
    }

    fn wait_for_first(&self) -> Result<Verdict, Error> {
        let begun = Instant::now();
        self.notes.say(format!("{}: waiting for the first frame", self.inputs.describe()));
        loop {
            std::thread::sleep(POLL);
            let frames = self.frames()?;
            if let Some(first) = frames.first() {
                return self.run(first, &frames);
            }
            if self.options.sequence.watch.is_some_and(|idle| begun.elapsed().as_secs_f64() > idle) {
                return Err(SequenceError::NoFrames(self.inputs.describe()).into());
            }
        }
    }

    fn run(&self, first: &FrameFile, frames: &[FrameFile]) -> Result<Verdict, Error> {
        let Self { options, naming, notes, .. } = self;
        let format = self.format(first)?;
        self.refuse_own_inputs(frames)?;
        let sequence = naming.sequence(first);
        let store = Store::beside(&sequence);
        let wanted: Vec<&FrameFile> =
            frames.iter().filter(|frame| options.sequence.wants(frame.number)).collect();
        if wanted.is_empty() && options.sequence.watch.is_none() {
            return Err(Error::Request(format!("{}: --frames names none of them", self.inputs.describe())));
        }
        let kept = self.kept_state(&store, frames)?;
        if !options.sequence.resume && !options.run.overwrite {
            let taken = wanted.iter().map(|frame| naming.path(frame)).find(|path| path.exists());
            if let Some(path) = taken.filter(|_| !options.sequence.plan) {
                let exists = WriteFault::ExistsInSequence;
                return Err(WriteError::new(&path, exists).into());
            }
        }
        if options.dry_run {
            return self.dry_run(kept, &store, frames, &wanted);
        }
        std::fs::create_dir_all(naming.folder()).map_err(|e| WriteError::new(naming.folder(), e))?;
        sweep(naming.folder());
        sweep(store.folder());
        interrupt::resumable();
        let state = match kept {
            Some(state) => {
                notes.say(format!(
                    "going on with {}: {}",
                    store.state_path().display(),
                    describe(&state.frozen)
                ));
                state
            }
            None => {
                let state = State::new(self.settings(), self.freeze(frames)?);
                interrupt::undisturbed(|| store.save(&state))?;
                state
            }
        };
        if options.sequence.plan {
            let numbers: Vec<String> = wanted.iter().map(|frame| frame.number.to_string()).collect();
            crate::print(&numbers.join("\n"))?;
            return Ok(Verdict::Good);
        }
        let series: Vec<Box<dyn Series>> = vec![Box::new(Manifest::beside(&sequence, options.sequence.fps))];
        Conversion::new(self, format, store, state, wanted.len()).run(frames, &series)
    }

    /// What the outputs' names say, able to hold what is asked for.
    fn format(&self, first: &FrameFile) -> Result<MeshFormat, Error> {
        let path = self.naming.path(first);
        let unknown = || WriteError::new(&path, WriteFault::UnknownExtension { known: MeshFormat::KNOWN });
        let format = MeshFormat::of(&path).ok_or_else(unknown)?;
        self.options.validate_format(format)?;
        self.options.refuse_for_sequence()?;
        Ok(format)
    }

    fn refuse_own_inputs(&self, frames: &[FrameFile]) -> Result<(), Error> {
        let Ok(folder) = self.naming.folder().canonicalize() else { return Ok(()) };
        let own = |frame: &&FrameFile| {
            let output = self.naming.path(frame);
            output.file_name() == frame.path.file_name()
                && frame.path.canonicalize().is_ok_and(|path| path.parent() == Some(&folder))
        };
        match frames.iter().find(own) {
            None => Ok(()),
            Some(frame) => {
                Err(Error::Request(format!("{}: is given for two purposes", frame.path.display())))
            }
        }
    }

    /// What tells in the bytes of all frames.
    fn settings(&self) -> Settings {
        self.options.settings()
    }

    /// The state that is there, if it is of these settings and of these inputs.
    fn kept_state(&self, store: &Store, frames: &[FrameFile]) -> Result<Option<State>, Error> {
        let anew = self.options.run.overwrite;
        let state = match store.load() {
            Err(_) if anew => return Ok(None),
            found => found?,
        };
        let Some(state) = state else { return Ok(None) };
        let mut differing = state.differing(&self.settings());
        let measured_on = frames.iter().find(|frame| frame.number == state.frozen.frame);
        if measured_on.and_then(|frame| Stamp::of(&frame.path).ok()).is_some_and(|s| s != state.frozen.input)
        {
            let comma = if differing.is_empty() { "" } else { ", " };
            let _ = write!(differing, "{comma}input frame {}", state.frozen.frame);
        }
        if differing.is_empty() {
            return Ok(Some(state));
        }
        if anew || self.options.sequence.resume {
            self.notes
                .say(format!("{}: of other settings ({differing}), made anew", store.state_path().display()));
            return Ok(None);
        }
        Err(SequenceError::Settings { path: store.state_path(), differing }.into())
    }

    /// Measures what holds for all frames on the first that can tell.
    fn freeze(&self, frames: &[FrameFile]) -> Result<Frozen, Error> {
        let idle = self.options.sequence.watch;
        let mut watch = idle.map(|idle| Watch::new(idle, self.options.sequence.selection()));
        let mut best: Option<(Frozen, Trust)> = None;
        let mut first_error = None;
        let mut looked_at = 0;
        let mut current = frames.to_vec();
        loop {
            let ready = match &mut watch {
                None => std::mem::take(&mut current),
                Some(watch) => watch.ready(&current),
            };
            for frame in ready {
                if looked_at == LOOKED_AT {
                    break;
                }
                looked_at += 1;
                match self.measure_on(&frame, best.as_ref().filter(|(_, trust)| *trust == Trust::Lattice)) {
                    Ok((frozen, Trust::Sound)) => {
                        self.notes.say(format!(
                            "measured on {}: {}",
                            frame.path.display(),
                            describe(&frozen)
                        ));
                        return Ok(frozen);
                    }
                    Ok((frozen, trust)) => {
                        if best.as_ref().is_none_or(|(_, known)| *known < trust) {
                            best = Some((frozen, trust));
                        }
                    }
                    Err(error) if error.cause() == Cause::Input => {
                        if let Some(watch) = &mut watch {
                            watch.failed(frame.number);
                        }
                        first_error = first_error.or(Some(error));
                    }
                    Err(error) => return Err(error),
                }
            }
            match &mut watch {
                Some(watch) if looked_at < LOOKED_AT && !watch.is_over() => {
                    std::thread::sleep(POLL);
                    current = self.frames()?;
                }
                _ => break,
            }
        }
        match (best, first_error) {
            (Some((frozen, trust)), _) => {
                let what = match trust {
                    Trust::Shallow => "no fluid is deeper than the filters reach",
                    Trust::Lattice | Trust::Sound => "all particles stand on a lattice",
                };
                self.notes.say(format!(
                    "warning: {what}; measured on frame {}: {}",
                    frozen.frame,
                    describe(&frozen)
                ));
                Ok(frozen)
            }
            (None, Some(error)) => Err(error),
            (None, None) => Err(SequenceError::NoFrames(self.inputs.describe()).into()),
        }
    }

    /// What one frame says of all. The grid and mu0 are those of a lattice that came before, if one did.
    fn measure_on(
        &self,
        frame: &FrameFile,
        lattice: Option<&(Frozen, Trust)>,
    ) -> Result<(Frozen, Trust), Error> {
        let path = &frame.path;
        let input = Stamp::of(path).map_err(|e| ReadError::new(path, e.into()))?;
        let in_file = |fault: FrameError| Error::Frame { path: path.clone(), fault };
        if is_frame(path) {
            self.options.validate_frame_input(path)?;
            let (facts, dif) = open_frame(path, self.resources.budget.0 / 4)?;
            let (grid, spacing) = (facts.grid, facts.spacing);
            let frame_of_file = Frame::from_parts(facts, dif, self.resources.clone());
            let (recipe, plateau) = frame_of_file.recipe(&self.surfacing);
            let trust = match plateau {
                Plateau::Interior { .. } => Trust::Sound,
                Plateau::Shallow { .. } => Trust::Shallow,
            };
            let mean = frame_of_file.mean_count();
            let measured = Measured { grid, mean, iso: recipe.iso, trust };
            return Ok((frozen(frame.number, input, spacing, None, measured), trust));
        }
        let budget = self.resources.budget.0 / 8;
        let file = open_particles(path, Unpacking { in_memory: budget, scratch: &self.resources.scratch })?;
        let cells = self.request.cells(path, &file)?;
        let (grid, indicator) = match lattice {
            Some((frozen, _)) => (frozen.grid()?, frozen.indicator(self.request.indicator)?),
            None => (self.request.grid(cells.size)?, self.request.indicator),
        };
        let sampling =
            self.request.sampling_on(grid, indicator, cells.spacing, Vec::new(), self.resources.clone())?;
        let settled = lattice.is_some() || self.options.sampling.origin_given();
        let origin = if settled { Origin::Given } else { Origin::Free };
        let measured = measure(&file.particles, &sampling, origin, &self.surfacing).map_err(in_file)?;
        let mut frozen = frozen(frame.number, input, cells.spacing, cells.source, measured);
        if let Some((first, _)) = lattice {
            (frozen.spacing, frozen.spacing_source) = (first.spacing, first.spacing_source.clone());
        }
        Ok((frozen, measured.trust))
    }

    fn dry_run(
        &self,
        kept: Option<State>,
        store: &Store,
        frames: &[FrameFile],
        wanted: &[&FrameFile],
    ) -> Result<Verdict, Error> {
        let begun = Instant::now();
        let frozen = match &kept {
            Some(state) => state.frozen.clone(),
            None => self.freeze(frames)?,
        };
        let done = |frame: &&&FrameFile| {
            let output = self.naming.path(frame);
            let state = kept.as_ref().filter(|_| self.options.sequence.resume);
            state
                .is_some_and(|s| store.current(frame.number, &frame.path, &output, s.fingerprint()).is_some())
        };
        let skipped = wanted.iter().filter(done).count();
        let mut text = format!(
            "would convert {} of {} frames of {} to {}",
            wanted.len() - skipped,
            frames.len(),
            self.inputs.describe(),
            self.naming.path(&frames[0]).display(),
        );
        if skipped > 0 {
            let _ = write!(text, "; {skipped} are done");
        }
        let missing = gaps(frames);
        if missing.count > 0 {
            let _ = write!(text, "\nmissing: {missing}");
        }
        let _ = write!(text, "\n{}", describe(&frozen));
        // The largest file tells what the budget has to hold, and about what each frame takes.
        let size = |frame: &FrameFile| frame.path.metadata().map_or(0, |m| m.len());
        let total: u64 = wanted.iter().map(|frame| size(frame)).sum();
        if let Some(largest) = wanted.iter().max_by_key(|frame| size(frame)).filter(|f| !is_frame(&f.path)) {
            let unpacking =
                Unpacking { in_memory: self.resources.budget.0 / 8, scratch: &self.resources.scratch };
            let file = open_particles(&largest.path, unpacking)?;
            let indicator = frozen.indicator(self.request.indicator)?;
            let carried = self.options.carried(&largest.path, &file, self.format(largest)?)?;
            let sampling = self.request.sampling_on(
                frozen.grid()?,
                indicator,
                frozen.spacing,
                carried,
                self.resources.clone(),
            )?;
            let in_file = |fault| Error::Frame { path: largest.path.clone(), fault };
            let mut laps = Laps::default();
            let (census, estimate) = frame::estimate(&file.particles, &sampling).map_err(in_file)?;
            let sampled = Frame::sample(&file.particles, &sampling, &mut laps).map_err(in_file)?;
            let recipe = recipe_at(indicator, self.surfacing.sigma, self.surfacing.detail, frozen.iso()?);
            let mesh = sampled.surface_by(&recipe, self.surfacing.normals, &mut laps).map_err(in_file)?;
            let division = Division::of(wanted.len(), rayon::current_num_threads(), self.resources.budget);
            // 12 bytes a vertex and 13 a triangle, as .ply has it; attributes come on top.
            let bytes = 24 * mesh.vertex_count() + 13 * mesh.triangle_count();
            let share = size(largest).max(1) as f64;
            let scale = (wanted.len() - skipped) as f64 * total as f64 / wanted.len().max(1) as f64 / share;
            let _ = write!(
                text,
                "\nlargest frame {}: {} particles, {} triangles, {} in memory of {}; {} side by side\n\
                 disk: about {}\ntime: about {:.0} s",
                largest.number,
                census.binned,
                mesh.triangle_count(),
                ByteSize(estimate.in_core()),
                ByteSize(self.resources.budget.0),
                division.lanes,
                ByteSize((bytes as f64 * scale) as u64),
                (laps.total() * scale).max(begun.elapsed().as_secs_f64()).ceil(),
            );
        }
        crate::print(&text)?;
        Ok(Verdict::Good)
    }
}

fn frozen(
    frame: u64,
    input: Stamp,
    spacing: Option<f64>,
    source: Option<String>,
    measured: Measured,
) -> Frozen {
    Frozen {
        frame,
        input,
        spacing,
        spacing_source: source,
        cell_size: measured.grid.cell_size(),
        origin: measured.grid.origin().to_array(),
        mu0: measured.mean.map(|mean| mean.particles()),
        isovalue: measured.iso.value(),
    }
}

fn describe(frozen: &Frozen) -> String {
    let Frozen { spacing, spacing_source, cell_size, origin: [x, y, z], mu0, isovalue, .. } = frozen;
    let spacing = match (spacing, spacing_source) {
        (Some(spacing), Some(source)) => format!("spacing {spacing:.6} ({source}), "),
        _ => String::new(),
    };
    let mu0 = mu0.map_or(String::new(), |mu0| format!(", mu0 {mu0:.4}"));
    let origin =
        if [*x, *y, *z] == [0.0; 3] { String::new() } else { format!(", origin {x:.6},{y:.6},{z:.6}") };
    format!("{spacing}cell size {cell_size:.6}{origin}{mu0}, isovalue {isovalue:.4}")
}

/// The frames of a sequence on their way.
struct Conversion<'a> {
    setup: &'a Setup<'a>,
    format: MeshFormat,
    store: Store,
    state: State,
    fingerprint: u32,
    division: Division,
    gate: Gate,
    stop: AtomicBool,
}

/// A frame that was converted.
struct Done {
    record: Record,
    stats: Value,
    seconds: f64,
    warnings: Vec<String>,
}

/// What became of a frame.
struct Outcome {
    frame: FrameFile,
    result: Result<Done, Error>,
}

impl<'a> Conversion<'a> {
    fn new(setup: &'a Setup<'a>, format: MeshFormat, store: Store, state: State, frames: usize) -> Self {
        let threads = rayon::current_num_threads();
        let budget = setup.resources.budget;
        let frames = if setup.resources.backend.divides() { frames } else { frames.min(2) };
        let division = Division::of(frames, threads, budget);
        let fingerprint = state.fingerprint();
        let gate = Gate::new(division.lanes);
        Self { setup, format, store, state, fingerprint, division, gate, stop: AtomicBool::new(false) }
    }

    fn output(&self, frame: &FrameFile) -> PathBuf {
        self.setup.naming.path(frame)
    }

    fn current(&self, frame: &FrameFile) -> Option<Record> {
        self.store.current(frame.number, &frame.path, &self.output(frame), self.fingerprint)
    }

    /// Converts the frames, and those that come while it watches.
    fn run(&self, frames: &[FrameFile], series: &[Box<dyn Series>]) -> Result<Verdict, Error> {
        let options = &self.setup.options.sequence;
        let mut tally = Tally::new(self, series);
        tally.list(frames);
        let todo: Vec<FrameFile> = frames
            .iter()
            .filter(|frame| options.wants(frame.number))
            .filter(|frame| !(options.resume && tally.listed.contains_key(&frame.number)))
            .cloned()
            .collect();
        let wanted = frames.iter().filter(|frame| options.wants(frame.number)).count();
        if wanted > todo.len() {
            self.setup.notes.say(format!("{} of {wanted} frames are done already", wanted - todo.len()));
        }
        let size = |frame: &FrameFile| frame.path.metadata().map_or(0, |m| m.len());
        let mut watch = options.watch.map(|idle| Watch::new(idle, self.setup.options.sequence.selection()));
        let bytes = if watch.is_some() { 0 } else { todo.iter().map(size).sum() };
        let idle = todo.is_empty() && watch.is_none();
        let mode = if idle { ProgressMode::Never } else { options.progress };
        let (progress, notes) = Progress::start(mode, bytes, self.division.lanes, self.setup.notes.clone());
        tally.total = if watch.is_some() { 0 } else { todo.len() };

        let (to_lanes, jobs) = mpsc::channel::<FrameFile>();
        let jobs = Mutex::new(jobs);
        let (results, outcomes) = mpsc::channel();
        std::thread::scope(|scope| {
            for lane in 0..self.division.lanes {
                let (jobs, results, progress) = (&jobs, results.clone(), &progress);
                scope.spawn(move || self.lane(lane, jobs, &results, progress));
            }
            drop(results);
            let mut to_lanes = Some(to_lanes);
            let mut under_way = 0;
            if watch.is_none() {
                under_way = todo.len();
                todo.into_iter()
                    .for_each(|frame| to_lanes.iter().for_each(|to| drop(to.send(frame.clone()))));
                to_lanes = None;
            }
            loop {
                let outcome = match &mut watch {
                    None => outcomes.recv().ok(),
                    Some(_) => match outcomes.recv_timeout(POLL) {
                        Ok(outcome) => Some(outcome),
                        Err(mpsc::RecvTimeoutError::Disconnected) => None,
                        Err(mpsc::RecvTimeoutError::Timeout) => {
                            let Some(watch) = &mut watch else { continue };
                            if let Some(to) = &to_lanes {
                                for frame in watch.ready(&self.setup.frames()?) {
                                    let skip = options.resume && tally.listed.contains_key(&frame.number);
                                    if options.wants(frame.number) && !skip {
                                        under_way += 1;
                                        tally.total += 1;
                                        progress.lengthen(size(&frame));
                                        let _ = to.send(frame);
                                    }
                                }
                                if under_way == 0 && watch.is_over() {
                                    to_lanes = None;
                                }
                            }
                            continue;
                        }
                    },
                };
                let Some(Outcome { frame, result }) = outcome else { break };
                under_way -= 1;
                let failed = result.is_err();
                if tally.take(&frame, result, &notes, progress.has_bars())? {
                    self.stop.store(true, Ordering::Relaxed);
                }
                if let Some(watch) = watch.as_mut().filter(|_| failed) {
                    watch.failed(frame.number);
                }
                progress.advance(tally.done, tally.total, tally.failed.len(), size(&frame));
            }
            Ok::<_, Error>(())
        })?;
        progress.finish();
        tally.finish(&self.setup.frames()?)
    }

    /// Converts frames until there are no more.
    fn lane(
        &self,
        lane: usize,
        jobs: &Mutex<mpsc::Receiver<FrameFile>>,
        results: &mpsc::Sender<Outcome>,
        progress: &Progress,
    ) {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(self.division.threads).build();
        let pool = pool.expect("threads can be started");
        loop {
            let job = jobs.lock().unwrap_or_else(PoisonError::into_inner).recv();
            let Ok(frame) = job else { return };
            if self.stop.load(Ordering::Relaxed) {
                continue;
            }
            let result = self.convert(&frame, &pool, &|stage| {
                progress.stage(lane, || format!("frame {}: {stage}", frame.number));
            });
            progress.stage(lane, String::new);
            if results.send(Outcome { frame, result }).is_err() {
                return;
            }
        }
    }

    fn convert(&self, frame: &FrameFile, pool: &ThreadPool, stage: &dyn Fn(&str)) -> Result<Done, Error> {
        let Setup { options, resources, .. } = self.setup;
        let path = &frame.path;
        let in_file = |fault: FrameError| Error::Frame { path: path.clone(), fault };
        let input = Stamp::of(path).map_err(|e| ReadError::new(path, e.into()))?;
        let replace =
            if options.sequence.resume || options.run.overwrite { Replace::Allow } else { Replace::Refuse };
        let target = self.output(frame);
        let prepare = || MeshOutput::prepare(&target, replace);
        let (output, unfinished) = interrupt::guard(prepare, MeshOutput::temporary)?;

        let mut laps = Laps::default();
        stage("reading");
        let opening = Resources { budget: self.division.opening, ..resources.clone() };
        let mut time = None;
        let (sampled, infos, permit) = if is_frame(path) {
            options.validate_frame_input(path)?;
            let permit = self.gate.enter();
            let (facts, dif) = open_frame(path, self.division.share.0 / 4)?;
            laps.lap("open");
            let share = Resources { budget: self.division.share, ..resources.clone() };
            (Some(Frame::from_parts(facts, dif, share)), Vec::new(), permit)
        } else {
            let unpacking = Unpacking { in_memory: opening.budget.0 / 2, scratch: &opening.scratch };
            let file = pool.install(|| open_particles(path, unpacking))?;
            laps.lap("open");
            time = file.time;
            let carried = options.carried(path, &file, self.format)?;
            let infos = carried_infos(file.particles.attributes(), &carried);
            let mut sampling = self.sampling(carried, opening)?;
            stage("counting");
            let mut counted = pool.install(|| Counted::of(&file.particles, &sampling));
            laps.lap("count");
            let fits = match &counted {
                Ok(counted) => counted.in_core_bytes() <= self.division.share.0,
                Err(FrameError::OverBudget(_)) => false,
                Err(_) => true,
            };
            let beside = resources.backend.divides() && fits;
            stage("waiting");
            let permit = if beside { self.gate.enter() } else { self.gate.enter_alone() };
            let budget = if beside { self.division.share } else { self.division.alone };
            laps.lap("wait");
            if matches!(counted, Err(FrameError::OverBudget(_))) {
                drop(counted);
                sampling.resources.budget = budget;
                counted = Counted::of(&file.particles, &sampling);
            }
            stage("sampling");
            let sampled = match counted {
                Err(FrameError::NoParticles(_)) => None,
                Err(fault) => return Err(in_file(fault)),
                Ok(counted) if beside => Some(
                    pool.install(|| Frame::sample_counted(counted, budget, &mut laps)).map_err(in_file)?,
                ),
                Ok(counted) => Some(Frame::sample_counted(counted, budget, &mut laps).map_err(in_file)?),
            };
            (sampled, infos, permit)
        };
        let in_pool = permit.is_beside();

        stage("meshing");
        let iso = self.state.frozen.iso()?;
        let Surfacing { sigma, detail, normals, .. } = self.setup.surfacing;
        let mut warnings = Vec::new();
        let surface = match &sampled {
            None => None,
            Some(sampled) => {
                let recipe = recipe_at(sampled.facts().indicator, sigma, detail, iso);
                let surface =
                    within(in_pool.then_some(pool), || sampled.surface_by(&recipe, normals, &mut laps));
                warnings.extend(sampled.warnings());
                match surface {
                    Err(FrameError::NoSurface { .. }) => {
                        warnings.push("the field is nowhere above the isovalue: an empty mesh".into());
                        None
                    }
                    surface => Some(surface.map_err(in_file)?),
                }
            }
        };

        stage("writing");
        let quiet = Notes::none();
        let cell_size = self.state.frozen.cell_size;
        let empty;
        let (mesh, width): (&dyn MeshSource, CoordinateWidth) = match &surface {
            Some(mesh) => (mesh, coordinate_width(mesh, cell_size, self.format, &quiet)?),
            None => {
                empty = empty_mesh(normals, infos);
                (&empty, CoordinateWidth::F32)
            }
        };
        let bytes = within(in_pool.then_some(pool), || output.write(mesh, width))?;
        drop(unfinished);
        drop(permit);
        laps.lap("write");

        let particles = sampled.as_ref().map_or(0, |sampled| sampled.facts().census.binned);
        let record = Record {
            frame: frame.number,
            input,
            fingerprint: self.fingerprint,
            file: target.file_name().unwrap_or_default().to_string_lossy().into_owned(),
            bytes,
            time,
            particles: particles as u64,
            vertices: mesh.vertex_count(),
            triangles: mesh.triangle_count(),
        };
        interrupt::undisturbed(|| self.store.keep(&record))?;
        let mut stats = match &sampled {
            Some(sampled) => options.record([path, &target], sampled, iso, mesh, bytes, &laps),
            None => json!({ "input": path, "output": target, "particles": 0, "vertices": 0, "triangles": 0 }),
        };
        stats["frame"] = json!(frame.number);
        stats["time"] = json!(Listed::of(&record, options.sequence.fps).time);
        Ok(Done { record, stats, seconds: laps.total(), warnings })
    }

    fn sampling(&self, carried: Vec<usize>, resources: Resources) -> Result<Sampling, Error> {
        let frozen = &self.state.frozen;
        let indicator = frozen.indicator(self.setup.request.indicator)?;
        self.setup.request.sampling_on(frozen.grid()?, indicator, frozen.spacing, carried, resources)
    }
}

/// In a pool, or with all threads.
fn within<T: Send>(pool: Option<&ThreadPool>, act: impl FnOnce() -> T + Send) -> T {
    match pool {
        Some(pool) => pool.install(act),
        None => act(),
    }
}

/// What is written where there is no surface: every program can load it, and finds what it expects.
fn empty_mesh(normals: Normals, infos: Vec<meniscus::particles::AttributeInfo>) -> Mesh {
    let attribute = |info: meniscus::particles::AttributeInfo| VertexAttribute {
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

/// What became of the frames so far.
struct Tally<'a> {
    conversion: &'a Conversion<'a>,
    series: &'a [Box<dyn Series>],
    /// All frames that can be loaded, of this run or another.
    listed: BTreeMap<u64, Listed>,
    /// Why a frame is not there.
    failed: BTreeMap<u64, String>,
    fatal: Option<Error>,
    done: usize,
    total: usize,
    begun: Instant,
    series_written: Instant,
}

impl<'a> Tally<'a> {
    fn new(conversion: &'a Conversion<'a>, series: &'a [Box<dyn Series>]) -> Self {
        Self {
            conversion,
            series,
            listed: BTreeMap::new(),
            failed: BTreeMap::new(),
            fatal: None,
            done: 0,
            total: 0,
            begun: Instant::now(),
            series_written: Instant::now(),
        }
    }

    /// Lists what is done already.
    fn list(&mut self, frames: &[FrameFile]) {
        let fps = self.conversion.setup.options.sequence.fps;
        for frame in frames {
            if let Some(record) = self.conversion.current(frame) {
                self.listed.insert(frame.number, Listed::of(&record, fps));
            }
        }
    }

    /// Notes a frame; true where it makes no sense to go on with any other.
    fn take(
        &mut self,
        frame: &FrameFile,
        result: Result<Done, Error>,
        notes: &Notes,
        bars: bool,
    ) -> Result<bool, Error> {
        let options = self.conversion.setup.options;
        self.done += 1;
        match result {
            Ok(Done { record, stats, seconds, warnings }) => {
                self.failed.remove(&frame.number);
                for warning in warnings {
                    notes.say(format!("warning: {}: {warning}", frame.path.display()));
                }
                let line = format!(
                    "{}: {} vertices, {} triangles, {} in {seconds:.2} s ({} of {})",
                    self.conversion.output(frame).display(),
                    record.vertices,
                    record.triangles,
                    ByteSize(record.bytes),
                    self.done,
                    self.total,
                );
                if bars {
                    notes.detail(line)
                } else {
                    notes.say(line)
                }
                self.listed.insert(frame.number, Listed::of(&record, options.sequence.fps));
                options.append_stats(&stats)?;
                if self.series_written.elapsed() > SERIES_PAUSE {
                    self.write_series()?;
                }
            }
            Err(error) => {
                notes.error(format!("meniscus: {error}"));
                options.append_stats(&json!({
                    "frame": frame.number,
                    "input": frame.path,
                    "error": error.to_string(),
                }))?;
                self.failed.insert(frame.number, error.to_string());
                if matches!(error.cause(), Cause::Output | Cause::Device) {
                    self.fatal.get_or_insert(error);
                    return Ok(true);
                }
            }
        }
        Ok(false)
    }

    fn write_series(&mut self) -> Result<(), Error> {
        let listed: Vec<_> = self.listed.values().cloned().collect();
        for series in self.series {
            interrupt::undisturbed(|| series.write(&listed))?;
        }
        self.series_written = Instant::now();
        Ok(())
    }

    fn finish(mut self, frames: &[FrameFile]) -> Result<Verdict, Error> {
        let Setup { options, notes, inputs, .. } = self.conversion.setup;
        // Other jobs may have done frames meanwhile.
        let own = std::mem::take(&mut self.listed);
        self.list(frames);
        self.listed.extend(own);
        self.write_series()?;
        let made = self.done - self.failed.len().min(self.done);
        let missing = gaps(frames);
        let gone: Vec<u64> = missing.numbers().filter(|&number| options.sequence.wants(number)).collect();
        if missing.sparse && !gone.is_empty() {
            notes.say(format!("{}: there are no frames {missing}", inputs.describe()));
        } else {
            for number in gone {
                let path = missing_path(frames, number);
                self.failed.insert(number, format!("{}: missing", path.display()));
            }
        }
        notes.say(format!(
            "{}: {made} frames in {:.2} s",
            self.conversion.setup.naming.folder().display(),
            self.begun.elapsed().as_secs_f64()
        ));
        if !self.failed.is_empty() {
            let mut list = format!("meniscus: {} frames failed:", self.failed.len());
            for (number, cause) in &self.failed {
                let _ = write!(list, "\n  frame {number}: {cause}");
            }
            notes.error(list);
        }
        match self.fatal {
            Some(error) => Err(error),
            None if self.failed.is_empty() => Ok(Verdict::Good),
            None => Ok(Verdict::Bad),
        }
    }
}

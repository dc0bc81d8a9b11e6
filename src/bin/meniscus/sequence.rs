//! `meniscus reconstruct` for the frames of a simulation: side by side, whatever single frames bring, and resumable.

mod conversion;
mod dry_run;
mod freeze;
mod one_frame;
mod options;
mod tally;
mod watch;

use std::collections::{HashMap, HashSet};
use std::fmt::Write;
use std::path::Path;
use std::sync::OnceLock;
use std::time::{Duration, Instant};

use meniscus::error::{Cause, Error};
use meniscus::field::calibration::Calibration;
use meniscus::field::indicator::IndicatorKind;
use meniscus::frame::{Resources, Sampling, Surfacing};
use meniscus::io::input::file_and_step;
use meniscus::io::output::MeshFormat;
use meniscus::io::series::Series;
use meniscus::io::whole::sweep;
use meniscus::io::{ParticleFile, WriteError, WriteFault};
use meniscus::simulation::SequenceError;
use meniscus::simulation::frozen::{Frozen, Stamp};
use meniscus::simulation::inputs::{FrameFile, Inputs};
use meniscus::simulation::naming::Naming;
use meniscus::simulation::state::{State, Store};
use meniscus::surface::simplify::{BYTES_A_THREAD, Reduction};

use crate::Verdict;
use crate::identity::{Identity, two_purposes};
use crate::interrupt;
use crate::lanes::Division;
use crate::reconstruct::{Options, is_frame};
use crate::run::{Notes, bytes_of};
use crate::sampling::SamplingRequest;
use crate::up::Orientation;

use conversion::Conversion;
use freeze::describe;
pub use options::SequenceOptions;

/// Between two looks at a simulation that runs.
const POLL: Duration = Duration::from_millis(250);

/// What is known before any frame is read.
struct Setup<'a> {
    options: &'a Options,
    inputs: &'a Inputs,
    naming: &'a Naming,
    request: SamplingRequest,
    surfacing: Surfacing,
    reduction: Reduction,
    resources: Resources,
    notes: Notes,
    /// The inputs as they are from the first frame on: what else comes is none.
    begun: OnceLock<Inputs>,
}

/// Runs the command, for each sequence that is there.
pub fn run(options: &Options, inputs: &Inputs, naming: &Naming) -> Result<Verdict, Error> {
    options.sequence.validate()?;
    if matches!(inputs, Inputs::Steps(_)) && options.sequence.watch.is_some() {
        return Err(Error::Request(format!(
            "{}: --watch follows files, not the steps of one",
            inputs.describe()
        )));
    }
    let sequences = inputs.sequences()?;
    if sequences.len() > 1 && (options.sequence.takes_one() || !told_apart(&sequences, naming)?) {
        // Says which there are.
        inputs.list()?;
    }
    let resources = options.resources(&naming.folder().join("frame"), || input_bytes(options, &sequences))?;
    let mut verdict = Verdict::Good;
    for inputs in &sequences {
        let setup = Setup {
            options,
            inputs,
            naming,
            request: options.request()?,
            surfacing: options.surfacing()?,
            reduction: options.reduction()?,
            resources: resources.clone(),
            notes: options.run.notes(),
            begun: OnceLock::new(),
        };
        options.validate_memory(&setup.reduction, &resources)?;
        match setup.start() {
            Ok(Verdict::Good) => {}
            Ok(Verdict::Bad) => verdict = Verdict::Bad,
            // What is wrong with one fluid's files does not concern the others.
            Err(error) if error.cause() == Cause::Input && sequences.len() > 1 => {
                setup.notes.error(format!("meniscus: {error}"));
                verdict = Verdict::Bad;
            }
            Err(error) => return Err(error),
        }
    }
    Ok(verdict)
}

/// Bytes of all frames that are wanted, unless more are waited for.
fn input_bytes(options: &Options, sequences: &[Inputs]) -> Option<u64> {
    if options.sequence.watch.is_some() {
        return None;
    }
    let mut frames = Vec::new();
    for inputs in sequences {
        frames.extend(inputs.list().ok()?.into_iter().filter(|frame| options.sequence.wants(frame.number)));
    }
    let files: HashSet<&Path> = frames.iter().map(|frame| frame.path.as_path()).collect();
    bytes_of(files)
}

/// Whether the outputs of each sequence have names of their own.
fn told_apart(sequences: &[Inputs], naming: &Naming) -> Result<bool, Error> {
    let mut names = Vec::new();
    for inputs in sequences {
        names.extend(inputs.list()?.first().map(|first| naming.sequence(first)));
    }
    names.sort();
    Ok(names.windows(2).all(|pair| pair[0] != pair[1]))
}

impl Setup<'_> {
    /// All frames that are there now.
    fn all_frames(&self) -> Result<Vec<FrameFile>, Error> {
        let frames = self.begun.get().unwrap_or(self.inputs).list()?;
        if let Some(first) = frames.first() {
            self.begun.get_or_init(|| self.inputs.like(first));
        }
        Ok(frames)
    }

    /// The frames of the sequence that are there now.
    fn frames(&self) -> Result<Vec<FrameFile>, Error> {
        Ok(self.options.sequence.selection().of(self.all_frames()?))
    }

    fn start(&self) -> Result<Verdict, Error> {
        let frames = self.frames()?;
        match frames.first() {
            Some(first) => self.run(first, &frames),
            None if self.options.sequence.watch.is_some() => self.wait_for_first(),
            None => Err(SequenceError::NoFrames(self.inputs.describe()).into()),
        }
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
        let sequence = naming.sequence(first);
        let store = Store::beside(&sequence);
        let Orientation { shown: up, .. } = options.up.orientation(&first.path, format);
        let series = Series { format, sequence, fps: options.sequence.fps, up };
        self.refuse_own_inputs(frames, &series, &store)?;
        options.prepare_stats()?;
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
        if let Some(state) = &kept {
            let (path, frozen) = (store.state_path(), describe(&state.frozen));
            notes.say(format!("going on with {}: {frozen}", path.display()));
        }
        if options.sequence.plan {
            if kept.is_none() {
                self.state(&store, frames, &self.resources, notes)?;
            }
            let numbers: Vec<String> = wanted.iter().map(|frame| frame.number.to_string()).collect();
            crate::print(&numbers.join("\n"))?;
            return Ok(Verdict::Good);
        }
        Conversion::new(self, format, store, wanted.len()).run(kept, frames, &series)
    }

    /// Measures what all frames have in common, and keeps it; the frame that it was measured on may still be open.
    fn state(
        &self,
        store: &Store,
        frames: &[FrameFile],
        resources: &Resources,
        notes: &Notes,
    ) -> Result<(State, Option<ParticleFile>), Error> {
        let (frozen, file) = self.freeze(frames, resources, notes)?;
        let state = State::new(self.options.settings(), frozen);
        interrupt::undisturbed(|| store.save(&state))?;
        Ok((state, file))
    }

    /// How a frame is sampled by what all have in common.
    fn sampling(
        &self,
        frozen: &Frozen,
        carried: Vec<usize>,
        resources: Resources,
    ) -> Result<Sampling, Error> {
        let field = frozen.field(self.request.field);
        self.request.sampling_on(frozen.grid()?, field, frozen.spacing, carried, resources)
    }

    /// How the machine is divided among so many frames.
    fn division(&self, frames: usize) -> Division {
        let frames = if self.resources.backend.divides() { frames } else { frames.min(2) };
        let chunk = self.reduction.tolerance.map_or(0, |_| BYTES_A_THREAD);
        Division::of(frames, rayon::current_num_threads(), self.resources.budget, chunk)
    }

    /// What the outputs' names say, able to hold what is asked for.
    fn format(&self, first: &FrameFile) -> Result<MeshFormat, Error> {
        let path = self.naming.path(first);
        let unknown = || WriteError::new(&path, WriteFault::UnknownExtension { known: MeshFormat::KNOWN });
        let format = MeshFormat::of(&path).ok_or_else(unknown)?;
        self.options.validate_format(format)?;
        Ok(format)
    }

    /// Refuses outputs that are inputs, by whatever name, or would be taken for some.
    fn refuse_own_inputs(&self, frames: &[FrameFile], series: &Series, store: &Store) -> Result<(), Error> {
        let inputs: HashMap<Identity, &Path> =
            frames.iter().map(|frame| (Identity::of(file_and_step(&frame.path).0), &*frame.path)).collect();
        let begun = self.begun.get().unwrap_or(self.inputs);
        for frame in frames {
            let output = self.naming.path(frame);
            if let Some(input) = inputs.get(&Identity::of(&output)) {
                return Err(two_purposes(&output, input));
            }
            if begun.takes(&output) {
                return Err(Error::Request(format!(
                    "{}: would be taken for a frame of {}; name the meshes otherwise, or write them into another folder",
                    output.display(),
                    self.inputs.describe()
                )));
            }
        }
        let Some(stats) = &self.options.stats else { return Ok(()) };
        let own = Identity::of(stats);
        let outputs = frames.iter().map(|frame| self.naming.path(frame));
        let others = outputs.chain(series.files()).chain([store.state_path()]);
        let taken = inputs.get(&own).map(|input| input.to_path_buf());
        match taken.or_else(|| others.into_iter().find(|other| Identity::of(other) == own)) {
            None => Ok(()),
            Some(other) => Err(two_purposes(stats, &other)),
        }
    }

    /// The state that is there, if it is of these settings and of these inputs.
    fn kept_state(&self, store: &Store, frames: &[FrameFile]) -> Result<Option<State>, Error> {
        let anew = self.options.run.overwrite;
        let state = match store.load() {
            Err(_) if anew => return Ok(None),
            found => found?,
        };
        let Some(state) = state else { return Ok(None) };
        let mut differing = state.differing(&self.options.settings());
        let measured_on = frames.iter().find(|frame| frame.number == state.frozen.frame);
        if measured_on.and_then(|frame| Stamp::of(&frame.path).ok()).is_some_and(|s| s != state.frozen.input)
        {
            let comma = if differing.is_empty() { "" } else { ", " };
            let _ = write!(differing, "{comma}input frame {}", state.frozen.frame);
        }
        if differing.is_empty() {
            if self.is_calibrated(&state, frames) {
                return Ok(Some(state));
            }
            let what = "what was measured is missing, or of another surface".into();
            let damaged = SequenceError::State { path: store.state_path(), what };
            return if anew { Ok(None) } else { Err(damaged.into()) };
        }
        if anew || self.options.sequence.resume {
            self.notes
                .say(format!("{}: of other settings ({differing}), made anew", store.state_path().display()));
            return Ok(None);
        }
        Err(SequenceError::Settings { path: store.state_path(), differing }.into())
    }

    /// Whether a state has all that frames are sampled and drawn by. Packed frames have a mu0 of their own.
    fn is_calibrated(&self, state: &State, frames: &[FrameFile]) -> bool {
        match (self.request.field.indicator(), &state.frozen.calibration) {
            (None, _) => true,
            (Some(_), None) => false,
            (Some(asked), Some(known)) => {
                let packed = || frames.iter().all(|frame| is_frame(&frame.path));
                match asked.kind {
                    _ if packed() => true,
                    IndicatorKind::Cloud => matches!(known, Calibration::Clouds { .. }),
                    IndicatorKind::Counting => known.mean().is_some(),
                    IndicatorKind::Symmetry => known.iso().is_some(),
                }
            }
        }
    }
}

//! `meniscus reconstruct` for the frames of a simulation: side by side, whatever single frames bring, and resumable.

mod conversion;
mod dry_run;
mod freeze;
mod one_frame;
mod options;
mod setup;
mod shared;
mod tally;
mod watch;

use std::collections::HashSet;
use std::path::Path;
use std::sync::OnceLock;
use std::time::Instant;

use meniscus::error::SequenceError;
use meniscus::error::{Cause, Error};
use meniscus::io::series::Series;
use meniscus::io::whole::sweep;
use meniscus::io::{WriteError, WriteFault};
use meniscus::simulation::inputs::{FrameFile, Inputs};
use meniscus::simulation::naming::Naming;
use meniscus::simulation::state::Store;

use crate::advice::told;
use crate::interrupt;
use crate::options::Options;
use crate::outcome::Verdict;
use crate::run::bytes_of;
use crate::up::Orientation;

use freeze::describe;
pub use options::SequenceOptions;
use setup::{POLL, Setup};
use shared::Conversion;

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
                setup.notes.error(format!("meniscus: {}", told(&error)));
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
            crate::outcome::print(&numbers.join("\n"))?;
            return Ok(Verdict::Good);
        }
        Conversion::new(self, format, store, wanted.len()).run(kept, frames, &series)
    }
}

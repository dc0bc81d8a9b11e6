//! Converts the frames of simulations to meshes, in parallel. A conversion can be resumed, and an
//! error in one frame does not stop the others.

use std::collections::HashSet;
use std::path::Path;
use std::sync::Arc;
use std::thread::sleep;
use std::time::Instant;

use crate::error::{Cause, Error, SimulationError, WhyOne};
use crate::io::alembic::frame_archive::FrameArchive;
use crate::io::mnf::is_packed;
use crate::io::series::Series;
use crate::io::whole::{MadeFolders, sweep, sweep_folder_of};
use crate::io::{ReadError, ReadFault, WriteError, WriteFault};
use crate::reconstruction::CheckedRequest;
use crate::system::cancel::UnfinishedOutput;

use super::builder::Simulation;
use super::conversion::{Conversion, ConversionEnd, convert};
use super::event::{Event, Summary};
use super::event::{EventSender, with_events};
use super::forecast::Forecast;
use super::frame_file::FrameFile;
use super::inputs::{Inputs, Sequence};
use super::naming::{self, Naming};
use super::setup::{POLL, Setup};
use super::small_meshes::SmallMeshes;
use super::solids::SolidNames;
use super::state::{State, StateFolder, StateLookup};

/// Maximum number of times that a conversion without `watch` calibrates again because the
/// calibration frame changed meanwhile.
const ATTEMPTS: usize = 3;

/// The inputs of one of several simulations, as text, and the simulation's result.
type SimulationResult<T> = (String, Result<T, Arc<Error>>);

/// A simulation whose request was checked.
struct CheckedSimulation<'a> {
    setup: &'a Setup<'a>,
    series: Series,
    store: StateFolder,
    frames: Vec<FrameFile>,
    found: StateLookup,
}

impl Simulation {
    /// Converts all frames, and calls `on_event` with each event, on the caller's thread. Returns a
    /// summary of each simulation.
    ///
    /// A frame that fails does not stop the other frames: [`Summary::failed`] lists it. The work
    /// waits for a slow `on_event`, so `on_event` must not wait for threads of the request's
    /// [pool](crate::Reconstruction::pool).
    ///
    /// # Errors
    /// The errors of [`Reconstruction::run`](crate::Reconstruction::run) that concern all frames,
    /// [`Error::Simulation`], [`Error::SameFile`], [`Error::Write`] if no more files can be
    /// written, [`Error::Vulkan`], and [`Error::Cancelled`].
    pub fn run(&self, on_event: impl FnMut(Event)) -> Result<Vec<Summary>, Error> {
        let converted = self.for_each_simulation(on_event, |checked| self.convert(checked))?;
        let summed = |(inputs, converted): (String, Result<Summary, Arc<Error>>)| {
            converted.unwrap_or_else(|error| Summary {
                inputs,
                error: Some(error),
                ..Summary::default()
            })
        };
        Ok(converted.into_iter().map(summed).collect())
    }

    /// Converts a simulation. If the calibration frame changes meanwhile, measures the calibration
    /// again, and remakes the frames that used the old one.
    fn convert(&self, checked: CheckedSimulation<'_>) -> Result<Summary, Error> {
        // Later passes can resume, because all outputs that exist by then come from this
        // conversion.
        let resumed = Self { resume: true, ..self.clone() };
        let first = checked.setup;
        let mut end = self.convert_once(checked)?;
        let mut attempts = 0;
        loop {
            let changed = match end {
                ConversionEnd::Ended(summary) => return Ok(*summary),
                ConversionEnd::Outdated(path) => path,
            };
            attempts += 1;
            if attempts > ATTEMPTS && self.watch.is_none() {
                return Err(ReadError::new(changed, ReadFault::Changed).into());
            }
            let (outputs, archive) = (first.outputs.clone(), first.archive.clone());
            let setup = Setup { simulation: &resumed, outputs, archive, ..*first };
            let checked = resumed.begin(&setup, setup.frames()?)?;
            end = resumed.convert_once(checked)?;
        }
    }

    fn convert_once(&self, checked: CheckedSimulation<'_>) -> Result<ConversionEnd, Error> {
        let CheckedSimulation { setup, series, mut store, frames, found } = checked;
        let _folders = prepare_folder(setup, &store)?;
        let known = store.begin(found, true)?;
        if let Some(state) = &known {
            setup.send(resumed_event(&store, state));
        }
        let wanted = frames.iter().filter(|frame| self.includes(frame.number)).count();
        convert(&Conversion::new(setup, series.format, store, wanted), known, &frames, &series)
    }

    /// Calibrates all frames, stores the calibration next to the outputs, and returns the frame
    /// numbers. After that, each of several jobs can convert [some of the frames](Self::frames).
    ///
    /// # Errors
    /// The errors of [`run`](Self::run).
    pub fn plan(&self, on_event: impl FnMut(Event)) -> Result<Vec<i64>, Error> {
        let plan = Self { watch: None, planned: true, ..self.clone() };
        let numbers = plan.for_each_simulation(on_event, |checked| {
            let CheckedSimulation { setup, mut store, frames, found, .. } = checked;
            let _folders = prepare_folder(setup, &store)?;
            match store.begin(found, false)? {
                Some(state) => setup.send(resumed_event(&store, &state)),
                None => drop(setup.state(&store, &frames, &setup.checked.resources)?),
            }
            let wanted =
                frames.iter().map(|frame| frame.number).filter(|&number| plan.includes(number));
            Ok(wanted.collect::<Vec<_>>())
        })?;
        // `planned` allows only one simulation, so there is at most one list of numbers.
        Ok(numbers.into_iter().filter_map(|(_, numbers)| numbers.ok()).flatten().collect())
    }

    /// Estimates the resources that the conversion needs. Writes nothing.
    ///
    /// # Errors
    /// The errors of [`run`](Self::run).
    pub fn forecast(&self, on_event: impl FnMut(Event)) -> Result<Vec<Forecast>, Error> {
        let forecasts = self.for_each_simulation(on_event, |checked| {
            let CheckedSimulation { setup, store, frames, found, .. } = checked;
            let wanted: Vec<_> =
                frames.iter().filter(|frame| self.includes(frame.number)).collect();
            setup.forecast(found.kept(), &store, &frames, &wanted)
        })?;
        Ok(forecasts.into_iter().filter_map(|(_, forecast)| forecast.ok()).collect())
    }

    /// Total size, in bytes, of the input files of all requested frames; `None` when watching, or
    /// if the size of a file does not indicate how many particles it contains.
    #[must_use]
    pub fn input_bytes(&self) -> Option<u64> {
        if self.watch.is_some() {
            return None;
        }
        let mut frames = Vec::new();
        for sequence in self.names().ok()?.0.simulations(None).ok()? {
            frames.extend(
                sequence.list().ok()?.into_iter().filter(|frame| self.includes(frame.number)),
            );
        }
        let files: HashSet<&Path> = frames.iter().flat_map(FrameFile::paths).collect();
        crate::backend::choice::bytes_of(files)
    }

    /// Checks everything in the request that can be checked without reading an input.
    ///
    /// # Errors
    /// [`Error::Unit`], [`Error::SettingConflict`] and [`Error::Simulation`].
    pub fn check(&self) -> Result<(), Error> {
        self.prepare().map(drop)
    }

    /// Checks all numbers and combinations of settings.
    fn prepare(&self) -> Result<(Inputs, Naming, CheckedRequest), Error> {
        self.validate()?;
        let (inputs, naming) = self.names()?;
        if matches!(inputs, Inputs::Steps { .. }) && self.watch.is_some() {
            return Err(SimulationError::Steps(inputs.describe()).into());
        }
        let mut checked = self.request.checked_without_solids()?;
        if !SolidNames::of(&checked.settings)?.are_numbered() {
            checked = checked.at_solids()?;
        }
        if self.request.scratch.is_none() {
            checked.resources.scratch = naming.folder().to_owned();
        }
        // Frames that are made in parallel report their progress as events.
        checked.resources.control.progress = None;
        // A packed frame stores its own indicator. The settings are checked against it when the
        // frame is opened.
        if !self.inputs.iter().all(|input| is_packed(input)) {
            checked.check_indicator()?;
        }
        Ok((inputs, naming, checked))
    }

    /// Returns the existing simulations with their selected frames. When watching, waits for the
    /// first frame.
    fn find_simulations(
        &self,
        inputs: &Inputs,
        checked: &CheckedRequest,
        events: &EventSender,
    ) -> Result<(Vec<Sequence>, Vec<Vec<FrameFile>>), Error> {
        let list = || {
            let simulations = inputs.simulations(self.watch)?;
            let solids = SolidNames::of(&checked.settings)?;
            let frames = simulations
                .iter()
                .map(|sequence| Ok(solids.with_files(self.selection.of(sequence.list()?))));
            let frames = frames.collect::<Result<Vec<_>, SimulationError>>()?;
            Ok::<_, Error>((simulations, frames))
        };
        let (start, mut found) = (Instant::now(), list()?);
        let is_early = |(simulations, frames): &(Vec<Sequence>, Vec<Vec<FrameFile>>)| {
            simulations.len() < 2 && frames.iter().all(Vec::is_empty)
        };
        if let Some(idle) = self.watch.filter(|_| is_early(&found)) {
            events.send(Event::Waiting { inputs: inputs.describe(), unsuitable: 0 });
            while is_early(&found) && start.elapsed().as_secs_f64() <= idle {
                checked.check_cancelled()?;
                sleep(POLL);
                found = list()?;
            }
        }
        Ok(found)
    }

    /// Runs `act` for each simulation in turn on another thread, and passes the events of all
    /// simulations to `on_event` on this thread. Returns the inputs and the result of each
    /// simulation, or an error that concerns all simulations.
    fn for_each_simulation<T: Send>(
        &self,
        on_event: impl FnMut(Event),
        act: impl Fn(CheckedSimulation<'_>) -> Result<T, Error> + Sync,
    ) -> Result<Vec<SimulationResult<T>>, Error> {
        with_events(&self.request.control.cancel, on_event, |events| {
            self.run_each_simulation(events, &act)
        })
    }

    fn run_each_simulation<T: Send>(
        &self,
        events: &EventSender,
        act: &(impl Fn(CheckedSimulation<'_>) -> Result<T, Error> + Sync),
    ) -> Result<Vec<SimulationResult<T>>, Error> {
        let (inputs, naming, checked) = self.prepare()?;
        let started = checked.clone().on_threads()?;
        let found = || self.find_simulations(&inputs, &checked, events);
        let (simulations, frames) = started.threads.install(found)?;
        if simulations.is_empty() {
            return Err(inputs.no_frames().into());
        }
        if simulations.len() > 1 {
            let why = match &naming {
                _ if self.planned || self.watch.is_some() => Some(WhyOne::Request),
                _ if have_different_names(&simulations, &naming) => None,
                Naming::Folder(_) => Some(WhyOne::Names),
                Naming::Pattern(_) | Naming::Archive { .. } => Some(WhyOne::Pattern),
            };
            if let Some(why) = why {
                return Err(inputs.several(&simulations, why).into());
            }
        }
        if let Some(joined) =
            simulations.iter().find(|found| found.is_joined() && self.watch.is_some())
        {
            return Err(SimulationError::Joined(joined.describe()).into());
        }
        checked.check_cancelled()?;
        started.threads.install(|| {
            let mut results = Vec::new();
            for (sequence, frames) in simulations.iter().zip(frames) {
                let (outputs, archive) = (naming.outputs(sequence), naming.archive());
                let checked = &started.checked;
                let setup = Setup { simulation: self, sequence, outputs, archive, checked, events };
                let timed = frames.first().filter(|_| sequence.infers_times());
                if let Some((frame, time)) = timed.and_then(|frame| Some((frame, frame.time?))) {
                    setup.send(Event::TimesInNames { path: frame.path.clone(), time });
                }
                let result = match self.begin(&setup, frames).and_then(act) {
                    // An error in the files of one simulation, or a selection that contains none of
                    // its frames, does not stop the other simulations.
                    Err(error) if concerns_one(&error) && simulations.len() > 1 => {
                        let error = Arc::new(error);
                        setup.send(Event::SimulationFailed(Arc::clone(&error)));
                        Err(error)
                    }
                    result => Ok(result?),
                };
                results.push((sequence.describe(), result));
            }
            for name in self.unwatched(&inputs, &simulations)? {
                let error = Arc::new(SimulationError::Unwatched(name.clone()).into());
                events.send(Event::SimulationFailed(Arc::clone(&error)));
                results.push((name, Err(error)));
            }
            Ok(results)
        })
    }

    /// The names of simulations that have appeared among the inputs while `watched` were watched.
    fn unwatched(
        &self,
        inputs: &Inputs,
        watched: &[Sequence],
    ) -> Result<Vec<String>, SimulationError> {
        if self.watch.is_none() {
            return Ok(Vec::new());
        }
        let frames = |sequence: &Sequence| Ok(self.selection.of(sequence.list()?));
        let lists = watched.iter().map(frames).collect::<Result<Vec<_>, _>>()?;
        let known: HashSet<&Path> = lists.iter().flatten().flat_map(FrameFile::paths).collect();
        let mut unwatched = Vec::new();
        for sequence in inputs.simulations(None)? {
            let frames = frames(&sequence)?;
            let is_known =
                frames.iter().flat_map(FrameFile::paths).any(|path| known.contains(path));
            if !frames.is_empty() && !is_known {
                unwatched.push(sequence.describe());
            }
        }
        Ok(unwatched)
    }

    /// Checks a simulation's frames and outputs.
    fn begin<'a>(
        &self,
        setup: &'a Setup<'a>,
        frames: Vec<FrameFile>,
    ) -> Result<CheckedSimulation<'a>, Error> {
        let Some(first) = frames.first() else {
            return Err(match setup.sequence.list()?.is_empty() {
                true => setup.sequence.no_frames().into(),
                false => SimulationError::NoFrameSelected(setup.sequence.describe()).into(),
            });
        };
        let format = setup.format(first)?;
        let simulation = naming::simulation(&setup.outputs);
        let store = StateFolder::beside(&simulation);
        let up = {
            let settings = &setup.checked.settings;
            settings.orientation(settings.usual_up(&first.path), format).shown
        };
        let series = Series { format, simulation, fps: self.fps, up };
        if let Some(what) = series.path_fault() {
            return Err(SimulationError::Names(what).into());
        }
        setup.reject_outputs_among_inputs(&frames, &series, &store)?;
        let wanted: Vec<_> = frames.iter().filter(|frame| self.includes(frame.number)).collect();
        if wanted.is_empty() && self.watch.is_none() {
            return Err(SimulationError::NoFrameSelected(setup.sequence.describe()).into());
        }
        // Without a state, existing output files are not from this conversion. Look for these files
        // before `find_state` reads the state. Another process that starts meanwhile writes the
        // state before its first output, so if one of its outputs is found here, `find_state` finds
        // the state.
        let is_new = !self.overwrite && store.text()?.is_none();
        let foreign = is_new.then(|| setup.existing(&frames, &series)).flatten();
        let existing =
            wanted.iter().map(|frame| setup.shown_output(frame)).find(|path| path.exists());
        let found = setup.find_state(&store, &frames)?;
        let refused = if matches!(found, StateLookup::Nothing) {
            foreign.map(|path| (path, WriteFault::Exists))
        } else if self.overwrite || self.resume || self.planned {
            None
        } else {
            existing.map(|path| (path, WriteFault::ExistsInSimulation))
        };
        if let Some((path, fault)) = refused {
            return Err(WriteError::new(&path, fault).into());
        }
        setup.archive.as_ref().map_or(Ok(()), FrameArchive::check)?;
        Ok(CheckedSimulation { setup, series, store, frames, found })
    }
}

/// Whether an error concerns only one of several simulations.
fn concerns_one(error: &Error) -> bool {
    error.cause() == Cause::Input
        || matches!(error, Error::Simulation(SimulationError::NoFrameSelected(_)))
}

/// The event for a conversion that is resumed.
fn resumed_event(store: &StateFolder, state: &State) -> Event {
    Event::Resumed { state: store.state_path(), shared: Box::new(state.shared.clone()) }
}

/// Prepares the folder of the outputs, and removes temporary files of killed processes. The
/// returned guards remove created folders that stay empty, even if the work is abandoned.
fn prepare_folder(
    setup: &Setup<'_>,
    store: &StateFolder,
) -> Result<(MadeFolders, UnfinishedOutput), Error> {
    let folder = setup.outputs.folder();
    let cancel = &setup.checked.resources.control.cancel;
    let make =
        || MadeFolders::of(store.folder()).map_err(|error| WriteError::new(folder, error.fault));
    let made = cancel.guard(make, |made| made.paths().to_vec())?;
    sweep(folder);
    setup.archive.iter().for_each(|archive| sweep_folder_of(archive.path()));
    sweep(store.folder());
    SmallMeshes::beside(store.folder()).sweep();
    Ok(made)
}

/// Whether the outputs of all simulations have different names.
fn have_different_names(simulations: &[Sequence], naming: &Naming) -> bool {
    let names: HashSet<_> =
        simulations.iter().map(|sequence| naming::simulation(&naming.outputs(sequence))).collect();
    names.len() == simulations.len()
}

//! Converts all frames in parallel lanes, within the memory limit. Each lane converts one frame at
//! a time.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender, SyncSender};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::thread::{self, Scope};
use std::time::{Duration, Instant};

use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::error::Error;
use crate::frame::Resources;
use crate::io::ParticleFile;
use crate::io::output::MeshFormat;
use crate::io::series::Series;
use crate::particles::Particles;
use crate::reconstruction::CheckedRequest;
use crate::system::cancel::Cancel;
use crate::system::control::Progress;

use super::event::{Event, Summary};
use super::frame_file::FrameFile;
use super::gate::FrameGate;
use super::lanes::Division;
use super::one_frame::{ConvertedFrame, WrittenFrame};
use super::records::{Record, Records};
use super::setup::{ExistingMeshes, POLL, Setup};
use super::small_meshes::SmallMeshes;
use super::state::{State, StateFolder};
use super::tally::Tally;
use super::watch::{CompleteFrame, Watch};

/// Minimum time between two progress events within a stage.
const PROGRESS_INTERVAL: Duration = Duration::from_millis(50);

/// Sets the shared measurements to `None` on drop, unless they are known, so that no lane waits for
/// them forever.
struct SettleOnDrop<'a>(&'a OnceLock<Option<SharedMeasurements>>);

impl Drop for SettleOnDrop<'_> {
    fn drop(&mut self) {
        self.0.get_or_init(|| None);
    }
}

/// The outcome of a conversion.
pub(super) enum ConversionEnd {
    /// All frames have finished or failed.
    Ended(Box<Summary>),
    /// The calibration frame has changed since it was measured. Holds the path of its file.
    Outdated(PathBuf),
}

/// A frame to convert.
struct Job {
    frame: FrameFile,
    /// The particles of the frame, if its file is already open.
    particles: Option<ParticleFile>,
    /// Whether a mesh with the frame's output name is already listed, for example from an older
    /// version of the frame's file. The new mesh may replace the listed mesh.
    may_replace: bool,
}

/// The outcome of a frame.
struct Outcome<T> {
    frame: FrameFile,
    result: Result<T, Error>,
}

impl Conversion<'_> {
    /// Measures the calibration that all frames share, or takes it from `known`. Returns the number
    /// and the particles of the calibration frame if its file is open and its particles need little
    /// memory.
    fn settle(
        &self,
        known: Option<State>,
        frames: &[FrameFile],
    ) -> Result<Option<(i64, ParticleFile)>, Error> {
        let Self { setup, store, division, .. } = self;
        self.unchecked.store(known.is_some(), Ordering::Relaxed);
        let measured = || {
            let resources = Resources { budget: division.alone, ..setup.checked.resources.clone() };
            setup.state(store, frames, &resources)
        };
        let (state, file) = known.map_or_else(measured, |state| Ok((state, None)))?;
        let (number, fingerprint) = (state.shared.frame, state.fingerprint(self.format));
        self.settled.get_or_init(|| Some(SharedMeasurements { state, fingerprint }));
        let open = file.filter(|file| file.particles.resident_bytes() <= division.unpacked());
        Ok(open.map(|file| (number, file)))
    }

    /// Sends the frames in `todo` to the lanes. If the shared calibration is not known yet,
    /// measures it after sending the first few frames, which the lanes open meanwhile.
    fn send_jobs(
        &self,
        todo: &[&FrameFile],
        frames: &[FrameFile],
        to_lanes: Sender<Job>,
        tally: &mut Tally,
    ) -> Result<(), Error> {
        // Sending cannot fail, because the lanes run as long as the channel is open.
        let send = |job: Job| drop(to_lanes.send(job));
        let mut jobs = todo.iter().map(|&frame| Job {
            frame: frame.clone(),
            particles: None,
            may_replace: false,
        });
        if self.settled.get().is_none() {
            // The first frame is most likely the calibration frame, so one lane stays free for it.
            // The first frame is sent after the calibration. If the first frame is the calibration
            // frame, its open file is sent with it.
            let first = jobs.next();
            jobs.by_ref().take(self.division.lanes - 1).for_each(send);
            let measured = self.settle(None, frames)?;
            tally.add_finished(frames, |_| false);
            if let Some(Job { frame, .. }) = first {
                let measured = measured.filter(|(number, _)| *number == frame.number);
                let particles = measured.map(|(_, file)| file);
                send(Job { frame, particles, may_replace: false });
            }
        }
        jobs.for_each(send);
        Ok(())
    }

    fn run(
        &self,
        known: Option<State>,
        frames: &[FrameFile],
        series: &Series,
    ) -> Result<ConversionEnd, Error> {
        let options = self.setup.simulation;
        let mut tally = Tally::new(self, series);
        if let Some(archive) =
            self.setup.archive.as_ref().filter(|_| options.overwrite && !options.resume)
        {
            archive.forget()?;
        }
        // If the calibration is unknown and all frames must be made, the lanes open the first
        // frames during the calibration. Otherwise, the calibration comes first.
        let unknown = known.is_none() && !options.resume && options.watch.is_none();
        if !unknown {
            self.settle(known, frames)?;
            tally.add_finished(frames, |frame| options.resume && options.includes(frame.number));
        }
        let wanted: Vec<_> = frames.iter().filter(|frame| options.includes(frame.number)).collect();
        let todo: Vec<&FrameFile> = wanted
            .iter()
            .copied()
            .filter(|frame| !(options.resume && tally.is_listed(frame)))
            .collect();
        let watch = options.watch.map(|idle| Watch::new(idle, options.selection));
        self.setup.send(Event::Started {
            frames: wanted.len(),
            done: wanted.len() - todo.len(),
            bytes: if watch.is_some() { 0 } else { todo.iter().map(|frame| frame.bytes()).sum() },
            lanes: self.division.lanes,
            followed: watch.is_some(),
        });

        let (to_lanes, jobs) = mpsc::channel();
        let jobs = Mutex::new(jobs);
        // The channel is bounded, because each mesh that waits for the disk keeps a file open.
        let (to_disk, filled) = mpsc::sync_channel(self.division.lanes);
        let filled = Mutex::new(filled);
        let (results, outcomes) = mpsc::channel();
        let converted = thread::scope(|scope| {
            let _settle = SettleOnDrop(&self.settled);
            for lane in 0..self.division.lanes {
                let (jobs, to_disk) = (&jobs, to_disk.clone());
                let (filled, results) = (&filled, results.clone());
                let started = start(scope, move || {
                    self.finish_written_frames(filled, &results);
                })
                .and_then(|()| {
                    let pool = ThreadPoolBuilder::new().num_threads(self.division.threads).build();
                    let pool = pool.map_err(|fault| Error::Threads(fault.to_string()))?;
                    start(scope, move || self.lane(lane, &pool, jobs, &to_disk))
                });
                match started {
                    // Continue with fewer lanes.
                    Err(_) if lane > 0 => break,
                    started => started?,
                }
            }
            drop((to_disk, results));
            let followed = match watch {
                Some(watch) => Some((watch, to_lanes)),
                None => {
                    tally.total = todo.len();
                    tally.awaited = todo.iter().map(|frame| frame.number).collect();
                    self.send_jobs(&todo, frames, to_lanes, &mut tally)?;
                    None
                }
            };
            match followed {
                Some((watch, to_lanes)) => self.follow(watch, to_lanes, &outcomes, &mut tally),
                None => {
                    outcomes.iter().try_for_each(|outcome| self.record_outcome(outcome, &mut tally))
                }
            }
        });
        converted?;
        let frames = self.setup.frames()?;
        match self.changed(&frames) {
            Some(frame) if !self.cancel().is_cancelled() && !tally.has_fatal_error() => {
                Ok(ConversionEnd::Outdated(frame.path.clone()))
            }
            _ => tally.finish(&frames).map(|summary| ConversionEnd::Ended(Box::new(summary))),
        }
    }

    /// Sends frames to the lanes as they become complete, until the simulation is over.
    fn follow(
        &self,
        mut watch: Watch,
        to_lanes: Sender<Job>,
        outcomes: &Receiver<Outcome<ConvertedFrame>>,
        tally: &mut Tally,
    ) -> Result<(), Error> {
        let options = self.setup.simulation;
        let mut in_progress = 0;
        loop {
            if self.is_over() {
                drop(to_lanes);
                return outcomes.iter().try_for_each(|outcome| self.record_outcome(outcome, tally));
            }
            match outcomes.recv_timeout(POLL) {
                Ok(outcome) => {
                    in_progress -= 1;
                    let number = outcome.frame.number;
                    self.record_outcome(outcome, tally)?;
                    watch.done(number);
                }
                Err(RecvTimeoutError::Disconnected) => return Ok(()),
                Err(RecvTimeoutError::Timeout) => {
                    tally.catch_up().inspect_err(|_| self.stop.store(true, Ordering::Relaxed))?;
                    let existing = self.setup.frames()?;
                    let ready = watch.ready(&existing);
                    let is_ready = |frame: &FrameFile| {
                        ready.iter().any(|ready| ready.frame.number == frame.number)
                    };
                    if self.changed(&existing).is_some_and(is_ready) {
                        self.stop.store(true, Ordering::Relaxed);
                        continue;
                    }
                    for CompleteFrame { frame, has_changed } in ready {
                        let is_done = options.resume && !has_changed && tally.is_listed(&frame);
                        if !options.includes(frame.number) || is_done {
                            watch.done(frame.number);
                            continue;
                        }
                        in_progress += 1;
                        tally.total += 1;
                        self.setup.send(Event::FrameAppeared { bytes: frame.bytes() });
                        // If file names contain times, a new frame between finished frames takes
                        // over the number and the output of the frame after it.
                        let may_replace = tally.is_listed_output(&self.output(&frame));
                        tally.awaited.insert(frame.number);
                        let _ = to_lanes.send(Job { frame, particles: None, may_replace });
                    }
                    if in_progress == 0 && watch.is_over() {
                        return Ok(());
                    }
                }
            }
        }
    }

    /// The calibration frame, if its file exists and has changed since the frame was measured.
    fn changed<'f>(&self, frames: &'f [FrameFile]) -> Option<&'f FrameFile> {
        self.settled.get()?.as_ref()?.state.shared.changed_in(frames)
    }

    /// Whether the lanes must not start another frame.
    fn is_over(&self) -> bool {
        self.stop.load(Ordering::Relaxed) || self.cancel().is_cancelled()
    }

    /// Records the outcome of a frame.
    fn record_outcome(
        &self,
        outcome: Outcome<ConvertedFrame>,
        tally: &mut Tally,
    ) -> Result<(), Error> {
        let Outcome { frame, result } = outcome;
        let added = tally.add_outcome(&frame, result);
        if !matches!(added, Ok(false)) {
            self.stop.store(true, Ordering::Relaxed);
        }
        added.map(drop)
    }

    /// Converts frames until the channel is closed.
    fn lane(
        &self,
        lane: usize,
        pool: &ThreadPool,
        jobs: &Mutex<Receiver<Job>>,
        to_disk: &SyncSender<Outcome<WrittenFrame>>,
    ) {
        // The lane runs on a thread of the pool. If it ran on another thread, every step of a frame
        // would wait until a thread of the pool wakes up. The current thread could instead join the
        // pool, but rayon would never release it.
        pool.install(|| {
            while let Some(Job { frame, particles, may_replace }) = next(jobs) {
                if self.is_over() {
                    continue;
                }
                let number = frame.number;
                let events = self.setup.events;
                let opened = self.checked_in(lane, &frame).and_then(|checked| {
                    let opened = self.open(&checked, &frame, particles, may_replace)?;
                    Ok((checked, opened))
                });
                let Some(settled) = self.settled.wait() else { return };
                let result = opened
                    .and_then(|(checked, opened)| self.convert(&checked, &frame, opened, settled));
                events.send(Event::Stage { lane, frame: number, progress: None });
                if to_disk.send(Outcome { frame, result }).is_err() {
                    return;
                }
            }
        });
    }

    /// Returns the request for a frame, with the frame's solids. The request reports the progress
    /// of its lane at the start and end of each stage, and at most once per [`PROGRESS_INTERVAL`]
    /// in between, because each event wakes the caller's thread.
    fn checked_in(&self, lane: usize, frame: &FrameFile) -> Result<CheckedRequest, Error> {
        let FrameFile { number: frame, ref solids, .. } = *frame;
        let (events, mut checked) = (self.setup.events.clone(), self.setup.checked.clone());
        let last_sent = Mutex::new(Instant::now());
        let report = move |progress: Progress| {
            let is_end = progress.done <= 0.0 || progress.done >= 1.0;
            if !is_end {
                let Ok(mut last_sent) = last_sent.try_lock() else { return };
                if last_sent.elapsed() < PROGRESS_INTERVAL {
                    return;
                }
                *last_sent = Instant::now();
            }
            events.send(Event::Stage { lane, frame, progress: Some(progress) });
        };
        checked.resources.control.progress = Some(Arc::new(report));
        let is_of_all = solids.is_empty() || checked.surfacing.solid.is_some();
        if is_of_all { Ok(checked) } else { checked.at_solids_of_frame(solids) }
    }

    /// Finishes written frames: waits until their meshes are on disk, so that no lane has to wait
    /// for the disk.
    fn finish_written_frames(
        &self,
        filled: &Mutex<Receiver<Outcome<WrittenFrame>>>,
        results: &Sender<Outcome<ConvertedFrame>>,
    ) {
        while let Some(Outcome { frame, result }) = next(filled) {
            let result = result.and_then(|filled| self.finish(filled));
            if results.send(Outcome { frame, result }).is_err() {
                return;
            }
        }
    }
}

/// Starts a thread.
fn start<'scope>(
    scope: &'scope Scope<'scope, '_>,
    work: impl FnOnce() + Send + 'scope,
) -> Result<(), Error> {
    let started = thread::Builder::new().spawn_scoped(scope, work);
    started.map(drop).map_err(|fault| Error::Threads(fault.to_string()))
}

/// Receives the next item from a channel that several threads share.
fn next<T>(receiver: &Mutex<Receiver<T>>) -> Option<T> {
    receiver.lock().unwrap_or_else(PoisonError::into_inner).recv().ok()
}

/// Converts frames, including those that appear while a simulation is watched.
pub(super) fn convert(
    conversion: &Conversion<'_>,
    known: Option<State>,
    frames: &[FrameFile],
    series: &Series,
) -> Result<ConversionEnd, Error> {
    conversion.run(known, frames, series)
}

/// State that all lanes share.
pub(super) struct Conversion<'a> {
    pub(super) setup: &'a Setup<'a>,
    pub(super) format: MeshFormat,
    pub(super) store: StateFolder,
    /// The shared measurements, once they are known; `None` if the calibration failed.
    pub(super) settled: OnceLock<Option<SharedMeasurements>>,
    /// The records that existed before this run replaced any mesh.
    pub(super) records_before: OnceLock<Records>,
    pub(super) division: Division,
    pub(super) gate: FrameGate,
    pub(super) stop: AtomicBool,
    /// Whether the spacing comes from an earlier state, and has not been checked on a frame yet.
    pub(super) unchecked: AtomicBool,
}

/// Measurements that all frames share.
pub(super) struct SharedMeasurements {
    pub(super) state: State,
    pub(super) fingerprint: u32,
}

impl<'a> Conversion<'a> {
    pub(super) fn new(
        setup: &'a Setup<'a>,
        format: MeshFormat,
        store: StateFolder,
        frames: usize,
    ) -> Self {
        let division = setup.division(frames);
        let (settled, gate) =
            (OnceLock::new(), FrameGate::new(division.lanes, setup.checked.threads));
        let [stop, unchecked] = [(); 2].map(|()| AtomicBool::new(false));
        let records_before = OnceLock::new();
        Self { setup, format, store, settled, records_before, division, gate, stop, unchecked }
    }

    /// The caller's handle to end the work early.
    pub(super) fn cancel(&self) -> &Cancel {
        &self.setup.checked.resources.control.cancel
    }

    pub(super) fn output(&self, frame: &FrameFile) -> PathBuf {
        self.setup.output(frame)
    }

    /// The small meshes of frames.
    pub(super) fn small_meshes(&self) -> SmallMeshes {
        SmallMeshes::beside(self.store.folder())
    }

    /// The record of a frame that is already finished; `None` if the frame must be made.
    pub(super) fn current<'r>(
        &self,
        meshes: &'r ExistingMeshes,
        frame: &FrameFile,
    ) -> Option<&'r Record> {
        let settled = self.settled.get()?.as_ref()?;
        meshes.current(frame, &self.output(frame), settled.fingerprint)
    }
}

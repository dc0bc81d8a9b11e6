//! All frames on their way, in as many lanes as the machine has room for.

use std::sync::atomic::Ordering;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender, SyncSender};
use std::sync::{Mutex, OnceLock, PoisonError};

use meniscus::error::Error;
use meniscus::frame::Resources;
use meniscus::io::ParticleFile;
use meniscus::io::series::Series;
use meniscus::particles::Particles;
use meniscus::simulation::frozen::Stamp;
use meniscus::simulation::inputs::FrameFile;
use meniscus::simulation::state::State;

use crate::outcome::Verdict;
use crate::progress::{Progress, ProgressMode};
use crate::report::report_device;
use crate::run::Notes;

use super::one_frame::{Done, Filled};
use super::setup::POLL;
use super::shared::{Conversion, Settled};
use super::tally::Tally;
use super::watch::{Ready, Watch};

/// Settles at last that it cannot be known: whatever happens, nobody waits for ever.
struct AtLast<'a>(&'a OnceLock<Option<Settled>>);

impl Drop for AtLast<'_> {
    fn drop(&mut self) {
        self.0.get_or_init(|| None);
    }
}

/// A frame to be made.
struct Job {
    frame: FrameFile,
    /// Where they are open already.
    particles: Option<ParticleFile>,
    /// Whether its mesh was made before, of a file that has changed since.
    again: bool,
}

/// What became of a frame.
struct Outcome<T> {
    frame: FrameFile,
    result: Result<T, Error>,
}

impl Conversion<'_> {
    /// Settles what all frames have in common, while lanes may hold open frames. The frame that was measured is given on,
    /// if it may stay open.
    fn settle(
        &self,
        known: Option<State>,
        frames: &[FrameFile],
        notes: &Notes,
    ) -> Result<Option<(u64, ParticleFile)>, Error> {
        let Self { setup, store, division, .. } = self;
        let measured = || {
            let resources = Resources { budget: division.alone, ..setup.resources.clone() };
            setup.state(store, frames, &resources, notes)
        };
        let (state, file) = known.map_or_else(measured, |state| Ok((state, None)))?;
        let (number, fingerprint) = (state.frozen.frame, state.fingerprint());
        self.settled.get_or_init(|| Some(Settled { state, fingerprint }));
        let open = file.filter(|file| file.particles.resident_bytes() <= division.unpacked());
        Ok(open.map(|file| (number, file)))
    }

    /// Gives the lanes all frames; where it is not settled yet what these have in common, the lanes open some meanwhile.
    fn give(
        &self,
        todo: &[&FrameFile],
        frames: &[FrameFile],
        to_lanes: Sender<Job>,
        tally: &mut Tally,
    ) -> Result<(), Error> {
        // The lanes live as long as they are sent to.
        let send = |job: Job| drop(to_lanes.send(job));
        let mut jobs = todo.iter().map(|&frame| Job { frame: frame.clone(), particles: None, again: false });
        if self.settled.get().is_none() {
            // The first is most likely the one that is measured: a lane waits for it.
            let first = jobs.next();
            jobs.by_ref().take(self.division.lanes - 1).for_each(send);
            let measured = self.settle(None, frames, &tally.notes)?;
            tally.list(frames, |_| false);
            if let Some(Job { frame, .. }) = first {
                let measured = measured.filter(|(number, _)| *number == frame.number);
                send(Job { frame, particles: measured.map(|(_, file)| file), again: false });
            }
        }
        jobs.for_each(send);
        Ok(())
    }

    /// Converts the frames, and those that come while it watches.
    pub fn run(&self, known: Option<State>, frames: &[FrameFile], series: &Series) -> Result<Verdict, Error> {
        let options = &self.setup.options.sequence;
        let mut tally = Tally::new(self, series);
        // Where all frames are to be made, the first are opened while one of them is measured.
        let unknown = known.is_none() && !options.resume && options.watch.is_none();
        if !unknown {
            self.settle(known, frames, &tally.notes)?;
            tally.list(frames, |frame| options.resume && options.wants(frame.number));
        }
        let wanted: Vec<_> = frames.iter().filter(|frame| options.wants(frame.number)).collect();
        let todo: Vec<&FrameFile> =
            wanted.iter().copied().filter(|frame| !(options.resume && tally.lists(frame))).collect();
        if wanted.len() > todo.len() {
            let done = wanted.len() - todo.len();
            self.setup.notes.say(format!("{done} of {} frames are done already", wanted.len()));
        }
        let watch = options.watch.map(|idle| Watch::new(idle, options.selection()));
        let bytes = || if watch.is_some() { 0 } else { todo.iter().map(|frame| size(frame)).sum() };
        let idle = todo.is_empty() && watch.is_none();
        let mode = if idle { ProgressMode::Never } else { options.progress };
        let (progress, notes) = Progress::start(mode, bytes, self.division.lanes, self.setup.notes.clone());
        tally.notes = notes;

        let (to_lanes, jobs) = mpsc::channel();
        let jobs = Mutex::new(jobs);
        // Bounded: what waits for the disk is an open file.
        let (to_disk, filled) = mpsc::sync_channel(self.division.lanes);
        let filled = Mutex::new(filled);
        let (results, outcomes) = mpsc::channel();
        let converted = std::thread::scope(|scope| {
            for lane in 0..self.division.lanes {
                let (jobs, to_disk, progress) = (&jobs, to_disk.clone(), &progress);
                scope.spawn(move || self.lane(lane, jobs, &to_disk, progress));
            }
            drop(to_disk);
            let _at_last = AtLast(&self.settled);
            let followed = match watch {
                Some(watch) => Some((watch, to_lanes)),
                None => {
                    tally.total = todo.len();
                    self.give(&todo, frames, to_lanes, &mut tally)?;
                    None
                }
            };
            for _ in 0..self.division.lanes {
                let (filled, results) = (&filled, results.clone());
                scope.spawn(move || self.keep(filled, &results));
            }
            drop(results);
            match followed {
                Some((watch, to_lanes)) => self.follow(watch, to_lanes, &outcomes, &mut tally, &progress),
                None => outcomes.iter().try_for_each(|outcome| self.note(outcome, &mut tally, &progress)),
            }
        });
        progress.finish();
        converted?;
        report_device(&*self.setup.resources.backend, tally.done, &tally.notes);
        tally.finish(&self.setup.frames()?)
    }

    /// Gives the lanes what becomes complete, until nothing more is to be expected.
    fn follow(
        &self,
        mut watch: Watch,
        to_lanes: Sender<Job>,
        outcomes: &Receiver<Outcome<Done>>,
        tally: &mut Tally,
        progress: &Progress,
    ) -> Result<(), Error> {
        let options = &self.setup.options.sequence;
        let mut under_way = 0;
        loop {
            if self.stop.load(Ordering::Relaxed) {
                drop(to_lanes);
                return outcomes.iter().try_for_each(|outcome| self.note(outcome, tally, progress));
            }
            match outcomes.recv_timeout(POLL) {
                Ok(outcome) => {
                    under_way -= 1;
                    let number = outcome.frame.number;
                    self.note(outcome, tally, progress)?;
                    watch.done(number);
                }
                Err(RecvTimeoutError::Disconnected) => return Ok(()),
                Err(RecvTimeoutError::Timeout) => {
                    for Ready { frame, again } in watch.ready(&self.setup.frames()?) {
                        let is_done = options.resume && !again && tally.lists(&frame);
                        if !options.wants(frame.number) || is_done {
                            watch.done(frame.number);
                            continue;
                        }
                        under_way += 1;
                        tally.total += 1;
                        progress.lengthen(size(&frame));
                        let _ = to_lanes.send(Job { frame, particles: None, again });
                    }
                    if under_way == 0 && watch.is_over() {
                        return Ok(());
                    }
                }
            }
        }
    }

    /// Notes what became of a frame.
    fn note(&self, outcome: Outcome<Done>, tally: &mut Tally, progress: &Progress) -> Result<(), Error> {
        let Outcome { frame, result } = outcome;
        let taken = tally.take(&frame, result, progress.has_bars());
        if !matches!(taken, Ok(false)) {
            self.stop.store(true, Ordering::Relaxed);
        }
        taken?;
        progress.advance(tally.done, tally.total, tally.failed.len(), || size(&frame));
        Ok(())
    }

    /// Converts frames until there are no more.
    fn lane(
        &self,
        lane: usize,
        jobs: &Mutex<Receiver<Job>>,
        to_disk: &SyncSender<Outcome<Filled>>,
        progress: &Progress,
    ) {
        // This thread is one of the pool's, or every step of a frame would wait for another to wake up.
        let pool = rayon::ThreadPoolBuilder::new().num_threads(self.division.threads).use_current_thread();
        let _pool = pool.build().expect("threads can be started");
        while let Some(Job { frame, particles, again }) = next(jobs) {
            if self.stop.load(Ordering::Relaxed) {
                continue;
            }
            let stage = |stage: &str| progress.stage(lane, || format!("frame {}: {stage}", frame.number));
            let opened = self.open(&frame, particles, again, &stage);
            let Some(settled) = self.settled.wait() else { return };
            let result = opened.and_then(|opened| self.convert(&frame, opened, settled, &stage));
            progress.stage(lane, String::new);
            if to_disk.send(Outcome { frame, result }).is_err() {
                return;
            }
        }
    }

    /// Waits for the disk, so that no lane has to.
    fn keep(&self, filled: &Mutex<Receiver<Outcome<Filled>>>, results: &Sender<Outcome<Done>>) {
        while let Some(Outcome { frame, result }) = next(filled) {
            let result = result.and_then(|filled| self.finish(filled));
            if results.send(Outcome { frame, result }).is_err() {
                return;
            }
        }
    }
}

/// What comes next to any of several threads.
fn next<T>(receiver: &Mutex<Receiver<T>>) -> Option<T> {
    receiver.lock().unwrap_or_else(PoisonError::into_inner).recv().ok()
}

/// What is left to do is told by this.
fn size(frame: &FrameFile) -> u64 {
    Stamp::of(&frame.path).map_or(0, |stamp| stamp.bytes)
}

//! `meniscus reconstruct` for the frames of a simulation: its options, and what is said of its events.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use clap::Args;
use meniscus::{Error, Event, FrameDone, FrameFailed, Simulation, Summary, Tallied};

use crate::advice::{doubted, told, warned};
use crate::interrupt;
use crate::options::Options;
use crate::outcome::{Verdict, print};
use crate::progress::{Progress, ProgressMode};
use crate::report::{dropped, report_census, report_device, report_lost};
use crate::run::Notes;
use crate::stats::{of_failed, of_frame};

#[derive(Args)]
pub struct SequenceOptions {
    /// The first frame of the sequence.
    #[arg(long, value_name = "N", help_heading = "Sequences", hide_short_help = true)]
    start: Option<u64>,
    /// The last frame of the sequence.
    #[arg(long, value_name = "N", help_heading = "Sequences", hide_short_help = true)]
    end: Option<u64>,
    /// Every Nth frame.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..), help_heading = "Sequences", hide_short_help = true)]
    step: Option<u64>,
    /// Convert these frames of the sequence only, both ends included, as one of several jobs.
    #[arg(long, value_name = "A..B", value_parser = range, help_heading = "Sequences", hide_short_help = true)]
    frames: Option<(u64, u64)>,
    /// Go on with a conversion that was begun.
    ///
    /// Skip what is done, whole, and made with the same settings; make the rest.
    #[arg(long, help_heading = "Sequences")]
    resume: bool,
    /// Follow a simulation that runs.
    ///
    /// Until --end, or until nothing has come for so many seconds.
    #[arg(long, value_name = "SECONDS", num_args = 0..=1, require_equals = true, default_missing_value = "inf", help_heading = "Sequences")]
    watch: Option<f64>,
    /// Frames a second, for times where the files have none.
    #[arg(long, value_name = "RATE", help_heading = "Sequences", hide_short_help = true)]
    fps: Option<f64>,
    /// Measure what all frames have in common, write the state file, print the frames' numbers, one a line, and stop.
    #[arg(long, conflicts_with_all = ["watch", "dry_run"], help_heading = "Sequences", hide_short_help = true)]
    plan: bool,
    /// Bars on a terminal, or a line for each frame.
    #[arg(long, value_enum, default_value_t = ProgressMode::Auto, help_heading = "Messages", hide_short_help = true)]
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

    /// What was asked for, of a simulation.
    fn of(&self, mut simulation: Simulation) -> Simulation {
        if let Some(start) = self.start {
            simulation = simulation.start(start);
        }
        if let Some(end) = self.end {
            simulation = simulation.end(end);
        }
        if let Some(step) = self.step {
            simulation = simulation.step(step);
        }
        if let Some((first, last)) = self.frames {
            simulation = simulation.frames(first..=last);
        }
        if let Some(seconds) = self.watch {
            simulation = simulation.watch(seconds);
        }
        if let Some(fps) = self.fps {
            simulation = simulation.fps(fps);
        }
        if self.resume { simulation.resume() } else { simulation }
    }
}

/// Runs the command, for each sequence that is there.
pub fn run(options: &Options, simulation: Simulation) -> Result<Verdict, Error> {
    let mut simulation = options.sequence.of(simulation);
    if options.run.overwrite {
        simulation = simulation.overwrite();
    }
    if let Some(stats) = &options.stats {
        simulation = simulation.beside(stats);
    }
    let request = options.request()?;
    let simulation = simulation.reconstruction(request.clone());
    simulation.check()?;
    let cancel = interrupt::handle();
    let frame = options.output.join("frame");
    let request = options.run.machine(request, &frame, || simulation.input_bytes())?.cancel(cancel.clone());
    let device = request.device().cloned();
    let simulation = simulation.reconstruction(request);
    simulation.check()?;
    options.prepare_stats()?;
    let teller = Teller {
        options,
        notes: options.run.notes(),
        bars: Mutex::default(),
        failed: Mutex::default(),
        broken: Mutex::default(),
        bad: Mutex::new(false),
        stop: &|| cancel.cancel(),
        device: &|done, notes| report_device(device.as_ref(), done, notes),
    };
    let hear = |event: Event<'_>| teller.hear(event);
    if options.dry_run {
        for forecast in simulation.forecast(hear)? {
            print(&forecast.to_string())?;
        }
        return Ok(teller.verdict());
    }
    interrupt::resumable();
    if options.sequence.plan {
        let numbers: Vec<String> = simulation.plan(hear)?.iter().map(u64::to_string).collect();
        print(&numbers.join("\n"))?;
        return Ok(teller.verdict());
    }
    let converted = simulation.run(hear);
    // What stopped all others is what went wrong.
    if let Some(error) = lock(&teller.broken).take() {
        return Err(error);
    }
    converted.map(|_| teller.verdict())
}

/// Says what happens.
struct Teller<'a> {
    options: &'a Options,
    notes: Notes,
    /// Bars of the sequence that is under way, with the notes that go above them.
    bars: Mutex<Option<Arc<(Progress, Notes)>>>,
    /// Why frames are not there.
    failed: Mutex<BTreeMap<u64, String>>,
    /// What cannot be written beside the meshes.
    broken: Mutex<Option<Error>>,
    bad: Mutex<bool>,
    stop: &'a (dyn Fn() + Sync),
    device: &'a (dyn Fn(usize, &Notes) + Sync),
}

fn lock<T>(of: &Mutex<T>) -> MutexGuard<'_, T> {
    of.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Teller<'_> {
    fn verdict(&self) -> Verdict {
        if *lock(&self.bad) { Verdict::Bad } else { Verdict::Good }
    }

    fn hear(&self, event: Event<'_>) {
        let bars = lock(&self.bars).clone();
        let (progress, notes) = match &bars {
            Some(bars) => (Some(&bars.0), &bars.1),
            None => (None, &self.notes),
        };
        match event {
            Event::Doubted(doubt) => notes.warn(&doubted(doubt)),
            Event::Waiting { .. } | Event::Anew { .. } | Event::GoesOn { .. } | Event::Measured { .. } => {
                notes.say(event.to_string());
            }
            Event::Begins { frames, done, bytes, lanes, followed } => {
                if done > 0 {
                    notes.say(event.to_string());
                }
                let idle = frames == done && !followed;
                let mode = if idle { ProgressMode::Never } else { self.options.sequence.progress };
                *lock(&self.bars) = Some(Arc::new(Progress::start(mode, bytes, lanes, self.notes.clone())));
            }
            Event::Came { bytes } => progress.into_iter().for_each(|progress| progress.lengthen(bytes)),
            Event::Stage { lane, stage, .. } => {
                let what = || stage.map_or(String::new(), |_| event.to_string());
                progress.into_iter().for_each(|progress| progress.stage(lane, what));
            }
            Event::Done(done) => self.done(done, &event, progress, notes),
            Event::Failed(failed) => self.failed(failed, progress, notes),
            Event::SequenceFailed(error) => {
                notes.error(format!("meniscus: {}", told(error)));
                *lock(&self.bad) = true;
            }
            Event::Ended(summary) => {
                progress.into_iter().for_each(Progress::finish);
                *lock(&self.bars) = None;
                self.ended(summary, &event);
            }
            _ => {}
        }
    }

    /// Keeps statistics; where they cannot be written, no further frame is begun.
    fn append(&self, record: impl FnOnce() -> serde_json::Value) {
        if let Err(error) = self.options.append_stats(record) {
            lock(&self.broken).get_or_insert(error);
            (self.stop)();
        }
    }

    fn done(&self, done: &FrameDone, event: &Event<'_>, progress: Option<&Progress>, notes: &Notes) {
        lock(&self.failed).remove(&done.mesh.frame);
        for warning in &done.warnings {
            notes.warn(&format!("{}: {}", done.input.display(), warned(warning, Some(self.options))));
        }
        if progress.is_some_and(Progress::has_bars) {
            notes.detail(event.to_string());
        } else {
            notes.say(event.to_string());
        }
        self.append(|| of_frame(self.options, done));
        advance(progress, &done.progress);
    }

    fn failed(&self, failed: &FrameFailed, progress: Option<&Progress>, notes: &Notes) {
        let why = told(&failed.error);
        notes.error(format!("meniscus: {why}"));
        lock(&self.failed).insert(failed.frame, why);
        self.append(|| of_failed(failed));
        advance(progress, &failed.progress);
    }

    fn ended(&self, summary: &Summary, event: &Event<'_>) {
        let notes = &self.notes;
        (self.device)(summary.made + summary.failed, notes);
        if let Some(missing) = &summary.chosen {
            notes.say(format!("{}: there are no frames {missing}", summary.inputs));
        }
        notes.say(event.to_string());
        let left_out = &summary.left_out;
        if let Some(particles) = self.options.smallest_drop.filter(|&particles| particles > 1) {
            notes.say(dropped(left_out.drops, particles));
        }
        report_census(&left_out.census, notes);
        report_lost(left_out.lost, left_out.census.binned, summary.smoothed, notes);
        let mut failed = std::mem::take(&mut *lock(&self.failed));
        if summary.is_complete() {
            return;
        }
        *lock(&self.bad) = true;
        failed.iter_mut().for_each(|(frame, why)| *why = format!("frame {frame}: {why}"));
        let missing = summary.missing.iter().map(|missing| (missing.first, missing.to_string()));
        let mut lines: Vec<(u64, String)> = failed.into_iter().chain(missing).collect();
        lines.sort();
        let mut list = format!("meniscus: {} frames failed:", summary.lacking());
        lines.iter().for_each(|(_, line)| list += &format!("\n  {line}"));
        notes.error(list);
    }
}

fn advance(progress: Option<&Progress>, tallied: &Tallied) {
    let Tallied { done, total, failed, bytes, .. } = *tallied;
    progress.into_iter().for_each(|progress| progress.advance(done, total, failed, bytes));
}

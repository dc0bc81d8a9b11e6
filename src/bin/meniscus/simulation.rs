//! `meniscus reconstruct` for the frames of a simulation: what is said of its events.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use meniscus::{Error, Event, FrameDone, FrameFailed, Simulation, Summary, Tallied};

use crate::advice::{doubted, told, warned};
use crate::interrupt;
use crate::notes::Notes;
use crate::options::Options;
use crate::outcome::{Verdict, print};
use crate::progress::{Progress, ProgressMode};
use crate::report::{report_census, report_device, too_small, warn_all};
use crate::stats::{of_failed, of_frame};

/// Runs the command, for each simulation that is there.
pub fn run(options: &Options, simulation: Simulation) -> Result<Verdict, Error> {
    let mut simulation = options.simulation.of(simulation);
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
    let sheet = options.preview.then(|| simulation.sheet()).transpose()?;
    interrupt::resumable();
    if options.simulation.plan {
        let numbers: Vec<String> = simulation.plan(hear)?.iter().map(u64::to_string).collect();
        print(&numbers.join("\n"))?;
        return Ok(teller.verdict());
    }
    let converted = simulation.run(hear);
    // What stopped all others is what went wrong.
    if let Some(error) = lock(&teller.broken).take() {
        return Err(error);
    }
    converted?;
    if let Some(sheet) = sheet {
        let path = sheet.path().to_owned();
        sheet.draw()?;
        teller.notes.say(format!("{}: a sheet of the frames", path.display()));
    }
    Ok(teller.verdict())
}

/// Says what happens.
struct Teller<'a> {
    options: &'a Options,
    notes: Notes,
    /// Bars of the simulation that is under way, with the notes that go above them.
    bars: Mutex<Option<Arc<(Progress, Notes)>>>,
    /// Why frames are not there.
    failed: Mutex<BTreeMap<u64, String>>,
    /// The failure of a file beside the meshes.
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
                let mode = if idle { ProgressMode::Never } else { self.options.simulation.progress };
                *lock(&self.bars) = Some(Arc::new(Progress::start(mode, bytes, lanes, self.notes.clone())));
            }
            Event::Came { bytes } => progress.into_iter().for_each(|progress| progress.lengthen(bytes)),
            Event::Stage { lane, stage, .. } => {
                let what = || stage.map_or(String::new(), |_| event.to_string());
                progress.into_iter().for_each(|progress| progress.stage(lane, what));
            }
            Event::Done(done) => self.done(done, &event, progress, notes),
            Event::Failed(failed) => self.failed(failed, progress, notes),
            Event::SimulationFailed(error) => {
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
        if let Some(particles) = self.options.settings.smallest_drop.filter(|&particles| particles > 1) {
            notes.say(too_small(left_out.drops, particles));
        }
        report_census(&left_out.census, notes);
        warn_all(summary.lost().as_slice(), None, notes);
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

//! `meniscus reconstruct` for the frames of a simulation: options and messages.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use clap::Args;
use meniscus::devices::Device;
use meniscus::files::UnreadPart;
use meniscus::{
    Cancel, Error, Event, FrameCounts, FrameDone, FrameFailed, Simulation, Summary, Warning,
};

use super::advice::{error_message, no_velocity_message, spacing_message, warning_message};
use super::interrupt;
use super::notes::Notes;
use super::notes::{Verdict, print};
use super::options::ReconstructOptions;
use super::progress::{ProgressBars, ProgressMode};
use super::report::{counted, report_census, report_device, too_small, type_read, warn_all};
use super::stats::{of_failed, of_frame, of_missing};

/// Runs `meniscus reconstruct` for each simulation in the inputs.
pub fn run(options: &ReconstructOptions, simulation: Simulation) -> Result<Verdict, Error> {
    let mut simulation = options.simulation.apply_to(simulation);
    if options.run.overwrite {
        simulation = simulation.overwrite();
    }
    if let Some(stats) = &options.stats {
        simulation = simulation.also_writes(stats);
    }
    let request = options.request()?;
    let simulation = simulation.reconstruction(request.clone());
    simulation.check()?;
    let cancel = interrupt::handle();
    let frame = options.output.join("frame");
    let request =
        options.run.machine(request, &frame, || simulation.input_bytes())?.cancel(cancel.clone());
    let device = request.device().cloned();
    let mut simulation = simulation.reconstruction(request);
    simulation.check()?;
    options.prepare_stats()?;
    let notes = options.run.notes();
    let mut listener = Listener {
        options,
        notes,
        bars: None,
        types: BTreeSet::new(),
        repeated: BTreeMap::new(),
        stats_error: None,
        is_incomplete: false,
        cancel,
        device,
    };
    let on_event = |event: Event| listener.handle_event(&event);
    if options.dry_run {
        for forecast in simulation.forecast(on_event)? {
            print(&forecast.to_string())?;
        }
        return Ok(listener.verdict());
    }
    let sheet = options.preview.then(|| simulation.sheet()).transpose()?;
    interrupt::set_resumable();
    if options.simulation.plan {
        let numbers: Vec<String> = simulation.plan(on_event)?.iter().map(i64::to_string).collect();
        print(&numbers.join("\n"))?;
        return Ok(listener.verdict());
    }
    let converted = simulation.run(on_event);
    // If the statistics could not be written, the listener has cancelled the conversion. Report the
    // error of the statistics instead of the cancellation.
    if let Some(error) = listener.stats_error.take() {
        return Err(error);
    }
    converted?;
    if let Some(sheet) = sheet {
        let done = sheet.draw()?;
        done.warning().iter().for_each(|warning| listener.notes.warn(warning));
        listener.notes.say(done.to_string());
    }
    Ok(listener.verdict())
}

/// Prints messages about the events of a conversion.
struct Listener<'a> {
    options: &'a ReconstructOptions,
    notes: Notes,
    /// Bars of the current simulation, with the notes that are printed above them.
    bars: Option<(ProgressBars, Notes)>,
    /// Descriptions of particle types that were already printed, so that each description is
    /// printed only once.
    types: BTreeSet<String>,
    /// Warnings that usually concern all frames, each with the number of frames that have it. The
    /// key is the text of the warning or, if the text can differ from frame to frame, the name of
    /// the attribute.
    repeated: BTreeMap<String, (String, usize)>,
    /// The first error while writing the statistics.
    stats_error: Option<Error>,
    is_incomplete: bool,
    cancel: Cancel,
    device: Option<Device>,
}

impl Listener<'_> {
    fn verdict(&self) -> Verdict {
        if self.is_incomplete { Verdict::Bad } else { Verdict::Good }
    }

    fn progress(&self) -> Option<&ProgressBars> {
        self.bars.as_ref().map(|(progress, _)| progress)
    }

    fn notes(&self) -> &Notes {
        self.bars.as_ref().map_or(&self.notes, |(_, notes)| notes)
    }

    fn handle_event(&mut self, event: &Event) {
        match event {
            Event::SpacingWarning(warning) => self.notes().warn(&spacing_message(warning)),
            Event::NoVelocity { path, found } => {
                self.notes().say(format!("{}: {}", path.display(), no_velocity_message(found)));
            }
            Event::Waiting { .. }
            | Event::TimesInNames { .. }
            | Event::Restarted { .. }
            | Event::Resumed { .. }
            | Event::Measured { .. } => {
                self.notes().say(event.to_string());
            }
            &Event::Started { frames, done, bytes, lanes, followed } => {
                if done > 0 {
                    self.notes().say(event.to_string());
                }
                let idle = frames == done && !followed;
                let mode =
                    if idle { ProgressMode::Never } else { self.options.simulation.progress };
                self.bars = Some(ProgressBars::start(mode, bytes, lanes, self.notes.clone()));
            }
            Event::FrameAppeared { bytes } => {
                self.progress().into_iter().for_each(|bars| bars.lengthen(*bytes))
            }
            &Event::Stage { lane, progress, .. } => {
                let what = || {
                    progress.map_or(String::new(), |at| format!("{event} {:.0} %", 100.0 * at.done))
                };
                self.progress().into_iter().for_each(|bars| bars.stage(lane, what));
            }
            Event::Done(done) => self.done(done),
            Event::Failed(failed) => self.failed(failed),
            Event::SimulationFailed(error) => {
                self.notes().error(format!("meniscus: {}", error_message(error)));
                self.is_incomplete = true;
            }
            Event::Ended(summary) => {
                self.progress().into_iter().for_each(ProgressBars::finish);
                self.bars = None;
                self.ended(summary);
            }
        }
    }

    /// Appends a line of statistics. If this fails, cancels the conversion.
    fn append(&mut self, record: impl FnOnce() -> serde_json::Value) {
        if let Err(error) = self.options.append_stats(record) {
            self.stats_error.get_or_insert(error);
            self.cancel.cancel();
        }
    }

    fn done(&mut self, done: &FrameDone) {
        if let Some(read) = type_read(&done.particle_types)
            && self.types.insert(read.clone())
        {
            self.notes().say(format!("{}: type {read}", done.input.display()));
        }
        for warning in &done.warnings {
            if let Warning::LeftOut(_) | Warning::Renamed { .. } | Warning::Coarse { .. } = warning
            {
                // The shape of an array can differ from frame to frame, so count these warnings by
                // the name of the array instead of the text of the warning.
                let key = match warning {
                    Warning::LeftOut(part @ UnreadPart::OtherShape { .. }) => part.attribute(),
                    _ => None,
                };
                let text = warning.to_string();
                let key = key.map_or_else(|| text.clone(), str::to_owned);
                let (_, frames) = self.repeated.entry(key).or_insert((text, 0));
                *frames += 1;
                if *frames > 1 {
                    continue;
                }
            }
            let warning = warning_message(warning, Some(self.options));
            self.notes().warn(&format!("{}: {warning}", done.input.display()));
        }
        if self.progress().is_some_and(ProgressBars::has_bars) {
            self.notes().detail(done.to_string());
        } else {
            self.notes().say(done.to_string());
        }
        self.append(|| of_frame(self.options, done));
        self.advance(&done.progress);
    }

    fn failed(&mut self, failed: &FrameFailed) {
        self.notes().error(format!("meniscus: {}", error_message(&failed.error)));
        self.append(|| of_failed(failed));
        self.advance(&failed.progress);
    }

    fn advance(&self, &FrameCounts { done, total, failed, bytes, .. }: &FrameCounts) {
        self.progress().into_iter().for_each(|bars| bars.advance(done, total, failed, bytes));
    }

    fn ended(&mut self, summary: &Summary) {
        for (frame, input) in summary.missing.iter().flat_map(|missing| &missing.frames) {
            self.append(|| of_missing(*frame, input));
        }
        let notes = &self.notes;
        for (warning, frames) in std::mem::take(&mut self.repeated).into_values() {
            if frames > 1 {
                notes.warn(&format!("in {frames} frames, {warning}"));
            }
        }
        if let Some(unused) = &summary.unused_times {
            let rate = if unused.fps.is_none() { " (--fps sets the frame rate)" } else { "" };
            notes.warn(&format!("{}: {unused}{rate}", summary.inputs));
        }
        report_device(self.device.as_ref(), summary.made + summary.failed.len(), notes);
        if let Some(missing) = &summary.chosen {
            notes.say(format!("{}: no files for frames {missing}", summary.inputs));
        }
        for unreached in &summary.unreached {
            notes.say(format!("{}: {unreached}", summary.inputs));
        }
        notes.say(summary.to_string());
        if summary.without_input > 0 {
            let (meshes, stay) = match summary.without_input {
                1 => ("mesh", "stays"),
                _ => ("meshes", "stay"),
            };
            notes.say(format!(
                "{} existing {meshes} without an input {stay} in the list of frames; use \
                 --overwrite to list only frames with an input",
                summary.without_input
            ));
        }
        stale(&summary.stale).into_iter().for_each(|warning| notes.warn(&warning));
        let left_out = &summary.left_out;
        if let Some(particles) =
            self.options.settings.smallest_drop.filter(|&particles| particles > 1)
        {
            notes.say(too_small(left_out.drops, particles));
        }
        if left_out.unselected > 0 {
            notes.say(format!("{} left out by --where", counted(left_out.unselected, "particle")));
        }
        report_census(&left_out.census, notes);
        warn_all(summary.lost().as_slice(), None, notes);
        if !summary.is_complete() {
            self.is_incomplete = true;
            notes.error(incomplete(summary));
        }
    }
}

/// A warning about meshes of earlier runs that remain next to the new meshes, if there are any.
fn stale(meshes: &[PathBuf]) -> Option<String> {
    let (first, last) = (meshes.first()?.display(), meshes.last()?.display());
    Some(match meshes.len() {
        1 => format!("{first}: this mesh is from an earlier run; delete it if you do not need it"),
        count => format!(
            "{first} to {last}: {count} of these meshes are from an earlier run; delete them if \
             you do not need them"
        ),
    })
}

/// Lists failed frames and ranges of missing frames, one per line, in frame order.
fn incomplete(summary: &Summary) -> String {
    let failed = summary.failed.iter();
    let failed = failed.map(|failed| {
        (failed.frame, format!("frame {}: {}", failed.frame, error_message(&failed.error)))
    });
    let missing = summary.missing.iter().map(|missing| (missing.first, missing.to_string()));
    let lines: BTreeSet<(i64, String)> = failed.chain(missing).collect();
    let count = summary.incomplete_frames();
    let mut list = format!("meniscus: {count} frame{} failed:", if count == 1 { "" } else { "s" });
    lines.iter().for_each(|(_, line)| list += &format!("\n  {line}"));
    list
}

#[derive(Args)]
pub struct SimulationOptions {
    /// First frame to convert.
    #[arg(
        long,
        value_name = "N",
        allow_negative_numbers = true,
        help_heading = "Simulations",
        hide_short_help = true
    )]
    start: Option<i64>,
    /// Last frame to convert.
    #[arg(
        long,
        value_name = "N",
        allow_negative_numbers = true,
        help_heading = "Simulations",
        hide_short_help = true
    )]
    end: Option<i64>,
    /// Convert frames F, F + N, F + 2N and so on, where F is --start or the first frame's number.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..), help_heading = "Simulations", hide_short_help = true)]
    step: Option<u64>,
    /// Convert only frames A to B (inclusive), as one of several jobs that share a simulation.
    ///
    /// The calibration (the density deep in the fluid, which all frames share) is measured on one
    /// of the frames that --start, --end and --step select. --frames has no effect on which frame
    /// is measured, so all jobs use the same calibration, and together make the same meshes as a
    /// single run.
    #[arg(long, value_name = "A..B", value_parser = range, allow_hyphen_values = true, help_heading = "Simulations", hide_short_help = true)]
    frames: Option<(i64, i64)>,
    /// Resume an interrupted conversion.
    ///
    /// Finished frames are kept, and all other frames are made. If settings have changed, the
    /// conversion fails; use --overwrite to make all frames again.
    #[arg(long, help_heading = "Simulations")]
    pub resume: bool,
    /// Convert frames as a running simulation writes them.
    ///
    /// The conversion stops after the last frame (--end), or once no file has appeared or changed
    /// for SECONDS [default: no limit].
    #[arg(long, value_name = "SECONDS", num_args = 0..=1, require_equals = true, default_missing_value = "inf", conflicts_with = "dry_run", help_heading = "Simulations")]
    pub watch: Option<f64>,
    /// Frames per second of the simulation.
    ///
    /// If the files contain times, meniscus uses these times, and the rate only sets the number of
    /// frames per second in USD stages and Alembic archives.
    #[arg(long, value_name = "RATE", help_heading = "Simulations", hide_short_help = true)]
    pub fps: Option<f64>,
    /// Prepare a conversion that several jobs will share: calibrate, write the state file, and
    /// print the frame numbers, one per line. With --parts, prepare the parts of one mesh.
    #[arg(long, conflicts_with_all = ["watch", "dry_run"], help_heading = "Simulations", hide_short_help = true)]
    pub plan: bool,
    /// Show progress as bars, or as a line for each frame.
    #[arg(long, value_enum, default_value_t = ProgressMode::Auto, help_heading = "Messages", hide_short_help = true)]
    pub progress: ProgressMode,
}

fn range(text: &str) -> Result<(i64, i64), String> {
    let numbers = text.split_once("..").and_then(|(a, b)| Some((a.parse().ok()?, b.parse().ok()?)));
    numbers
        .filter(|(a, b)| a <= b)
        .ok_or_else(|| "expected the first and the last frame number, such as 100..199".to_owned())
}

/// Returns an error if one of `options` was given, because these options apply only to simulations.
fn refuse_sequence_options(options: &[(&str, bool)]) -> Result<(), Error> {
    match options.iter().find(|(_, given)| *given) {
        None => Ok(()),
        Some((name, _)) => Err(Error::Request(format!(
            "{name} is only for simulations; give several input frames, and an output with {{}} \
             for the frame number"
        ))),
    }
}

impl SimulationOptions {
    /// Rejects options that do not apply to a single frame.
    pub fn refuse_for_one_frame(&self) -> Result<(), Error> {
        refuse_sequence_options(&[("--resume", self.resume), ("--plan", self.plan)])?;
        self.refuse_for_parts()
    }

    /// Rejects options that do not apply to a single frame that is made in parts.
    pub fn refuse_for_parts(&self) -> Result<(), Error> {
        refuse_sequence_options(&[
            ("--start", self.start.is_some()),
            ("--end", self.end.is_some()),
            ("--step", self.step.is_some()),
            ("--frames", self.frames.is_some()),
            ("--watch", self.watch.is_some()),
            ("--fps", self.fps.is_some()),
        ])
    }

    /// Adds these options to the request for a simulation.
    pub fn apply_to(&self, mut simulation: Simulation) -> Simulation {
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

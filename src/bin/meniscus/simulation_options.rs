//! Options on which frames are converted, and how their conversion goes.

use clap::Args;
use meniscus::{Error, Simulation};

use crate::progress::ProgressMode;

#[derive(Args)]
pub struct SimulationOptions {
    /// The first frame of the simulation.
    #[arg(long, value_name = "N", help_heading = "Simulations", hide_short_help = true)]
    start: Option<u64>,
    /// The last frame of the simulation.
    #[arg(long, value_name = "N", help_heading = "Simulations", hide_short_help = true)]
    end: Option<u64>,
    /// Every Nth frame.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..), help_heading = "Simulations", hide_short_help = true)]
    step: Option<u64>,
    /// Convert these frames of the simulation only, both ends included, as one of several jobs.
    #[arg(long, value_name = "A..B", value_parser = range, help_heading = "Simulations", hide_short_help = true)]
    frames: Option<(u64, u64)>,
    /// Go on with a conversion that was begun.
    ///
    /// Skip what is done, whole, and made with the same settings; make the rest.
    #[arg(long, help_heading = "Simulations")]
    pub resume: bool,
    /// Follow a simulation that runs.
    ///
    /// Until --end, or until nothing has come for so many seconds.
    #[arg(long, value_name = "SECONDS", num_args = 0..=1, require_equals = true, default_missing_value = "inf", help_heading = "Simulations")]
    pub watch: Option<f64>,
    /// Frames a second, for times where the files have none.
    #[arg(long, value_name = "RATE", help_heading = "Simulations", hide_short_help = true)]
    pub fps: Option<f64>,
    /// Measure what all frames have in common, write the state file, print the frames' numbers, one a line, and stop; with --parts plan
    /// these.
    #[arg(long, conflicts_with_all = ["watch", "dry_run"], help_heading = "Simulations", hide_short_help = true)]
    pub plan: bool,
    /// Bars on a terminal, or a line for each frame.
    #[arg(long, value_enum, default_value_t = ProgressMode::Auto, help_heading = "Messages", hide_short_help = true)]
    pub progress: ProgressMode,
}

fn range(text: &str) -> Result<(u64, u64), String> {
    let numbers = text.split_once("..").and_then(|(a, b)| Some((a.parse().ok()?, b.parse().ok()?)));
    numbers.filter(|(a, b)| a <= b).ok_or_else(|| "two numbers in order, as 100..199".to_owned())
}

/// Refuses an option that was given, and has no meaning but for simulations.
fn refuse_of_sequences(options: &[(&str, bool)]) -> Result<(), Error> {
    match options.iter().find(|(_, given)| *given) {
        None => Ok(()),
        Some((name, _)) => Err(Error::Request(format!("{name} needs a simulation: an output with {{}}"))),
    }
}

impl SimulationOptions {
    /// Refuses what has no meaning for a single frame.
    pub fn refuse_for_one_frame(&self) -> Result<(), Error> {
        refuse_of_sequences(&[("--resume", self.resume), ("--plan", self.plan)])?;
        self.refuse_for_parts()
    }

    /// Refuses what has no meaning for a single frame in parts.
    pub fn refuse_for_parts(&self) -> Result<(), Error> {
        refuse_of_sequences(&[
            ("--start", self.start.is_some()),
            ("--end", self.end.is_some()),
            ("--step", self.step.is_some()),
            ("--frames", self.frames.is_some()),
            ("--watch", self.watch.is_some()),
            ("--fps", self.fps.is_some()),
        ])
    }

    /// Adds these options to the request for a simulation.
    pub fn of(&self, mut simulation: Simulation) -> Simulation {
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

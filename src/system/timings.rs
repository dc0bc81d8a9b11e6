//! Measures the time of each stage of a frame.

use std::time::Instant;

/// The names of the stages and their durations in seconds, in the order in which the stages ended.
#[derive(Debug, Clone)]
pub struct Timings {
    last: Instant,
    seconds: Vec<(&'static str, f64)>,
}

impl Default for Timings {
    fn default() -> Self {
        Self { last: Instant::now(), seconds: Vec::new() }
    }
}

impl Timings {
    /// Ends a stage, which began when the previous stage ended.
    pub fn done(&mut self, stage: &'static str) {
        let now = Instant::now();
        self.seconds.push((stage, (now - self.last).as_secs_f64()));
        self.last = now;
    }

    /// Ignores the time since the last stage ended, because it was spent on other work.
    pub fn skip(&mut self) {
        self.last = Instant::now();
    }

    /// Name and duration, in seconds, of every finished stage.
    #[must_use]
    pub fn seconds(&self) -> &[(&'static str, f64)] {
        &self.seconds
    }

    /// Total duration, in seconds, of all finished stages.
    #[must_use]
    pub fn total(&self) -> f64 {
        self.seconds.iter().map(|(_, seconds)| seconds).sum()
    }
}

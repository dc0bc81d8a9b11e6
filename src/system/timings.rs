//! Time of each stage of a frame.

use std::time::Instant;

/// Names and seconds of the stages, in the order in which they ended.
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
    /// Ends a stage, which began when the previous one ended.
    pub fn done(&mut self, stage: &'static str) {
        let now = Instant::now();
        self.seconds.push((stage, (now - self.last).as_secs_f64()));
        self.last = now;
    }

    /// Ignores the time since the last stage ended, in which other work was done.
    pub fn skip(&mut self) {
        self.last = Instant::now();
    }

    /// Seconds of every finished stage.
    #[must_use]
    pub fn seconds(&self) -> &[(&'static str, f64)] {
        &self.seconds
    }

    /// Seconds of all stages.
    #[must_use]
    pub fn total(&self) -> f64 {
        self.seconds.iter().map(|(_, seconds)| seconds).sum()
    }
}

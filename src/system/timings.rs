//! How long each stage of a frame took.

use std::time::Instant;

/// Seconds that stages took, by name, in the order in which they ended.
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
    /// Ends a stage, which began when the one before it ended.
    pub fn done(&mut self, stage: &'static str) {
        let now = Instant::now();
        self.seconds.push((stage, (now - self.last).as_secs_f64()));
        self.last = now;
    }

    /// Leaves out the time since the last stage ended: others were at work.
    pub fn skip(&mut self) {
        self.last = Instant::now();
    }

    /// Seconds of every stage that has ended.
    #[must_use]
    pub fn seconds(&self) -> &[(&'static str, f64)] {
        &self.seconds
    }

    /// Seconds of all stages together.
    #[must_use]
    pub fn total(&self) -> f64 {
        self.seconds.iter().map(|(_, seconds)| seconds).sum()
    }
}

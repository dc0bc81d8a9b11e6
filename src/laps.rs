//! How long each stage took.

use std::time::Instant;

/// Seconds since the last lap, by name, in order.
#[derive(Debug, Clone)]
pub struct Laps {
    last: Instant,
    seconds: Vec<(&'static str, f64)>,
}

impl Default for Laps {
    fn default() -> Self {
        Self { last: Instant::now(), seconds: Vec::new() }
    }
}

impl Laps {
    /// Ends a lap.
    pub fn lap(&mut self, stage: &'static str) {
        let now = Instant::now();
        self.seconds.push((stage, (now - self.last).as_secs_f64()));
        self.last = now;
    }

    /// Leaves out what passed since the last lap: others were at work.
    pub fn skip(&mut self) {
        self.last = Instant::now();
    }

    /// All laps so far.
    #[must_use]
    pub fn seconds(&self) -> &[(&'static str, f64)] {
        &self.seconds
    }

    /// Seconds of all laps together.
    #[must_use]
    pub fn total(&self) -> f64 {
        self.seconds.iter().map(|(_, seconds)| seconds).sum()
    }
}

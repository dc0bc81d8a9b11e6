//! Progress and cancellation of long work.

use std::fmt;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use super::cancel::{Cancel, Cancelled};

/// A stage between particles and a mesh file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[non_exhaustive]
pub enum Stage {
    /// The input is read.
    Reading,
    /// Particles are counted in cells, to estimate the memory of the frame.
    Counting,
    /// The frame waits for other frames to finish.
    Waiting,
    /// Particles are sampled on the grid.
    Sampling,
    /// The field's blocks are meshed.
    Meshing,
    /// The mesh is simplified.
    Simplifying,
    /// The mesh is written.
    Writing,
}

impl Stage {
    /// The name of the stage, such as "meshing".
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Reading => "reading",
            Self::Counting => "counting",
            Self::Waiting => "waiting",
            Self::Sampling => "sampling",
            Self::Meshing => "meshing",
            Self::Simplifying => "simplifying",
            Self::Writing => "writing",
        }
    }
}

impl fmt::Display for Stage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Progress of a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Progress {
    /// The current stage.
    pub stage: Stage,
    /// The finished fraction of this stage, from 0 to 1.
    pub done: f64,
}

/// A callback for progress, which may be called from any thread.
pub type Watcher = Arc<dyn Fn(Progress) + Send + Sync>;

/// Lets a caller follow the work on a frame, and cancel it.
#[derive(Clone, Default)]
pub struct Control {
    /// The cancel handle.
    pub cancel: Cancel,
    /// The callback for progress.
    pub progress: Option<Watcher>,
}

impl Control {
    /// Runs a stage, and reports to the caller when it begins and when it succeeds. If the caller
    /// cancels during a stage, the stage fails with [`Cancelled`], even if `work` succeeded.
    pub(crate) fn during<T, E: From<Cancelled>>(
        &self,
        stage: Stage,
        work: impl FnOnce() -> Result<T, E>,
    ) -> Result<T, E> {
        self.cancel.go_on()?;
        self.report(stage, 0.0);
        let result = work();
        self.cancel.go_on()?;
        if result.is_ok() {
            self.report(stage, 1.0);
            self.cancel.go_on()?;
        }
        result
    }

    /// Reports the start of a stage.
    pub(crate) fn begin(&self, stage: Stage) {
        self.report(stage, 0.0);
    }

    /// Returns a meter for a stage that has `parts` parts.
    pub fn meter(&self, stage: Stage, parts: usize) -> Meter<'_> {
        let done = AtomicUsize::new(0);
        let last_report = Mutex::new((0, Instant::now()));
        Meter { control: self, stage, span: [0.0, 1.0], parts, done, last_report }
    }

    /// Reports the finished fraction of a stage.
    fn report(&self, stage: Stage, done: f64) {
        if let Some(progress) = &self.progress {
            progress(Progress { stage, done });
        }
    }
}

/// Number of steps in a stage. Each step is reported.
const STEPS: usize = 128;
/// If the last report is older than this, progress of less than a step is also reported.
const REPORT_INTERVAL: Duration = Duration::from_millis(50);

/// Counts the finished parts of a stage on all threads, reports progress to the caller, and checks
/// whether the work was cancelled.
#[derive(Debug)]
pub struct Meter<'a> {
    control: &'a Control,
    stage: Stage,
    /// The range of the stage that the parts cover, as fractions from 0 to 1.
    span: [f64; 2],
    parts: usize,
    done: AtomicUsize,
    /// The number of parts in the last report, and the time of that report. A thread that finds the
    /// lock taken skips its report.
    last_report: Mutex<(usize, Instant)>,
}

impl Meter<'_> {
    /// Sets the range of the stage that the parts cover, as fractions from 0 to 1.
    pub fn between(self, from: f64, to: f64) -> Self {
        Self { span: [from, to], ..self }
    }

    /// Multiplies the number of parts.
    pub fn times(self, times: usize) -> Self {
        Self { parts: self.parts.saturating_mul(times), ..self }
    }

    /// Returns an error if the caller cancelled the work.
    pub fn go_on(&self) -> Result<(), Cancelled> {
        self.control.cancel.go_on()
    }

    /// Returns true until the caller cancels the work.
    pub fn goes_on(&self) -> bool {
        !self.control.cancel.is_cancelled()
    }

    /// Adds `parts` finished parts.
    pub fn add(&self, parts: usize) {
        self.done.fetch_add(parts, Ordering::Relaxed);
        let Ok(mut last_report) = self.last_report.try_lock() else { return };
        let done = self.done.load(Ordering::Relaxed);
        let (before, since) = *last_report;
        let is_step = done >= before + self.parts.div_ceil(STEPS);
        let is_due = is_step || done > before && since.elapsed() >= REPORT_INTERVAL;
        // `Control::during` reports the end of the stage.
        if done < self.parts && is_due && self.goes_on() {
            *last_report = (done, Instant::now());
            let [from, to] = self.span;
            self.control.report(self.stage, from + (to - from) * done as f64 / self.parts as f64);
        }
    }
}

impl fmt::Debug for Control {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Control").field("cancel", &self.cancel).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slow_work_is_reported_even_below_the_reporting_step() {
        let reports = Arc::new(Mutex::new(Vec::new()));
        let sink = Arc::clone(&reports);
        let watcher: Watcher = Arc::new(move |progress| sink.lock().unwrap().push(progress.done));
        let control = Control { progress: Some(watcher), ..Control::default() };
        let meter = control.meter(Stage::Meshing, 1 << 20);
        std::thread::sleep(2 * REPORT_INTERVAL);
        meter.add(1);
        assert_eq!(*reports.lock().unwrap(), [1.0 / f64::from(1 << 20)]);
    }
}

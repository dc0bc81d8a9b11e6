//! The caller's hold on long work: how far it has come, and an early end.

use std::fmt;
use std::sync::Arc;

use super::cancel::Cancel;

/// A step on the way from particles to a mesh file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[non_exhaustive]
pub enum Stage {
    /// The input is read.
    Reading,
    /// Particles are counted in the cells, to know what memory the frame takes.
    Counting,
    /// A large frame waits until others are done.
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
    /// The stage in one word, such as "meshing".
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
    /// The stage that it is in.
    pub stage: Stage,
    /// The share of this stage that is done, from 0 to 1.
    pub done: f64,
}

/// Takes progress, from any thread.
pub type Watcher = Arc<dyn Fn(Progress) + Send + Sync>;

/// The caller's hold on a frame.
#[derive(Clone, Default)]
pub struct Control {
    /// The handle that ends it early.
    pub cancel: Cancel,
    /// Whoever is told how far it is.
    pub progress: Option<Watcher>,
}

impl Control {
    /// Tells that a stage has begun.
    pub(crate) fn begins(&self, stage: Stage) {
        self.tell(stage, 0.0);
    }

    /// Tells how much of a stage is done.
    pub(crate) fn tell(&self, stage: Stage, done: f64) {
        if let Some(progress) = &self.progress {
            progress(Progress { stage, done });
        }
    }
}

impl fmt::Debug for Control {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Control").field("cancel", &self.cancel).finish_non_exhaustive()
    }
}

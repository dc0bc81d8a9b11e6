//! Events of a running conversion, for its caller.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::time::Duration;
use std::{fmt, thread};

use bytesize::ByteSize;

use crate::brick::Census;
use crate::error::Error;
use crate::field::calibration::{Calibration, Plateau};
use crate::grid::units::{shown, significant};
use crate::io::series::SeriesFrame;
use crate::reconstruction::{Doubt, Report, Warning, lost_warning};
use crate::system::cancel::Cancel;
use crate::system::control::Progress;

use super::frozen::{Frozen, Trust};
use super::gaps::Gaps;

/// News of a conversion, which prints as a line for people.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub enum Event {
    /// No frame has come yet, and one is waited for.
    Waiting {
        /// The inputs, as they were asked for.
        inputs: String,
    },
    /// The spacing that a frame says, or looks like, may not be right.
    Doubted(Box<Doubt>),
    /// The state of an earlier run is made anew, because settings or its input changed.
    Anew {
        /// The state's file.
        state: PathBuf,
        /// Settings that changed, by their names, or the frame whose input did.
        differing: String,
    },
    /// The frames of an earlier run are gone on with.
    GoesOn {
        /// The state's file.
        state: PathBuf,
        /// The measurements that all frames share.
        frozen: Box<Frozen>,
    },
    /// The measurements that all frames share are made.
    Measured {
        /// The file of the frame that it was measured on.
        path: PathBuf,
        /// The measurements that all frames share.
        frozen: Box<Frozen>,
        /// How much this frame can tell of all others.
        trust: Trust,
    },
    /// The frames that are to be made are known.
    Begins {
        /// How many are asked for; more may come where a simulation is followed.
        frames: usize,
        /// How many of them are done already.
        done: usize,
        /// Bytes of the inputs of all others.
        bytes: u64,
        /// Frames that are made side by side.
        lanes: usize,
        /// Whether the simulation is followed.
        followed: bool,
    },
    /// A further frame has come.
    Came {
        /// Bytes of its input.
        bytes: u64,
    },
    /// A lane is at a stage of a frame.
    Stage {
        /// The lane's number, from 0.
        lane: usize,
        /// The frame's number.
        frame: i64,
        /// The stage and how much of it is done; `None` once the lane is done with the frame.
        progress: Option<Progress>,
    },
    /// A frame is done.
    Done(Box<FrameDone>),
    /// A frame could not be made.
    Failed(Arc<FrameFailed>),
    /// One of several simulations could not be converted; the others are.
    SimulationFailed(Arc<Error>),
    /// All frames of a simulation are done, or have failed.
    Ended(Box<Summary>),
}

/// A frame that is done: its mesh is whole, and under its name.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct FrameDone {
    /// The frame's number.
    pub frame: i64,
    /// The particles' file.
    pub input: PathBuf,
    /// The mesh's file.
    pub output: PathBuf,
    /// The mesh, as the simulation lists it.
    pub mesh: SeriesFrame,
    /// The frame's time in seconds, by its file or by the rate of frames.
    pub time: Option<f64>,
    /// A report on the surface; `None` where there are no particles.
    pub report: Option<Report>,
    /// Particles that are in no surface, at the least.
    pub lost: u64,
    /// Doubts about the frame.
    pub warnings: Vec<Warning>,
    /// How long it took in seconds.
    pub seconds: f64,
    /// Where the conversion is after it.
    pub progress: Tallied,
}

/// A frame that could not be made.
#[derive(Debug)]
#[non_exhaustive]
pub struct FrameFailed {
    /// The frame's number.
    pub frame: i64,
    /// The particles' file.
    pub input: PathBuf,
    /// The error.
    pub error: Error,
    /// Where the conversion is after it.
    pub progress: Tallied,
}

/// Counts of the frames of a conversion.
#[derive(Debug, Clone, Copy, Default)]
#[non_exhaustive]
pub struct Tallied {
    /// Frames that are done or have failed.
    pub done: usize,
    /// Frames that are to be made.
    pub total: usize,
    /// Frames that have failed.
    pub failed: usize,
    /// Bytes of this frame's input.
    pub bytes: u64,
}

/// Particles and drops that surfaces leave out.
#[derive(Debug, Default, Clone, Copy)]
#[non_exhaustive]
pub struct LeftOut {
    /// Counts of particles.
    pub census: Census,
    /// Particles in no surface, at the least.
    pub lost: u64,
    /// Drops that were too small.
    pub drops: u64,
    /// Particles that fail the conditions by which they are selected.
    pub unselected: u64,
}

impl LeftOut {
    pub(super) fn add(&mut self, other: &Self) {
        self.census.binned += other.census.binned;
        self.census.not_finite += other.census.not_finite;
        self.census.too_far += other.census.too_far;
        self.census.outside += other.census.outside;
        self.lost += other.lost;
        self.drops += other.drops;
        self.unselected += other.unselected;
    }
}

impl From<Census> for LeftOut {
    fn from(census: Census) -> Self {
        Self { census, ..Self::default() }
    }
}

/// Frames that are missing between others.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct Missing {
    /// The first number.
    pub first: i64,
    /// The last number.
    pub last: i64,
    /// From one number to the next.
    pub step: u64,
    /// The names that their files would have.
    pub paths: [PathBuf; 2],
}

impl fmt::Display for Missing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { first, last, paths: [from, to], .. } = self;
        if first == last {
            write!(f, "frame {first}: {}: missing", from.display())
        } else {
            write!(f, "frames {first} to {last}: {} to {}: missing", from.display(), to.display())
        }
    }
}

/// The end of a conversion.
#[derive(Debug, Clone, Default)]
#[non_exhaustive]
#[must_use = "frames may have failed"]
pub struct Summary {
    /// The inputs, as they were asked for.
    pub inputs: String,
    /// The folder of the meshes.
    pub folder: PathBuf,
    /// Frames that were made.
    pub made: usize,
    /// Frames that could not be made, in order, and why.
    pub failed: Vec<Arc<FrameFailed>>,
    /// The error for which no frame was made: of one of several simulations, whose others were
    /// converted.
    pub error: Option<Arc<Error>>,
    /// Frames that are missing between others.
    pub missing: Vec<Missing>,
    /// Numbers without a frame, where more are missing than there: a choice of frames, and not one
    /// with gaps.
    pub chosen: Option<Gaps>,
    /// Particles and drops that the surfaces leave out.
    pub left_out: LeftOut,
    /// Whether one of the paper's indicators makes the field, which loses drops that clouds keep.
    pub smoothed: bool,
    /// How long it took in seconds.
    pub seconds: f64,
}

impl Summary {
    /// Frames that are not there: failed, or missing between others.
    #[must_use]
    pub fn lacking(&self) -> u64 {
        let missing = self
            .missing
            .iter()
            .map(|missing| missing.last.abs_diff(missing.first) / missing.step.max(1) + 1);
        missing.fold(self.failed.len() as u64, u64::saturating_add)
    }

    /// Whether every frame is there.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.failed.is_empty() && self.missing.is_empty() && self.error.is_none()
    }

    /// A doubt about particles that are in no surface, if they are many.
    #[must_use]
    pub fn lost(&self) -> Option<Warning> {
        lost_warning(self.left_out.lost, self.left_out.census.binned, self.smoothed)
    }
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Waiting { inputs } => write!(f, "{inputs}: waiting for the first frame"),
            Self::Doubted(doubt) => write!(f, "warning: {doubt}"),
            Self::Anew { state, differing } => {
                write!(f, "{}: starting again, because these changed: {differing}", state.display())
            }
            Self::GoesOn { state, frozen } => {
                write!(f, "resuming with {}: {frozen}", state.display())
            }
            Self::Measured { path, frozen, trust: Trust::Sound } => {
                write!(f, "measured on {}: {frozen}", path.display())
            }
            Self::Measured { frozen, trust, .. } => {
                let what = match trust {
                    Trust::Shallow => "almost no fluid is deep enough to measure",
                    Trust::Lattice | Trust::Sound => "all particles stand on a lattice",
                };
                write!(f, "warning: {what}; measured on frame {}: {frozen}", frozen.frame)
            }
            Self::Begins { frames, done, .. } => {
                write!(f, "{done} of {frames} frames are already finished")
            }
            Self::Came { bytes } => write!(f, "new frame: {}", ByteSize(*bytes)),
            Self::Stage { frame, progress: Some(Progress { stage, .. }), .. } => {
                write!(f, "frame {frame}: {stage}")
            }
            Self::Stage { frame, progress: None, .. } => write!(f, "frame {frame}: meshed"),
            Self::Done(done) => done.fmt(f),
            Self::Failed(failed) => failed.error.fmt(f),
            Self::SimulationFailed(error) => error.fmt(f),
            Self::Ended(summary) => summary.fmt(f),
        }
    }
}

impl fmt::Display for FrameDone {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { output, mesh, seconds, progress, .. } = self;
        write!(
            f,
            "{}: {} vertices, {} triangles, {} in {seconds:.2} s ({} of {})",
            output.display(),
            mesh.vertices,
            mesh.triangles,
            ByteSize(mesh.bytes),
            progress.done,
            progress.total,
        )
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(error) = &self.error {
            return error.fmt(f);
        }
        let Self { folder, made, seconds, .. } = self;
        write!(f, "{}: {made} frames in {seconds:.2} s", folder.display())
    }
}

impl fmt::Display for Frozen {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { spacing, spacing_source, cell_size, origin, slab, walls, calibration, .. } =
            self;
        if let (Some(spacing), Some(source)) = (spacing, spacing_source) {
            write!(f, "spacing {} ({source}), ", shown(*spacing))?;
        }
        write!(f, "cell size {}", shown(*cell_size))?;
        if *origin != [0.0; 3] {
            write!(f, ", origin {}", origin.map(shown).join(","))?;
        }
        if let Some(slab) = slab {
            write!(f, "; {slab}")?;
        }
        if let Some(walls) = walls {
            write!(f, ", {walls}")?;
        }
        if let Some(mean) = calibration.and_then(|known| known.mean()) {
            write!(f, ", mu0 {}", significant(mean.particles(), 4))?;
        }
        match calibration {
            Some(Calibration::Indicator { iso, .. }) => {
                write!(f, ", isovalue {}", significant(iso.value(), 4))
            }
            Some(Calibration::Clouds { plateau }) => {
                let nominal = Plateau::nominal(spacing.map_or(1.0, |spacing| spacing / cell_size));
                write!(
                    f,
                    ", density {:.3} particles per cubed spacing",
                    f64::from(*plateau) / nominal
                )
            }
            None => Ok(()),
        }
    }
}

/// Events that may wait to be heard. Beyond that the work waits, so that they take no memory
/// without end.
const WAITING: usize = 1024;

/// Tells the caller of events, from any thread.
#[derive(Debug, Clone)]
pub(super) struct Teller(SyncSender<Event>);

impl Teller {
    pub(super) fn tell(&self, event: Event) {
        // A caller that panicked hears no more.
        let _ = self.0.send(event);
    }
}

/// Does `work` on a thread of its own, and calls `hear` with what that tells, on this one. If
/// `hear` panics, the work is cancelled.
pub(super) fn hearing<T: Send>(
    cancel: &Cancel,
    hear: impl FnMut(Event),
    work: impl FnOnce(&Teller) -> Result<T, Error> + Send,
) -> Result<T, Error> {
    let (sender, told) = sync_channel(WAITING);
    thread::scope(|scope| {
        let work = move || work(&Teller(sender));
        let worker = thread::Builder::new().name("meniscus".into()).spawn_scoped(scope, work);
        let worker = worker.map_err(|fault| Error::Threads(fault.to_string()))?;
        // Ends with the last teller.
        let stop = CancelInPanic(cancel);
        hear_all(&told, hear);
        drop(stop);
        worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    })
}

/// Hears all that is told. A thread of a rayon pool works meanwhile: what tells may need that pool.
fn hear_all(told: &Receiver<Event>, mut hear: impl FnMut(Event)) {
    if rayon::current_thread_index().is_none() {
        return told.iter().for_each(hear);
    }
    loop {
        match told.try_recv() {
            Ok(event) => hear(event),
            Err(TryRecvError::Disconnected) => return,
            Err(TryRecvError::Empty) => {
                if rayon::yield_now() != Some(rayon::Yield::Executed) {
                    thread::sleep(Duration::from_millis(1));
                }
            }
        }
    }
}

/// Cancels work that nobody waits for any more.
struct CancelInPanic<'a>(&'a Cancel);

impl Drop for CancelInPanic<'_> {
    fn drop(&mut self) {
        if thread::panicking() {
            self.0.cancel();
        }
    }
}

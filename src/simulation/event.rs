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
use crate::io::time_codes::UnusedTimes;
use crate::reconstruction::{NoVelocity, Report, SpacingWarning, Warning, lost_warning};
use crate::system::cancel::Cancel;
use crate::system::control::Progress;

use super::gaps::Gaps;
use super::shared_calibration::{SharedCalibration, Trust};

/// An event of a conversion. `Display` prints it as one line of text.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub enum Event {
    /// Waiting for the first frame, or for a frame on which all frames can be calibrated.
    Waiting {
        /// The inputs of the request.
        inputs: String,
        /// Number of frames examined so far. None of them is suitable for the calibration, usually
        /// because the fluid is too shallow.
        unsuitable: usize,
    },
    /// The numbers in the names of the frames are decimals, which count as times.
    TimesInNames {
        /// The file of the first frame.
        path: PathBuf,
        /// The time of the first frame in seconds.
        time: f64,
    },
    /// The spacing may be wrong.
    SpacingWarning(Box<SpacingWarning>),
    /// The calibration frame has attributes, but none of them is a velocity, so the meshes have no
    /// attributes.
    NoVelocity {
        /// The file of the calibration frame.
        path: PathBuf,
        /// The attributes.
        found: NoVelocity,
    },
    /// The conversion starts again, because settings or the calibration frame changed.
    Restarted {
        /// The state's file.
        state: PathBuf,
        /// The changed settings or input frame.
        differing: String,
    },
    /// An earlier conversion is resumed.
    Resumed {
        /// The state's file.
        state: PathBuf,
        /// The calibration that all frames share.
        shared: Box<SharedCalibration>,
    },
    /// The calibration that all frames share was measured.
    Measured {
        /// The file of the calibration frame.
        path: PathBuf,
        /// The calibration that all frames share.
        shared: Box<SharedCalibration>,
        /// How well the calibration frame represents the other frames.
        trust: Trust,
    },
    /// The conversion begins.
    Started {
        /// Number of frames. If the simulation is followed, more can appear.
        frames: usize,
        /// Number of frames that are already finished.
        done: usize,
        /// Total input size, in bytes, of the frames that are not finished yet; 0 if the simulation
        /// is followed.
        bytes: u64,
        /// Number of lanes. Each lane makes one frame at a time, in parallel with the other lanes.
        lanes: usize,
        /// Whether the simulation is followed.
        followed: bool,
    },
    /// A new frame appeared.
    FrameAppeared {
        /// Size, in bytes, of the frame's input.
        bytes: u64,
    },
    /// A lane entered a stage of a frame, or progressed in it.
    Stage {
        /// The lane's number, from 0.
        lane: usize,
        /// The frame's number.
        frame: i64,
        /// The stage and its progress; `None` when the lane has finished the frame.
        progress: Option<Progress>,
    },
    /// A frame is finished.
    Done(Box<FrameDone>),
    /// A frame failed.
    Failed(Arc<FrameFailed>),
    /// One of several simulations failed; the others continue.
    SimulationFailed(Arc<Error>),
    /// All frames of a simulation have finished or failed.
    Ended(Box<Summary>),
}

/// A finished frame, whose mesh is complete.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct FrameDone {
    /// The frame's number.
    pub frame: i64,
    /// The particle file.
    pub input: PathBuf,
    /// The mesh file.
    pub output: PathBuf,
    /// The mesh's entry in the list of frames.
    pub mesh: SeriesFrame,
    /// The frame's time, in seconds, from the frame's file or from the frame rate.
    pub time: Option<f64>,
    /// Names of the particle types in the particle file. The first is the type that was read. Empty
    /// for a packed frame, and if the file has a single type without a name.
    pub particle_types: Vec<String>,
    /// A report on the surface; `None` if the frame has no particles.
    pub report: Option<Report>,
    /// Lower bound on the number of particles outside the surface.
    pub lost: u64,
    /// Warnings about the frame.
    pub warnings: Vec<Warning>,
    /// Duration in seconds.
    pub seconds: f64,
    /// Progress of the conversion after this frame.
    pub progress: FrameCounts,
}

/// A failed frame.
#[derive(Debug)]
#[non_exhaustive]
pub struct FrameFailed {
    /// The frame's number.
    pub frame: i64,
    /// The particle file.
    pub input: PathBuf,
    /// The error.
    pub error: Error,
    /// Progress of the conversion after this frame.
    pub progress: FrameCounts,
}

/// The progress of a conversion, counted in frames.
#[derive(Debug, Clone, Copy, Default)]
#[non_exhaustive]
pub struct FrameCounts {
    /// Number of frames that have finished or failed.
    pub done: usize,
    /// Number of frames that this run converts, as far as this is known.
    pub total: usize,
    /// Number of frames that have failed.
    pub failed: usize,
    /// Input size, in bytes, of the frame that has just finished or failed.
    pub bytes: u64,
}

/// Particles and drops that are left out of surfaces.
#[derive(Debug, Default, Clone, Copy)]
#[non_exhaustive]
pub struct OmittedCounts {
    /// Counts of the particles that were used, skipped, outside the domain, or wrapped.
    pub census: Census,
    /// Lower bound on the number of particles that are missing from surfaces.
    pub lost: u64,
    /// Number of drops that are left out because they have too few particles.
    pub drops: u64,
    /// Number of particles that do not satisfy the conditions.
    pub unselected: u64,
}

impl OmittedCounts {
    pub(super) fn add(&mut self, other: &Self) {
        self.census.binned += other.census.binned;
        self.census.not_finite += other.census.not_finite;
        self.census.too_far += other.census.too_far;
        self.census.outside += other.census.outside;
        self.census.wrapped += other.census.wrapped;
        self.lost += other.lost;
        self.drops += other.drops;
        self.unselected += other.unselected;
    }
}

impl From<Census> for OmittedCounts {
    fn from(census: Census) -> Self {
        Self { census, ..Self::default() }
    }
}

/// A range of frames that are missing between existing frames.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct MissingFrames {
    /// Number of the first missing frame.
    pub first: i64,
    /// Number of the last missing frame.
    pub last: i64,
    /// Difference between consecutive frame numbers.
    pub step: u64,
    /// The paths that the files of the first and last missing frame would have.
    pub paths: [PathBuf; 2],
    /// The number of each missing frame, and the path that its file would have.
    pub frames: Vec<(i64, PathBuf)>,
}

/// A requested first or last frame that was not found: the existing frames begin at least one
/// step after it, or end at least one step before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum UnreachedEnd {
    /// The first existing frame comes after the requested first frame.
    First {
        /// The number of the requested frame.
        requested: i64,
        /// The number of the existing frame.
        existing: i64,
    },
    /// The last existing frame comes before the requested last frame.
    Last {
        /// The number of the requested frame.
        requested: i64,
        /// The number of the existing frame.
        existing: i64,
    },
}

impl fmt::Display for UnreachedEnd {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::First { requested, existing } => write!(
                f,
                "no files for frames before {existing}; the requested first frame is {requested}"
            ),
            Self::Last { requested, existing } => write!(
                f,
                "no files for frames after {existing}; the requested last frame is {requested}"
            ),
        }
    }
}

impl fmt::Display for MissingFrames {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { first, last, paths: [from, to], .. } = self;
        if first == last {
            write!(f, "frame {first}: {}: missing", from.display())
        } else {
            write!(f, "frames {first} to {last}: {} to {}: missing", from.display(), to.display())
        }
    }
}

/// A summary of the conversion of one simulation.
#[derive(Debug, Clone, Default)]
#[non_exhaustive]
#[must_use = "frames may have failed"]
pub struct Summary {
    /// The inputs of the request.
    pub inputs: String,
    /// The folder of the meshes.
    pub folder: PathBuf,
    /// Number of frames that were made.
    pub made: usize,
    /// Failed frames, in order.
    pub failed: Vec<Arc<FrameFailed>>,
    /// The error that stopped this simulation, if several simulations were converted.
    pub error: Option<Arc<Error>>,
    /// Frames that are missing between existing frames.
    pub missing: Vec<MissingFrames>,
    /// The missing frame numbers, if at least as many numbers are missing as exist. In that case,
    /// the existing files count as a selection of frames, and `missing` is empty.
    pub chosen: Option<Gaps>,
    /// The requested first and last frame, if no files were found for them.
    pub unreached: Vec<UnreachedEnd>,
    /// The reason why the lists of frames ignore the times of the frames. `None` if the lists use
    /// the times, or if the frames have no times.
    pub unused_times: Option<UnusedTimes>,
    /// Number of existing meshes that stay in the lists although their frames are not among the
    /// inputs.
    pub without_input: usize,
    /// Meshes of earlier runs that are still next to the new meshes, although the lists do not
    /// contain them, because their frames failed in this run or are not among the inputs.
    pub stale: Vec<PathBuf>,
    /// Particles and drops that are left out of the surfaces.
    pub left_out: OmittedCounts,
    /// Whether the indicator is counting or symmetry, which lose drops that the indicator cloud
    /// keeps.
    pub smoothed: bool,
    /// Duration in seconds.
    pub seconds: f64,
}

impl Summary {
    /// Number of frames that failed, or that are missing between existing frames.
    #[must_use]
    pub fn incomplete_frames(&self) -> u64 {
        let missing = self
            .missing
            .iter()
            .map(|missing| missing.last.abs_diff(missing.first) / missing.step.max(1) + 1);
        missing.fold(self.failed.len() as u64, u64::saturating_add)
    }

    /// Whether the conversion is complete: no frame failed or is missing, and no error stopped the
    /// conversion.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.failed.is_empty() && self.missing.is_empty() && self.error.is_none()
    }

    /// A warning about particles that are missing from surfaces, if there are many.
    #[must_use]
    pub fn lost(&self) -> Option<Warning> {
        lost_warning(self.left_out.lost, self.left_out.census.binned, self.smoothed)
    }
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Waiting { inputs, unsuitable: 0 } => {
                write!(f, "{inputs}: waiting for the first frame")
            }
            Self::Waiting { inputs, unsuitable } => write!(
                f,
                "{inputs}: waiting for a frame with deeper fluid, which the calibration of all \
                 frames needs; frames examined so far: {unsuitable}"
            ),
            Self::TimesInNames { path, time } => write!(
                f,
                "the numbers in the names of the frames are times in seconds: {} is at {time} s",
                path.display()
            ),
            Self::SpacingWarning(warning) => write!(f, "warning: {warning}"),
            Self::NoVelocity { path, found } => write!(f, "{}: {found}", path.display()),
            Self::Restarted { state, differing } => {
                write!(f, "{}: starting again; changed: {differing}", state.display())
            }
            Self::Resumed { state, shared } => {
                write!(f, "resuming with the calibration in {}: {shared}", state.display())
            }
            Self::Measured { path, shared, trust: Trust::Sound } => {
                write!(f, "calibrated on {}: {shared}", path.display())
            }
            Self::Measured { shared, trust, .. } => {
                let what = match trust {
                    Trust::Shallow => "the fluid is too shallow for a reliable calibration",
                    Trust::Lattice | Trust::Sound => {
                        "all particles are on a lattice, so the calibration is less reliable"
                    }
                };
                write!(f, "warning: {what}; calibrated on frame {}: {shared}", shared.frame)
            }
            Self::Started { frames, done, .. } => {
                write!(f, "{done} of {frames} frames are already finished")
            }
            Self::FrameAppeared { bytes } => write!(f, "new frame: {}", ByteSize(*bytes)),
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
        let frames = if *made == 1 { "frame" } else { "frames" };
        write!(f, "{}: {made} {frames} in {seconds:.2} s", folder.display())
    }
}

impl fmt::Display for SharedCalibration {
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

/// Maximum number of queued events. If the queue is full, the conversion waits, so that the memory
/// of the queue is bounded.
const QUEUE_LENGTH: usize = 1024;

/// Sends events to the caller, from any thread.
#[derive(Debug, Clone)]
pub(super) struct EventSender(SyncSender<Event>);

impl EventSender {
    pub(super) fn send(&self, event: Event) {
        // Sending fails only if the caller has panicked, so the error is ignored.
        let _ = self.0.send(event);
    }
}

/// Runs `work` on a new thread, and calls `on_event` with each of its events on the current thread.
/// If `on_event` panics, `work` is cancelled.
pub(super) fn with_events<T: Send>(
    cancel: &Cancel,
    on_event: impl FnMut(Event),
    work: impl FnOnce(&EventSender) -> Result<T, Error> + Send,
) -> Result<T, Error> {
    let (sender, receiver) = sync_channel(QUEUE_LENGTH);
    thread::scope(|scope| {
        let work = move || work(&EventSender(sender));
        let worker = thread::Builder::new().name("meniscus".into()).spawn_scoped(scope, work);
        let worker = worker.map_err(|fault| Error::Threads(fault.to_string()))?;
        // `receive_all` returns when the last sender is dropped.
        let stop = CancelInPanic(cancel);
        receive_all(&receiver, on_event);
        drop(stop);
        worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    })
}

/// Receives all events. If the current thread belongs to a rayon pool, it runs tasks of the pool
/// while it waits, because the senders may need the pool.
fn receive_all(receiver: &Receiver<Event>, mut on_event: impl FnMut(Event)) {
    if rayon::current_thread_index().is_none() {
        return receiver.iter().for_each(on_event);
    }
    loop {
        match receiver.try_recv() {
            Ok(event) => on_event(event),
            Err(TryRecvError::Disconnected) => return,
            Err(TryRecvError::Empty) => {
                if rayon::yield_now() != Some(rayon::Yield::Executed) {
                    thread::sleep(Duration::from_millis(1));
                }
            }
        }
    }
}

/// Cancels the work if the caller panics.
struct CancelInPanic<'a>(&'a Cancel);

impl Drop for CancelInPanic<'_> {
    fn drop(&mut self) {
        if thread::panicking() {
            self.0.cancel();
        }
    }
}

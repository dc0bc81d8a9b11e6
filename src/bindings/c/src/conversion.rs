//! Files of a simulation to mesh files, with the program's own state and records beside them.

use std::ffi::{CString, c_char, c_void};
use std::path::PathBuf;

use meniscus::{Cancel, Event, Summary};

use crate::options::{Asked, MeniscusOptions};
use crate::sized::{Growing, check, fill};
use crate::status::{Failure, MeniscusStatus, Outcome, c_text, call};
use crate::text::{path, pointers};

/// News of a conversion.
#[repr(i32)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MeniscusEventKind {
    /// Something that is newer than this header.
    Other = 0,
    /// No frame has come yet, and one is waited for.
    Waiting = 1,
    /// The spacing that a frame says, or looks like, may not be right.
    SpacingWarning = 2,
    /// The state of an earlier run is made anew, because settings or its input changed.
    Restarted = 3,
    /// The frames of an earlier run are gone on with.
    Resumed = 4,
    /// The measurements that all frames share are made.
    Measured = 5,
    /// The frames that are to be made are known.
    Started = 6,
    /// A further frame has come.
    FrameAppeared = 7,
    /// A frame is at a stage, or is over.
    Stage = 8,
    /// A frame is done: its mesh is whole, and under its name.
    Done = 9,
    /// A frame could not be made.
    Failed = 10,
    /// One of several simulations could not be converted; the others are.
    SimulationFailed = 11,
    /// All frames of a simulation are done, or have failed.
    Ended = 12,
}

/// An event of a conversion. The library fills it, and a later version may put more behind.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct MeniscusEvent {
    /// Bytes of this structure as the library knows it.
    pub size: usize,
    /// The event as a line for people; valid during the callback.
    pub text: *const c_char,
    /// The doubts about a frame that is done, a line each; NULL where there are none. Valid during
    /// the callback.
    pub warnings: *const c_char,
    /// The number of the frame, for stages, and for frames that are done or failed; negative before
    /// frame 0.
    pub frame: i64,
    /// Frames that are done or have failed so far, where that is known.
    pub done: u64,
    /// Frames that are to be made, where that is known.
    pub total: u64,
    /// Frames that have failed so far, where that is known.
    pub failed: u64,
    /// One of MeniscusEventKind.
    pub kind: i32,
    /// How much of its stage is done for a frame that is at one, from 0 to 1.
    pub share: f64,
}

/// A function that is told of events. It returns 0 for the conversion to go on, and anything else
/// to end it early: frames that are done stay.
///
/// It is called on the thread that called meniscus_convert. It must not throw, nor leave by
/// longjmp.
pub type MeniscusEventCallback =
    Option<unsafe extern "C" fn(user: *mut c_void, event: *const MeniscusEvent) -> i32>;

/// A callback, and what it is called with.
#[derive(Clone, Copy)]
pub struct EventListener {
    pub callback: unsafe extern "C" fn(*mut c_void, *const MeniscusEvent) -> i32,
    pub user: *mut c_void,
}

/// The end of a conversion. The caller sets `size`, and the library fills the rest.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct MeniscusSummary {
    /// sizeof(MeniscusSummary).
    pub size: usize,
    /// Frames that were made.
    pub made: u64,
    /// Frames that have failed.
    pub failed: u64,
    /// Frames that are missing between others.
    pub missing: u64,
    /// Particles in the frames that were made.
    pub particles: u64,
    /// Particles that are in no surface, at the least.
    pub lost: u64,
    /// How long it took in seconds.
    pub seconds: f64,
}

// SAFETY: numbers.
unsafe impl Growing for MeniscusSummary {
    const NAME: &str = "MeniscusSummary";
}

/// Tells a caller of an event.
fn tell(listener: Option<EventListener>, event: &Event, cancel: &Cancel) {
    let Some(EventListener { callback, user }) = listener else { return };
    let text = c_text(event.to_string());
    let (told, warnings) = described(event);
    let warnings: Option<CString> = (!warnings.is_empty()).then(|| c_text(warnings.join("\n")));
    let warnings = warnings.as_ref().map_or(std::ptr::null(), |warnings| warnings.as_ptr());
    let told = MeniscusEvent { text: text.as_ptr(), warnings, ..told };
    // SAFETY: a callback and what it was given with, while the call lasts that it was given to.
    if unsafe { callback(user, &raw const told) } != 0 {
        cancel.cancel();
    }
}

/// An event in numbers, and the warnings of its frame.
fn described(event: &Event) -> (MeniscusEvent, Vec<String>) {
    let mut told = MeniscusEvent {
        size: size_of::<MeniscusEvent>(),
        text: std::ptr::null(),
        warnings: std::ptr::null(),
        frame: 0,
        done: 0,
        total: 0,
        failed: 0,
        kind: 0,
        share: 0.0,
    };
    let mut warnings = Vec::new();
    let kind = match event {
        Event::Waiting { .. } => MeniscusEventKind::Waiting,
        Event::SpacingWarning(_) => MeniscusEventKind::SpacingWarning,
        Event::Restarted { .. } => MeniscusEventKind::Restarted,
        Event::Resumed { .. } => MeniscusEventKind::Resumed,
        Event::Measured { .. } => MeniscusEventKind::Measured,
        Event::Started { frames, done, .. } => {
            (told.done, told.total) = (*done as u64, *frames as u64);
            MeniscusEventKind::Started
        }
        Event::FrameAppeared { .. } => MeniscusEventKind::FrameAppeared,
        Event::Stage { frame, progress, .. } => {
            told.frame = *frame;
            told.share = progress.map_or(0.0, |progress| progress.done);
            MeniscusEventKind::Stage
        }
        Event::Done(done) => {
            warnings = done.warnings.iter().map(ToString::to_string).collect();
            told.frame = done.mesh.frame;
            told.count(&done.progress);
            MeniscusEventKind::Done
        }
        Event::Failed(failed) => {
            told.frame = failed.frame;
            told.count(&failed.progress);
            MeniscusEventKind::Failed
        }
        Event::SimulationFailed(_) => MeniscusEventKind::SimulationFailed,
        Event::Ended(_) => MeniscusEventKind::Ended,
        _ => MeniscusEventKind::Other,
    };
    told.kind = kind as i32;
    (told, warnings)
}

impl MeniscusEvent {
    fn count(&mut self, progress: &meniscus::FrameCounts) {
        (self.done, self.total) = (progress.done as u64, progress.total as u64);
        self.failed = progress.failed as u64;
    }
}

/// The paths of a conversion's inputs.
///
/// # Safety
/// As for [`pointers`].
unsafe fn paths(inputs: *const *const c_char, count: usize) -> Outcome<Vec<PathBuf>> {
    // SAFETY: as for this function.
    let names = unsafe { pointers(inputs, count, "inputs") }?;
    if names.is_empty() {
        return Err(Failure::request("input_count is 0"));
    }
    // SAFETY: as for this function.
    names.iter().map(|&name| unsafe { path(name, "inputs") }).collect()
}

/// Converts the frames of a simulation from files to files, as the program does: all alike, side by
/// side, whole or not at all.
///
/// `inputs`: one name with {} for the number, a folder, a glob or a file of several steps; or the
/// files of `input_count` frames; or, with the option "together", inputs whose frames of one number
/// are one. `output`: a name with {} or {:04} for the number, or a folder.
/// `options`: which frames, and how; NULL for all defaults. Their progress function is not called.
/// `summary`: NULL, or where to put what was done.
///
/// MENISCUS_STATUS_INCOMPLETE where frames failed or are missing between others, and the others are
/// done: the message says of the first.
///
/// Pointers are NULL or point to the described data.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_convert(
    inputs: *const *const c_char,
    input_count: usize,
    output: *const c_char,
    options: *const MeniscusOptions,
    summary: *mut MeniscusSummary,
) -> MeniscusStatus {
    call(|| {
        // SAFETY: as for this function.
        let (inputs, output) = unsafe { (paths(inputs, input_count)?, path(output, "output")?) };
        // SAFETY: as for this function.
        let asked = unsafe { Asked::for_frames(options) };
        if !summary.is_null() {
            // SAFETY: as for this function.
            unsafe { check(summary, "summary") }?;
        }
        let simulation = asked.simulation(inputs, output);
        simulation.check()?;
        let asked = asked.on_machine(|_| simulation.input_bytes())?;
        let (listener, cancel) = (asked.event, asked.control.cancel());
        let simulation = simulation.reconstruction(asked.request.clone());
        let summaries = simulation.run(|event| tell(listener, &event, cancel))?;
        let all = summed(&summaries);
        if !summary.is_null() {
            // SAFETY: as for this function.
            unsafe { fill(summary, all, "summary") }?;
        }
        incomplete(&summaries, all)
    })
}

fn summed(summaries: &[Summary]) -> MeniscusSummary {
    let sum = |of: &dyn Fn(&Summary) -> u64| summaries.iter().map(of).fold(0, u64::saturating_add);
    MeniscusSummary {
        size: size_of::<MeniscusSummary>(),
        made: sum(&|one| one.made as u64),
        failed: sum(&|one| one.failed.len() as u64),
        missing: sum(&|one| one.incomplete_frames() - one.failed.len() as u64),
        particles: sum(&|one| one.left_out.census.binned as u64),
        lost: sum(&|one| one.left_out.lost),
        seconds: summaries.iter().map(|one| one.seconds).sum(),
    }
}

/// Says what is not there, if anything is not.
fn incomplete(summaries: &[Summary], all: MeniscusSummary) -> Outcome {
    let failed =
        summaries.iter().flat_map(|one| &one.failed).map(|failed| failed.error.to_string());
    let ended = summaries.iter().filter_map(|one| one.error.as_ref()).map(ToString::to_string);
    let missing = summaries.iter().flat_map(|one| &one.missing).map(ToString::to_string);
    let Some(first) = failed.chain(ended).chain(missing).next() else { return Ok(()) };
    let message = match all.failed + all.missing {
        0 => first,
        _ => {
            format!("{} frames failed and {} are missing; first: {first}", all.failed, all.missing)
        }
    };
    Err(Failure { status: MeniscusStatus::Incomplete, message })
}

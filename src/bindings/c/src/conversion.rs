//! Converts the files of a simulation to mesh files. The state file and the records are the same as
//! those that the program writes.

use std::ffi::{CString, c_char, c_void};
use std::path::PathBuf;

use meniscus::{Cancel, Event, Summary};

use crate::options::{MeniscusOptions, RequestParts};
use crate::sized::{SizedStruct, check, fill};
use crate::status::{Failure, MeniscusStatus, Outcome, c_text, call};
use crate::text::{path, pointers};

/// Kinds of events of a conversion.
#[repr(i32)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MeniscusEventKind {
    /// Any other event, such as one that is newer than this header.
    Other = 0,
    /// Waiting for the first frame, or for a frame that is suitable for measuring the calibration
    /// of all frames.
    Waiting = 1,
    /// The spacing may be wrong.
    SpacingWarning = 2,
    /// The conversion starts from the beginning, because its settings or the input of its
    /// calibration frame changed.
    Restarted = 3,
    /// An earlier conversion is resumed.
    Resumed = 4,
    /// The calibration that all frames share was measured.
    Measured = 5,
    /// The conversion of frames starts; the number of frames is known.
    Started = 6,
    /// A new frame appeared.
    FrameAppeared = 7,
    /// A frame entered a stage, progressed in it, or left its last stage.
    Stage = 8,
    /// A frame is finished: its mesh file is complete and has its final name.
    Done = 9,
    /// A frame failed.
    Failed = 10,
    /// One of several simulations failed; the others continue.
    SimulationFailed = 11,
    /// All frames of a simulation have finished or failed.
    Ended = 12,
}

/// An event of a conversion. The library fills the structure, and later versions may append fields.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct MeniscusEvent {
    /// Size of this structure in bytes, in the version of the library.
    pub size: usize,
    /// A description of the event, as a line of text; valid during the callback.
    pub text: *const c_char,
    /// The warnings about a finished frame or a finished simulation, one per line; NULL if there
    /// are none. Valid during the callback.
    pub warnings: *const c_char,
    /// The number of the frame, for events about stages and about finished or failed frames. It may
    /// be negative.
    pub frame: i64,
    /// Number of frames that have finished or failed so far; 0 if unknown.
    pub done: u64,
    /// Number of all frames of the conversion; 0 if unknown.
    pub total: u64,
    /// Number of frames that have failed so far; 0 if unknown.
    pub failed: u64,
    /// One of MeniscusEventKind.
    pub kind: i32,
    /// The finished fraction of the frame's current stage, from 0 to 1.
    pub share: f64,
}

/// A function that receives events. It returns 0 to continue; any other value cancels the
/// conversion, but finished frames are kept.
///
/// meniscus_convert calls this function on the caller's thread. The function must not throw an
/// exception or leave by longjmp.
pub type MeniscusEventCallback =
    Option<unsafe extern "C" fn(user: *mut c_void, event: *const MeniscusEvent) -> i32>;

/// An event callback with its argument `user`.
#[derive(Clone, Copy)]
pub struct EventListener {
    pub callback: unsafe extern "C" fn(*mut c_void, *const MeniscusEvent) -> i32,
    pub user: *mut c_void,
}

/// The result of a conversion. The caller sets `size`, and the library sets the other fields.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct MeniscusSummary {
    /// sizeof(MeniscusSummary).
    pub size: usize,
    /// Number of frames that were converted.
    pub made: u64,
    /// Number of frames that failed.
    pub failed: u64,
    /// Number of frames that are missing between existing frames.
    pub missing: u64,
    /// Number of particles in the frames that were converted.
    pub particles: u64,
    /// Lower bound on the number of particles outside the surfaces of all frames.
    pub lost: u64,
    /// Duration, in seconds, of the conversion.
    pub seconds: f64,
}

// SAFETY: all fields are numbers.
unsafe impl SizedStruct for MeniscusSummary {
    const NAME: &str = "MeniscusSummary";
}

/// Passes an event to the callback.
fn notify(listener: Option<EventListener>, event: &Event, cancel: &Cancel) {
    let Some(EventListener { callback, user }) = listener else { return };
    let text = c_text(event.to_string());
    let (converted, warnings) = to_c_event(event);
    let warnings: Option<CString> = (!warnings.is_empty()).then(|| c_text(warnings.join("\n")));
    let warnings = warnings.as_ref().map_or(std::ptr::null(), |warnings| warnings.as_ptr());
    let converted = MeniscusEvent { text: text.as_ptr(), warnings, ..converted };
    // SAFETY: the caller has set `user` for this callback, and both are valid during the call.
    if unsafe { callback(user, &raw const converted) } != 0 {
        cancel.cancel();
    }
}

/// Converts an event to the C structure, and returns the warnings about its frame.
fn to_c_event(event: &Event) -> (MeniscusEvent, Vec<String>) {
    let mut converted = MeniscusEvent {
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
            (converted.done, converted.total) = (*done as u64, *frames as u64);
            MeniscusEventKind::Started
        }
        Event::FrameAppeared { .. } => MeniscusEventKind::FrameAppeared,
        Event::Stage { frame, progress, .. } => {
            converted.frame = *frame;
            converted.share = progress.map_or(0.0, |progress| progress.done);
            MeniscusEventKind::Stage
        }
        Event::Done(done) => {
            warnings = done.warnings.iter().map(ToString::to_string).collect();
            converted.frame = done.mesh.frame;
            converted.count(&done.progress);
            MeniscusEventKind::Done
        }
        Event::Failed(failed) => {
            converted.frame = failed.frame;
            converted.count(&failed.progress);
            MeniscusEventKind::Failed
        }
        Event::SimulationFailed(_) => MeniscusEventKind::SimulationFailed,
        Event::Ended(summary) => {
            warnings = summary.unused_times.iter().map(ToString::to_string).collect();
            MeniscusEventKind::Ended
        }
        _ => MeniscusEventKind::Other,
    };
    converted.kind = kind as i32;
    (converted, warnings)
}

impl MeniscusEvent {
    fn count(&mut self, progress: &meniscus::FrameCounts) {
        (self.done, self.total) = (progress.done as u64, progress.total as u64);
        self.failed = progress.failed as u64;
    }
}

/// Reads the caller's array of input paths.
///
/// # Safety
/// The requirements of [`pointers`].
unsafe fn paths(inputs: *const *const c_char, count: usize) -> Outcome<Vec<PathBuf>> {
    // SAFETY: the caller upholds this function's contract.
    let names = unsafe { pointers(inputs, count, "inputs") }?;
    if names.is_empty() {
        return Err(Failure::request("input_count is 0, but must be at least 1"));
    }
    // SAFETY: the caller upholds this function's contract.
    names.iter().map(|&name| unsafe { path(name, "inputs") }).collect()
}

/// Converts the files of a simulation to mesh files, as the program does: several frames in
/// parallel, all with the same calibration. Each file appears completely or not at all.
///
/// `inputs`: one name with {} in place of the frame number, a folder, a glob or a file with several
/// steps; or the files of `input_count` frames; or, with the option "together", inputs whose frames
/// with the same number are joined. `output`: a name with {} or {:04} in place of the frame number,
/// a folder, or one .abc file for all frames. `options`: the settings and the selected frames, or
/// NULL for all defaults. The progress function of the options is not called. `summary`: NULL, or
/// the structure to fill.
///
/// Returns MENISCUS_STATUS_INCOMPLETE if frames failed or are missing, or if one of several
/// simulations failed. The message then describes the first error. Finished frames are kept.
///
/// Pointers must be NULL or point to the described data.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_convert(
    inputs: *const *const c_char,
    input_count: usize,
    output: *const c_char,
    options: *const MeniscusOptions,
    summary: *mut MeniscusSummary,
) -> MeniscusStatus {
    call(|| {
        // SAFETY: the caller upholds this function's contract.
        let (inputs, output) = unsafe { (paths(inputs, input_count)?, path(output, "output")?) };
        // SAFETY: the caller upholds this function's contract.
        let parts = unsafe { RequestParts::for_frames(options) };
        if !summary.is_null() {
            // SAFETY: the caller upholds this function's contract.
            unsafe { check(summary, "summary") }?;
        }
        let simulation = parts.simulation(inputs, output);
        simulation.check()?;
        let parts = parts.on_machine(|_| simulation.input_bytes())?;
        let (listener, cancel) = (parts.event, parts.control.cancel());
        let simulation = simulation.reconstruction(parts.request.clone());
        let summaries = simulation.run(|event| notify(listener, &event, cancel))?;
        let all = summed(&summaries);
        if !summary.is_null() {
            // SAFETY: the caller upholds this function's contract.
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

/// Returns an error if frames or simulations failed, or if frames are missing. The message
/// describes the first of these faults.
fn incomplete(summaries: &[Summary], all: MeniscusSummary) -> Outcome {
    let failed =
        summaries.iter().flat_map(|one| &one.failed).map(|failed| failed.error.to_string());
    let ended = summaries.iter().filter_map(|one| one.error.as_ref()).map(ToString::to_string);
    let missing = summaries.iter().flat_map(|one| &one.missing).map(ToString::to_string);
    let Some(first) = failed.chain(ended).chain(missing).next() else { return Ok(()) };
    let message = match all.failed + all.missing {
        0 => first,
        _ => format!(
            "{} frames failed and {} are missing; first error: {first}",
            all.failed, all.missing
        ),
    };
    Err(Failure { status: MeniscusStatus::Incomplete, message })
}

//! The Python classes `Event` and `Summary`, which describe a conversion.

use std::collections::BTreeMap;
use std::path::PathBuf;

use meniscus::{Event as ConversionEvent, FrameCounts};
use pyo3::prelude::*;

/// An event of a conversion. ``str(event)`` is a line of text.
///
/// Attributes
/// ----------
/// kind : str
///     "waiting", "times_in_names", "spacing_warning", "no_velocity", "restarted", "resumed",
///     "measured", "started", "frame_appeared", "stage", "done", "failed", "simulation_failed",
///     "ended", or "other" for any other event.
/// message : str
///     A description of the event, as a line of text.
/// frame : int or None
///     The frame's number, which may be negative.
/// output : pathlib.Path or None
///     The mesh file of a finished frame.
/// stage : str or None
///     The frame's stage: "reading", "counting", "waiting", "sampling", "meshing", "simplifying" or
///     "writing".
/// share : float or None
///     The finished fraction of this stage, from 0 to 1.
/// done, total, failed : int or None
///     Number of frames that have finished or failed, number of all frames, and number of frames
///     that have failed; None if unknown.
#[pyclass(frozen, get_all, module = "meniscus")]
#[derive(Default)]
pub struct Event {
    kind: &'static str,
    message: String,
    frame: Option<i64>,
    output: Option<PathBuf>,
    stage: Option<&'static str>,
    share: Option<f64>,
    done: Option<usize>,
    total: Option<usize>,
    failed: Option<usize>,
}

impl Event {
    /// Converts an event of the library, and also returns its warnings.
    pub fn of(event: &ConversionEvent) -> (Self, Vec<String>) {
        let counted = |FrameCounts { done, total, failed, .. }: &FrameCounts| Self {
            done: Some(*done),
            total: Some(*total),
            failed: Some(*failed),
            ..Self::default()
        };
        let mut warnings = Vec::new();
        let converted = match event {
            ConversionEvent::Waiting { .. } => Self { kind: "waiting", ..Self::default() },
            ConversionEvent::TimesInNames { .. } => {
                Self { kind: "times_in_names", ..Self::default() }
            }
            ConversionEvent::SpacingWarning(warning) => {
                warnings.push(warning.to_string());
                Self { kind: "spacing_warning", ..Self::default() }
            }
            ConversionEvent::NoVelocity { .. } => Self { kind: "no_velocity", ..Self::default() },
            ConversionEvent::Restarted { .. } => Self { kind: "restarted", ..Self::default() },
            ConversionEvent::Resumed { .. } => Self { kind: "resumed", ..Self::default() },
            ConversionEvent::Measured { .. } => Self { kind: "measured", ..Self::default() },
            ConversionEvent::Started { frames, done, .. } => {
                Self { kind: "started", done: Some(*done), total: Some(*frames), ..Self::default() }
            }
            ConversionEvent::FrameAppeared { .. } => {
                Self { kind: "frame_appeared", ..Self::default() }
            }
            ConversionEvent::Stage { frame, progress, .. } => Self {
                kind: "stage",
                frame: Some(*frame),
                stage: progress.map(|progress| progress.stage.name()),
                share: progress.map(|progress| progress.done),
                ..Self::default()
            },
            ConversionEvent::Done(done) => {
                warnings.extend(
                    done.warnings
                        .iter()
                        .map(|warning| format!("{}: {warning}", done.input.display())),
                );
                let (frame, output) = (Some(done.mesh.frame), Some(done.output.clone()));
                Self { kind: "done", frame, output, ..counted(&done.progress) }
            }
            ConversionEvent::Failed(failed) => {
                Self { kind: "failed", frame: Some(failed.frame), ..counted(&failed.progress) }
            }
            ConversionEvent::SimulationFailed(_) => {
                Self { kind: "simulation_failed", ..Self::default() }
            }
            ConversionEvent::Ended(summary) => {
                warnings.extend(summary.unused_times.iter().map(ToString::to_string));
                Self { kind: "ended", ..Self::default() }
            }
            _ => Self { kind: "other", ..Self::default() },
        };
        (Self { message: event.to_string(), ..converted }, warnings)
    }
}

#[pymethods]
impl Event {
    fn __str__(&self) -> &str {
        &self.message
    }

    fn __repr__(&self) -> String {
        format!("<meniscus.Event {}: {}>", self.kind, self.message)
    }
}

/// The result of a conversion.
///
/// Attributes
/// ----------
/// folder : pathlib.Path
///     The folder that contains the meshes.
/// made, failed : int
///     Number of frames that were converted, and number of frames that failed.
/// failures : dict of int to str
///     The error of each failed frame.
/// error : str or None
///     The error that stopped this simulation, if several simulations were converted.
/// missing : list of str
///     Frames that are missing between existing frames, one line for each gap.
/// complete : bool
///     Whether all frames were converted: no frame failed or is missing, and no error stopped the
///     conversion.
/// lost : int
///     Lower bound on the number of particles outside the surfaces of all frames.
/// seconds : float
///     Duration, in seconds, of the conversion.
#[pyclass(frozen, get_all, module = "meniscus")]
pub struct Summary {
    folder: PathBuf,
    made: usize,
    failed: usize,
    failures: BTreeMap<i64, String>,
    error: Option<String>,
    missing: Vec<String>,
    complete: bool,
    lost: u64,
    seconds: f64,
}

impl From<meniscus::Summary> for Summary {
    fn from(ended: meniscus::Summary) -> Self {
        Self {
            complete: ended.is_complete(),
            missing: ended.missing.iter().map(ToString::to_string).collect(),
            folder: ended.folder,
            made: ended.made,
            failed: ended.failed.len(),
            failures: ended
                .failed
                .iter()
                .map(|failed| (failed.frame, failed.error.to_string()))
                .collect(),
            error: ended.error.map(|error| error.to_string()),
            lost: ended.left_out.lost,
            seconds: ended.seconds,
        }
    }
}

#[pymethods]
impl Summary {
    fn __repr__(&self) -> String {
        let Self { made, failed, missing, .. } = self;
        format!("<meniscus.Summary: {made} made, {failed} failed, {} gaps>", missing.len())
    }
}

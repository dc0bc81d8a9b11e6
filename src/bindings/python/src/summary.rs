//! News of a conversion, and its end, for Python.

use std::collections::BTreeMap;
use std::path::PathBuf;

use meniscus::{Event as News, FrameCounts, Summary as Ended};
use pyo3::prelude::*;

/// News of a conversion. ``str(event)`` is a line for people.
///
/// Attributes
/// ----------
/// kind : str
///     "waiting", "spacing_warning", "restarted", "resumed", "measured", "started", "frame_appeared",
///     "stage", "done", "failed", "simulation_failed" or "ended".
/// message : str
///     A line for people.
/// frame : int or None
///     The frame's number; negative before frame 0.
/// output : pathlib.Path or None
///     The mesh's file, of a frame that is done.
/// stage : str or None
///     "reading", "counting", "waiting", "sampling", "meshing", "simplifying" or "writing", of a frame that is at it.
/// share : float or None
///     How much of that stage is done, from 0 to 1.
/// done, total, failed : int or None
///     Frames that are done or have failed, that are to be made, and that have failed, where that is known.
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
    /// Takes what others are told, and what to warn of.
    pub fn of(news: &News) -> (Self, Vec<String>) {
        let counted = |FrameCounts { done, total, failed, .. }: &FrameCounts| Self {
            done: Some(*done),
            total: Some(*total),
            failed: Some(*failed),
            ..Self::default()
        };
        let mut warnings = Vec::new();
        let event = match news {
            News::Waiting { .. } => Self { kind: "waiting", ..Self::default() },
            News::SpacingWarning(warning) => {
                warnings.push(warning.to_string());
                Self { kind: "spacing_warning", ..Self::default() }
            }
            News::Restarted { .. } => Self { kind: "restarted", ..Self::default() },
            News::Resumed { .. } => Self { kind: "resumed", ..Self::default() },
            News::Measured { .. } => Self { kind: "measured", ..Self::default() },
            News::Started { frames, done, .. } => {
                Self { kind: "started", done: Some(*done), total: Some(*frames), ..Self::default() }
            }
            News::FrameAppeared { .. } => Self { kind: "frame_appeared", ..Self::default() },
            News::Stage { frame, progress, .. } => Self {
                kind: "stage",
                frame: Some(*frame),
                stage: progress.map(|progress| progress.stage.name()),
                share: progress.map(|progress| progress.done),
                ..Self::default()
            },
            News::Done(done) => {
                warnings.extend(
                    done.warnings
                        .iter()
                        .map(|warning| format!("{}: {warning}", done.input.display())),
                );
                let (frame, output) = (Some(done.mesh.frame), Some(done.output.clone()));
                Self { kind: "done", frame, output, ..counted(&done.progress) }
            }
            News::Failed(failed) => {
                Self { kind: "failed", frame: Some(failed.frame), ..counted(&failed.progress) }
            }
            News::SimulationFailed(_) => Self { kind: "simulation_failed", ..Self::default() },
            News::Ended(_) => Self { kind: "ended", ..Self::default() },
            _ => Self { kind: "other", ..Self::default() },
        };
        (Self { message: news.to_string(), ..event }, warnings)
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

/// The end of a conversion.
///
/// Attributes
/// ----------
/// folder : pathlib.Path
///     The folder of the meshes.
/// made, failed : int
///     Frames that were made, and that have failed.
/// failures : dict of int to str
///     Why each frame that has failed could not be made.
/// error : str or None
///     Why no frame was made, of one of several simulations.
/// missing : list of str
///     Frames that are missing between others, a line each.
/// complete : bool
///     Whether every frame is there.
/// lost : int
///     Particles that are in no surface, of all frames together, at the least.
/// seconds : float
///     How long it took.
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

impl From<Ended> for Summary {
    fn from(ended: Ended) -> Self {
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

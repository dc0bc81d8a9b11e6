//! Collects the outcomes of all frames, lists frames for other programs, and makes the summary.

use std::collections::{BTreeMap, BTreeSet};
use std::io::ErrorKind;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::frame_file::FrameFile;
use super::gaps::{gaps, missing_path};
use crate::error::{Cause, Error};
use crate::field::indicator::IndicatorKind;
use crate::io::alembic::frame_archive::FrameArchive;
use crate::io::series::{Series, SeriesFrame};
use crate::io::{WriteError, WriteFault};
use rayon::prelude::*;

use super::builder::Simulation;
use super::conversion::Conversion;
use super::event::{
    Event, FrameCounts, FrameDone, FrameFailed, MissingFrames, OmittedCounts, Summary, UnreachedEnd,
};
use super::one_frame::ConvertedFrame;
use super::setup::{ExistingMeshes, Setup};

/// Minimum time between two writes of the list of all frames.
const SERIES_PAUSE: Duration = Duration::from_millis(250);

/// The outcomes of the frames so far.
pub(super) struct Tally<'a> {
    conversion: &'a Conversion<'a>,
    series: &'a Series,
    /// All frames that have a finished mesh, whether made by this run or by another.
    listed: BTreeMap<i64, SeriesFrame>,
    /// Failed frames by their numbers.
    pub(super) failed: BTreeMap<i64, Arc<FrameFailed>>,
    fatal: Option<Error>,
    pub(super) done: usize,
    pub(super) total: usize,
    /// The numbers of the frames that this run still has to convert.
    pub(super) awaited: BTreeSet<i64>,
    left_out: OmittedCounts,
    start: Instant,
    /// The time of the last write of the series.
    series_written: Instant,
    /// Whether frames have finished since the last write of the series.
    is_behind: bool,
}

impl<'a> Tally<'a> {
    pub(super) fn new(conversion: &'a Conversion<'a>, series: &'a Series) -> Self {
        let start = Instant::now();
        Self {
            conversion,
            series,
            listed: BTreeMap::new(),
            failed: BTreeMap::new(),
            fatal: None,
            done: 0,
            total: 0,
            awaited: BTreeSet::new(),
            left_out: OmittedCounts::default(),
            start,
            series_written: start,
            is_behind: false,
        }
    }

    /// Adds frames that are already finished. A frame for which `verify_bytes` is true is added
    /// only if the bytes of its mesh match the record.
    pub(super) fn add_finished(
        &mut self,
        frames: &[FrameFile],
        verify_bytes: impl Fn(&FrameFile) -> bool + Sync,
    ) {
        let meshes = self.conversion.setup.existing_meshes(&self.conversion.store);
        let Self { conversion, listed, failed, .. } = self;
        let done = |frame: &FrameFile| {
            let number = frame.number;
            let is_open = !listed.contains_key(&number) && !failed.contains_key(&number);
            let record = conversion.current(&meshes, frame).filter(|_| is_open)?;
            let is_done =
                !verify_bytes(frame) || meshes.is_whole(record, &conversion.output(frame));
            is_done.then(|| (number, record.mesh.clone()))
        };
        let done: Vec<_> = frames.par_iter().filter_map(done).collect();
        listed.extend(done);
    }

    /// Adds finished meshes of frames that are not among the existing `frames`, because their
    /// inputs were removed or are left out of this request. Returns the number of added meshes.
    ///
    /// Adds nothing if the request overwrites meshes, because a mesh may belong to an earlier
    /// simulation. Also adds nothing if the file names do not contain the frame numbers, because
    /// the frame of a mesh may have another number by now.
    fn add_finished_without_input(
        &mut self,
        meshes: &ExistingMeshes,
        frames: &[FrameFile],
    ) -> usize {
        let Setup { simulation, sequence, ref outputs, .. } = *self.conversion.setup;
        let has_numbers = sequence.has_own_numbers();
        let Some(Some(settled)) = self.conversion.settled.get() else { return 0 };
        if simulation.overwrite || !has_numbers {
            return 0;
        }
        let known = frames.iter().map(|frame| frame.number).collect();
        let others = meshes.of_other_frames(&known, outputs.folder(), settled.fingerprint);
        let before = self.listed.len();
        self.listed.extend(others.map(|mesh| (mesh.frame, mesh.clone())));
        self.listed.len() - before
    }

    /// Whether a frame is finished.
    pub(super) fn is_listed(&self, frame: &FrameFile) -> bool {
        self.listed.contains_key(&frame.number)
    }

    /// Whether the mesh of a listed frame was written to this file.
    pub(super) fn is_listed_output(&self, output: &Path) -> bool {
        let name = output.file_name();
        self.listed.values().any(|mesh| name.is_some_and(|name| *name == *mesh.file))
    }

    /// Whether an error has occurred that would also occur in all other frames.
    pub(super) fn has_fatal_error(&self) -> bool {
        self.fatal.is_some()
    }

    /// Records the outcome of a frame. Returns whether the frame failed with an error that would
    /// also occur in all other frames.
    pub(super) fn add_outcome(
        &mut self,
        frame: &FrameFile,
        result: Result<ConvertedFrame, Error>,
    ) -> Result<bool, Error> {
        let setup = self.conversion.setup;
        let result = match result {
            Err(error) if is_fatal(&error) => {
                self.fatal.get_or_insert(error);
                return Ok(true);
            }
            result => result,
        };
        self.done += 1;
        self.awaited.remove(&frame.number);
        match result {
            Ok(converted) => {
                let ConvertedFrame { mesh, time, particle_types, report, left_out, .. } = converted;
                self.left_out.add(&left_out);
                self.failed.remove(&frame.number);
                let done = FrameDone {
                    frame: frame.number,
                    input: frame.path.clone(),
                    output: setup.shown_output(frame),
                    mesh,
                    time,
                    particle_types,
                    report,
                    lost: left_out.lost,
                    warnings: converted.warnings,
                    seconds: converted.seconds,
                    progress: self.counts_after(frame),
                };
                self.listed.insert(frame.number, done.mesh.clone());
                self.is_behind = true;
                setup.send(Event::Done(Box::new(done)));
                if self.series_written.elapsed() > SERIES_PAUSE {
                    self.write_series()?;
                }
            }
            Err(error) => {
                self.failed.remove(&frame.number);
                let mut progress = self.counts_after(frame);
                progress.failed += 1;
                let input = frame.path.clone();
                let failed = Arc::new(FrameFailed { frame: frame.number, input, error, progress });
                self.failed.insert(frame.number, Arc::clone(&failed));
                setup.send(Event::Failed(failed));
            }
        }
        Ok(false)
    }

    fn counts_after(&self, frame: &FrameFile) -> FrameCounts {
        FrameCounts {
            done: self.done,
            total: self.total,
            failed: self.failed.len(),
            bytes: frame.bytes(),
        }
    }

    fn write_series(&mut self) -> Result<(), Error> {
        let listed: Vec<_> = self.listed.values().cloned().collect();
        self.conversion.cancel().undisturbed(|| {
            self.archive()?;
            self.series().write(&listed)
        })?;
        self.series_written = Instant::now();
        self.is_behind = false;
        Ok(())
    }

    /// Lists the frames that were finished since the series was written.
    pub(super) fn catch_up(&mut self) -> Result<(), Error> {
        if self.is_behind { self.write_series() } else { Ok(()) }
    }

    /// The series, with the frame rate that is stored in the state.
    fn series(&self) -> Series {
        let settled = self.conversion.settled.get().and_then(Option::as_ref);
        let fps = settled.map_or(self.series.fps, |settled| settled.state.fps());
        Series { fps, ..self.series.clone() }
    }

    /// If the output is an archive, adds finished frames to it. Adds them in frame order, and stops
    /// at the first frame that this run still has to convert, so that the bytes of the archive do
    /// not depend on the number of threads.
    fn archive(&self) -> Result<(), WriteError> {
        let Self { conversion, listed, awaited, .. } = self;
        let Some(archive) = &conversion.setup.archive else { return Ok(()) };
        let Some(Some(settled)) = conversion.settled.get() else { return Ok(()) };
        let first = awaited.first().copied().unwrap_or(i64::MAX);
        let series = self.series();
        listed.range(..first).try_for_each(|(_, mesh)| {
            archive.add(mesh, settled.fingerprint, |all| series.times(all))
        })
    }

    /// The requested first frame if it is at least one step before the existing `frames`, and the
    /// requested last frame if it is at least one step after them.
    fn unreached(&self, frames: &[FrameFile]) -> Vec<UnreachedEnd> {
        let (Some(first), Some(last)) = (frames.first(), frames.last()) else { return Vec::new() };
        let Simulation { selection, frames: range, .. } = self.conversion.setup.simulation;
        let [start, end] = [selection.start.max(range.0), selection.end.min(range.1)];
        let step = gaps(frames).step.max(1);
        let is_far = |low: i64, high: i64| low < high && high.abs_diff(low) >= step;
        let mut unreached = Vec::new();
        if start > i64::MIN && is_far(start, first.number) {
            unreached.push(UnreachedEnd::First { requested: start, existing: first.number });
        }
        if end < i64::MAX && is_far(last.number, end) {
            unreached.push(UnreachedEnd::Last { requested: end, existing: last.number });
        }
        unreached
    }

    /// Lists all frames that have a finished mesh, merges the records of ended jobs, and makes the
    /// summary.
    pub(super) fn finish(mut self, frames: &[FrameFile]) -> Result<Summary, Error> {
        let Setup { simulation, sequence, outputs, archive, checked, .. } = self.conversion.setup;
        let folder = archive.as_ref().map_or(outputs.folder(), FrameArchive::parent);
        // Other jobs may have finished frames meanwhile. The job that ends last lists the frames of
        // all jobs.
        let lock = self.conversion.store.locked();
        let all = self.conversion.setup.all_frames()?;
        self.add_finished(&all, |_| false);
        let meshes = self.conversion.setup.existing_meshes(&self.conversion.store);
        let without_input = self.add_finished_without_input(&meshes, &all);
        let numbers: BTreeSet<i64> = self.listed.keys().copied().collect();
        let mut stale = meshes.stale(&numbers, outputs.folder(), |number| {
            simulation.includes(number) && simulation.selection.spans(number)
        });
        // A resumed run can still convert the frames that this run did not reach, so their meshes
        // are not stale.
        if self.done < self.total {
            stale.clear();
        }
        let listed: Vec<SeriesFrame> = self.listed.values().cloned().collect();
        let (log, cancel) = (&self.conversion.store.log, self.conversion.cancel());
        let (written, merged) =
            rayon::join(|| self.write_series(), || cancel.undisturbed(|| log.merge()));
        written?;
        merged?;
        drop(lock);
        if cancel.is_cancelled() && self.done < self.total {
            self.fatal.get_or_insert(Error::Cancelled);
        }
        let (first, last) = simulation.frames;
        let missing = gaps(frames).within(first, last).without(&numbers);
        let chosen =
            Some(&missing).filter(|missing| missing.sparse && missing.count() > 0).cloned();
        let each = |&(first, last): &(i64, i64)| {
            let path = |number| missing_path(frames, sequence.pattern(), number);
            let each = (first..=last).step_by(missing.step.max(1) as usize);
            let each = each.map(|number| (number, path(number)));
            let (paths, step) = ([first, last].map(path), missing.step);
            MissingFrames { first, last, step, paths, frames: each.collect() }
        };
        let (unreached, unused_times) =
            (self.unreached(frames), self.series().unused_times(&listed));
        let indicator = checked.sampling.method.indicator();
        let summary = Summary {
            inputs: sequence.describe(),
            folder: folder.to_owned(),
            made: self.done - self.failed.len().min(self.done),
            failed: self.failed.into_values().collect(),
            error: None,
            missing: if chosen.is_some() {
                Vec::new()
            } else {
                missing.ranges.iter().map(each).collect()
            },
            chosen,
            unreached,
            unused_times,
            without_input,
            stale,
            left_out: self.left_out,
            smoothed: indicator.is_some_and(|kind| kind != IndicatorKind::Cloud),
            seconds: self.start.elapsed().as_secs_f64(),
        };
        self.conversion.setup.send(Event::Ended(Box::new(summary.clone())));
        self.fatal.map_or(Ok(summary), Err)
    }
}

/// Whether an error in one frame would also occur in all other frames.
fn is_fatal(error: &Error) -> bool {
    match error {
        Error::Write(WriteError { fault: WriteFault::Io(fault), .. }) => {
            fault.kind() != ErrorKind::IsADirectory
        }
        error => matches!(error.cause(), Cause::Cancelled | Cause::Output | Cause::Device),
    }
}

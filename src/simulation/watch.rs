//! Finds the complete frames of a running simulation. A frame counts as complete when its file has
//! not changed for a second. If the file changes later, the frame is reported again.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use super::frame_file::{FrameFile, Selection};
use super::shared_calibration::Stamp;

/// Time without changes after which a file counts as complete.
const COMPLETE_AFTER: Duration = Duration::from_secs(1);
/// Time, in seconds, for which a watch waits after the last new or changed file if numbers are
/// missing before the last selected frame.
const GRACE_FOR_GAPS: f64 = 10.0;

/// Tracks the files of the frames of a running simulation.
pub(super) struct Watch {
    /// Time, in seconds, without new or changed files after which the simulation counts as over.
    idle: f64,
    selection: Selection,
    files: BTreeMap<i64, WatchedFile>,
    last_change: Instant,
}

struct WatchedFile {
    stamp: Stamp,
    since: Instant,
    /// The file's stamp when the frame was last reported.
    reported_stamp: Option<Stamp>,
    in_progress: bool,
}

/// A frame that appears to be complete.
pub(super) struct CompleteFrame {
    pub(super) frame: FrameFile,
    /// Whether the frame was reported before, and its file has changed since then.
    pub(super) has_changed: bool,
}

impl Watch {
    pub(super) fn new(idle: f64, selection: Selection) -> Self {
        Self { idle, selection, files: BTreeMap::new(), last_change: Instant::now() }
    }

    /// Returns the existing `frames` that have become complete since the last call. A returned
    /// frame counts as in progress until [`done`](Self::done) is called, and is not returned again
    /// before then.
    pub(super) fn ready(&mut self, frames: &[FrameFile]) -> Vec<CompleteFrame> {
        let now = Instant::now();
        let mut ready = Vec::new();
        for frame in frames {
            // Skip a deleted file. If the file reappears, a later call notices it.
            let Ok(stamp) = frame.stamp() else { continue };
            let file = self.files.entry(frame.number).or_insert_with(|| {
                self.last_change = now;
                WatchedFile { stamp, since: now, reported_stamp: None, in_progress: false }
            });
            if file.stamp != stamp {
                self.last_change = now;
                (file.stamp, file.since) = (stamp, now);
            } else if file.reported_stamp != Some(stamp)
                && !file.in_progress
                && now - file.since >= COMPLETE_AFTER
            {
                let has_changed = file.reported_stamp.replace(stamp).is_some();
                file.in_progress = true;
                ready.push(CompleteFrame { frame: frame.clone(), has_changed });
            }
        }
        ready
    }

    /// Marks a frame as done, successfully or not. The frame is reported again only if its file
    /// changes.
    pub(super) fn done(&mut self, number: i64) {
        if let Some(file) = self.files.get_mut(&number) {
            file.in_progress = false;
        }
    }

    /// Whether no further frame is expected.
    pub(super) fn is_over(&self) -> bool {
        let Selection { end, step, .. } = self.selection;
        let has_gaps = self.has_gaps();
        let last = self.files.last_key_value();
        let complete = last.is_some_and(|(number, _)| number.saturating_add_unsigned(step) > end)
            && self.files.values().all(|file| file.reported_stamp == Some(file.stamp));
        let idle = self.idle.max(COMPLETE_AFTER.as_secs_f64());
        // The last frame can arrive before others, for example if a program copies the files.
        let grace = if complete && has_gaps { GRACE_FOR_GAPS.min(idle) } else { idle };
        complete && !has_gaps || self.last_change.elapsed().as_secs_f64() > grace
    }

    /// Whether selected numbers are missing before the last known frame.
    fn has_gaps(&self) -> bool {
        let Selection { start, step, .. } = self.selection;
        let mut pairs = self.files.keys().zip(self.files.keys().skip(1));
        let first = self.files.first_key_value().map_or(i64::MAX, |(number, _)| *number);
        let is_late = start > i64::MIN && first.saturating_sub_unsigned(step) >= start;
        is_late || pairs.any(|(number, next)| number.saturating_add_unsigned(step) < *next)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A watch whose selection ends with frame 4, and which has reported these frames.
    fn watching(numbers: &[i64], since_change: Duration) -> Watch {
        let now = Instant::now();
        let stamp = Stamp { bytes: 0, modified: 0, files: 0 };
        let file =
            || WatchedFile { stamp, since: now, reported_stamp: Some(stamp), in_progress: false };
        let files = numbers.iter().map(|&number| (number, file())).collect();
        let selection = Selection { start: 1, end: 4, ..Selection::default() };
        let last_change = now.checked_sub(since_change).unwrap();
        Watch { idle: f64::INFINITY, selection, files, last_change }
    }

    #[test]
    fn a_watch_waits_for_numbers_that_are_missing_before_its_last_frame() {
        let [soon, late] = [1, 60].map(Duration::from_secs);
        assert!(watching(&[1, 2, 3, 4], soon).is_over());
        assert!(!watching(&[1, 4], soon).is_over());
        assert!(!watching(&[4], soon).is_over());
        assert!(watching(&[1, 4], late).is_over());
        assert!(!watching(&[1, 2, 3], late).is_over());
    }
}

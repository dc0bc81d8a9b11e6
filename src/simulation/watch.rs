//! Finds the complete frames of a running simulation. A frame counts as complete when its file has
//! not changed for a second. If the file changes later, the frame is reported again.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use super::frame_file::{FrameFile, Selection};
use super::shared_calibration::Stamp;

/// Time without changes after which a file counts as complete.
const SETTLED: Duration = Duration::from_secs(1);
/// Time, in seconds, for which a watch waits after the last new or changed file if numbers are
/// missing before the last selected frame.
const FOR_GAPS: f64 = 10.0;

/// The frames that have been seen so far.
pub(super) struct Watch {
    /// Time, in seconds, without new or changed files after which the simulation counts as over.
    idle: f64,
    selection: Selection,
    seen: BTreeMap<i64, WatchedFile>,
    last_news: Instant,
}

struct WatchedFile {
    stamp: Stamp,
    since: Instant,
    /// The file's stamp when the frame was last reported.
    given: Option<Stamp>,
    under_way: bool,
}

/// A frame that appears to be complete.
pub(super) struct CompleteFrame {
    pub(super) frame: FrameFile,
    /// Whether the frame was reported before, and its file has changed since then.
    pub(super) again: bool,
}

impl Watch {
    pub(super) fn new(idle: f64, selection: Selection) -> Self {
        Self { idle, selection, seen: BTreeMap::new(), last_news: Instant::now() }
    }

    /// Returns those of the existing `frames` that have become complete since the last call. A
    /// returned frame counts as in progress until [`done`](Self::done) is called, and is not
    /// returned again before that.
    pub(super) fn ready(&mut self, frames: &[FrameFile]) -> Vec<CompleteFrame> {
        let now = Instant::now();
        let mut ready = Vec::new();
        for frame in frames {
            // Skip a deleted file. If the file reappears, a later call notices it.
            let Ok(stamp) = frame.stamp() else { continue };
            let seen = self.seen.entry(frame.number).or_insert_with(|| {
                self.last_news = now;
                WatchedFile { stamp, since: now, given: None, under_way: false }
            });
            if seen.stamp != stamp {
                self.last_news = now;
                (seen.stamp, seen.since) = (stamp, now);
            } else if seen.given != Some(stamp) && !seen.under_way && now - seen.since >= SETTLED {
                let again = seen.given.replace(stamp).is_some();
                seen.under_way = true;
                ready.push(CompleteFrame { frame: frame.clone(), again });
            }
        }
        ready
    }

    /// Marks a frame as done, successfully or not. The frame is reported again only if its file
    /// changes.
    pub(super) fn done(&mut self, number: i64) {
        if let Some(seen) = self.seen.get_mut(&number) {
            seen.under_way = false;
        }
    }

    /// Whether no further frame is expected.
    pub(super) fn is_over(&self) -> bool {
        let Selection { end, step, .. } = self.selection;
        let has_gaps = self.has_gaps();
        let last = self.seen.last_key_value();
        let complete = last.is_some_and(|(number, _)| number.saturating_add_unsigned(step) > end)
            && self.seen.values().all(|seen| seen.given == Some(seen.stamp));
        let idle = self.idle.max(SETTLED.as_secs_f64());
        // The last frame can arrive before others, for example if a program copies the files.
        let grace = if complete && has_gaps { FOR_GAPS.min(idle) } else { idle };
        complete && !has_gaps || self.last_news.elapsed().as_secs_f64() > grace
    }

    /// Whether selected numbers are missing before the last frame that has been seen.
    fn has_gaps(&self) -> bool {
        let Selection { start, step, .. } = self.selection;
        let mut pairs = self.seen.keys().zip(self.seen.keys().skip(1));
        let first = self.seen.first_key_value().map_or(i64::MAX, |(number, _)| *number);
        let is_late = start > i64::MIN && first.saturating_sub_unsigned(step) >= start;
        is_late || pairs.any(|(number, next)| number.saturating_add_unsigned(step) < *next)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A watch that ends with frame 4, and has seen these frames.
    fn watching(numbers: &[i64], since_news: Duration) -> Watch {
        let now = Instant::now();
        let stamp = Stamp { bytes: 0, modified: 0, files: 0 };
        let file = || WatchedFile { stamp, since: now, given: Some(stamp), under_way: false };
        let seen = numbers.iter().map(|&number| (number, file())).collect();
        let selection = Selection { start: 1, end: 4, ..Selection::default() };
        let last_news = now.checked_sub(since_news).unwrap();
        Watch { idle: f64::INFINITY, selection, seen, last_news }
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

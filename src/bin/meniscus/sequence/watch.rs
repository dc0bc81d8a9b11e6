//! Which frames of a running simulation are complete: those whose file has not changed for a while. One that turns out
//! not to be is tried again when it has changed.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use meniscus::sequence::frozen::Stamp;
use meniscus::sequence::inputs::{FrameFile, Selection};

/// A file that has not changed for so long is taken to be complete.
const SETTLED: Duration = Duration::from_secs(1);

/// What was seen of the frames so far.
pub struct Watch {
    /// Seconds without news after which the simulation is over.
    idle: f64,
    selection: Selection,
    seen: BTreeMap<u64, Seen>,
    last_news: Instant,
}

struct Seen {
    stamp: Stamp,
    since: Instant,
    given: bool,
}

impl Watch {
    pub fn new(idle: f64, selection: Selection) -> Self {
        Self { idle, selection, seen: BTreeMap::new(), last_news: Instant::now() }
    }

    /// The frames that have become complete since the last call, of those that are there now.
    pub fn ready(&mut self, frames: &[FrameFile]) -> Vec<FrameFile> {
        let now = Instant::now();
        let mut ready = Vec::new();
        for frame in frames {
            // A file that is gone again will be seen when it comes back.
            let Ok(stamp) = Stamp::of(&frame.path) else { continue };
            let seen = self.seen.entry(frame.number).or_insert_with(|| {
                self.last_news = now;
                Seen { stamp, since: now, given: false }
            });
            if seen.stamp != stamp {
                self.last_news = now;
                (seen.stamp, seen.since) = (stamp, now);
            } else if !seen.given && now - seen.since >= SETTLED {
                seen.given = true;
                ready.push(frame.clone());
            }
        }
        ready
    }

    /// A frame that was given could not be read: perhaps it was not complete, and will change.
    pub fn failed(&mut self, number: u64) {
        if let Some(seen) = self.seen.get_mut(&number) {
            seen.given = false;
            // Until it changes there is no sense in another try.
            seen.since = Instant::now() + Duration::from_secs(u64::from(u32::MAX));
        }
    }

    /// Whether nothing more is to be expected.
    pub fn is_over(&self) -> bool {
        let Selection { end, step, .. } = self.selection;
        let last = self.seen.iter().next_back();
        let complete = last.is_some_and(|(&number, seen)| seen.given && number.saturating_add(step) > end);
        complete || self.last_news.elapsed().as_secs_f64() > self.idle.max(SETTLED.as_secs_f64())
    }
}

//! Numbers of frames that are missing between others.

use std::path::PathBuf;

use super::inputs::{FrameFile, neighbours};
use super::pattern::Pattern;

/// The numbers that are missing between others, by the greatest step that leads to all that are
/// there.
pub fn gaps(frames: &[FrameFile]) -> Gaps {
    let steps = neighbours(frames).map(|(a, b)| b.number - a.number);
    let step = steps.fold(0, greatest_common_divisor);
    let mut ranges = Vec::new();
    for (a, b) in neighbours(frames) {
        if b.number - a.number > step {
            ranges.push((a.number + step, a.number + (b.number - a.number - 1) / step * step));
        }
    }
    let gaps = Gaps { step, ranges, sparse: false };
    Gaps { sparse: gaps.count() >= frames.len() as u64, ..gaps }
}

fn greatest_common_divisor(a: u64, b: u64) -> u64 {
    if b == 0 { a } else { greatest_common_divisor(b, a % b) }
}

/// The name that the file of a missing number would have, going by the one before it. `pattern` is
/// that of the names; where there is none, names end with their numbers.
pub fn missing_path(frames: &[FrameFile], pattern: Option<&Pattern>, number: u64) -> PathBuf {
    let before = frames.partition_point(|frame| frame.number < number).saturating_sub(1);
    let Some(FrameFile { digits, path, .. }) = frames.get(before) else { return PathBuf::new() };
    let width = if digits.starts_with('0') { digits.len() } else { 1 };
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let at = pattern.map_or(name.len() - digits.len(), |pattern| pattern.prefix.len());
    path.with_file_name(format!("{}{number:0width$}{}", &name[..at], &name[at + digits.len()..]))
}

/// Missing numbers, found by [`gaps`].
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Gaps {
    /// From one number to the next.
    pub step: u64,
    /// The first and the last missing number of each gap: there may be any number of frames between
    /// two time stamps.
    pub ranges: Vec<(u64, u64)>,
    /// More is missing than there: a choice of frames, and not a simulation with gaps.
    pub sparse: bool,
}

impl Gaps {
    /// Missing numbers in all.
    pub fn count(&self) -> u64 {
        self.ranges.iter().map(|(first, last)| (last - first) / self.step.max(1) + 1).sum()
    }

    /// Keeps the gaps from `first` to `last`.
    pub fn within(&self, first: u64, last: u64) -> Self {
        let step = self.step.max(1);
        let clipped = |&(lo, hi): &(u64, u64)| {
            let (below, above) =
                (first.saturating_sub(lo).div_ceil(step), hi.saturating_sub(last).div_ceil(step));
            (below.saturating_add(above) <= (hi - lo) / step)
                .then(|| (lo + below * step, hi - above * step))
        };
        Self { ranges: self.ranges.iter().filter_map(clipped).collect(), ..self.clone() }
    }
}

/// Gaps that are told one by one.
const TOLD: usize = 20;

impl std::fmt::Display for Gaps {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let range = |&(first, last): &(u64, u64)| {
            if first == last { first.to_string() } else { format!("{first} to {last}") }
        };
        f.write_str(&self.ranges.iter().take(TOLD).map(range).collect::<Vec<_>>().join(", "))?;
        match self.ranges.len().saturating_sub(TOLD) {
            0 => Ok(()),
            more => write!(f, ", and {more} more gaps"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frames(numbers: &[u64]) -> Vec<FrameFile> {
        let frame =
            |&number: &u64| FrameFile { number, digits: number.to_string(), path: PathBuf::new() };
        numbers.iter().map(frame).collect()
    }

    #[test]
    fn gaps_are_told_by_the_step_that_leads_to_all() {
        let found = gaps(&frames(&[0, 10, 20, 40, 50, 90]));
        assert_eq!((found.step, &*found.ranges, found.count()), (10, &[(30, 30), (60, 80)][..], 4));
        assert!(!found.sparse);
        for (first, last, within) in [
            (0, u64::MAX, &[(30, 30), (60, 80)][..]),
            (31, 75, &[(60, 70)]),
            (65, 80, &[(70, 80)]),
            (71, 79, &[]),
            (90, 100, &[]),
        ] {
            assert_eq!(found.within(first, last).ranges, within, "{first} to {last}");
        }
        assert_eq!(gaps(&frames(&[3, 4, 5])).ranges, []);
        assert!(gaps(&frames(&[1, 10, 20])).sparse);
        assert!(gaps(&frames(&[0, 12, 13, 14])).sparse, "four frames of fifteen are a choice");
    }

    #[test]
    fn gaps_between_time_stamps_are_told_by_their_ends() {
        let stamps = [0, 1_700_000_000_000_000_000, 1_700_000_000_016_666_667, u64::MAX];
        let found = gaps(&frames(&stamps));
        assert_eq!((found.count(), found.sparse), (u64::MAX - 3, true));
        assert_eq!(found.within(5, 8).ranges, [(5, 8)]);
        assert_eq!(found.within(u64::MAX, u64::MAX).count(), 0);
        let many: Vec<u64> = (0..100).map(|i| 3 * i + i % 2).collect();
        let told = gaps(&frames(&many)).to_string();
        assert!(told.starts_with("2, 8, 14, ") && told.ends_with(", and 30 more gaps"), "{told}");
    }
}

//! Numbers of the frames that are missing between existing frames.

use std::collections::BTreeSet;
use std::path::PathBuf;

use crate::io::time_codes::{MIN_REGULAR_FRAMES, greatest_common_divisor};

use super::frame_file::{FrameFile, neighbours};
use super::pattern::Pattern;

/// Finds the numbers that are missing between the frames. The step is the largest number that
/// divides all differences between consecutive frame numbers. If there are more than
/// `MIN_REGULAR_FRAMES` frames, the last frame does not affect the step.
pub fn gaps(frames: &[FrameFile]) -> Gaps {
    let step_of = |frames: &[FrameFile]| {
        let steps = neighbours(frames).map(|(a, b)| b.number.abs_diff(a.number));
        steps.fold(0, greatest_common_divisor)
    };
    let before_last = &frames[..frames.len().saturating_sub(1)];
    let step = step_of(if before_last.len() < MIN_REGULAR_FRAMES { frames } else { before_last });
    let mut ranges = Vec::new();
    for (a, b) in neighbours(frames) {
        let difference = b.number.abs_diff(a.number);
        if difference > step {
            // The step divides every difference, except possibly the last one.
            let last = (difference - 1) / step * step;
            ranges
                .push((a.number.wrapping_add_unsigned(step), a.number.wrapping_add_unsigned(last)));
        }
    }
    let gaps = Gaps { step, ranges, sparse: false };
    Gaps { sparse: gaps.count() >= frames.len() as u64, ..gaps }
}

/// Returns the path that the file of a missing frame would have, modelled on the file of the frame
/// before it. `pattern` is the pattern of the file names. Without a pattern, the names must end
/// with the frame numbers.
pub fn missing_path(frames: &[FrameFile], pattern: Option<&Pattern>, number: i64) -> PathBuf {
    let before = frames.partition_point(|frame| frame.number < number).saturating_sub(1);
    let Some(FrameFile { digits, path, .. }) = frames.get(before) else { return PathBuf::new() };
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let end = name.len() - digits.len().min(name.len());
    let at = match pattern {
        Some(pattern) => {
            let unpacked = || pattern.number_range(name.strip_suffix(".gz")?);
            pattern.number_range(&name).or_else(unpacked).unwrap_or(end..name.len())
        }
        None => end..name.len(),
    };
    path.with_file_name(format!(
        "{}{}{}",
        &name[..at.start],
        spelled_like(digits, number),
        &name[at.end..]
    ))
}

/// Formats a number like `digits`: padded with zeros to the same width if `digits` begins with 0.
fn spelled_like(digits: &str, number: i64) -> String {
    let plain = digits.trim_start_matches('-');
    let width = if plain.starts_with('0') { plain.len() } else { 1 };
    let sign = if number < 0 { "-" } else { "" };
    format!("{sign}{:0width$}", number.unsigned_abs())
}

/// Missing numbers, found by [`gaps`].
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Gaps {
    /// Difference between consecutive frame numbers.
    pub step: u64,
    /// The first and last missing number of each gap. Not all missing numbers are stored, because
    /// gaps can be huge if the numbers are time stamps.
    pub ranges: Vec<(i64, i64)>,
    /// Whether at least as many numbers are missing as exist. If so, the existing files count as a
    /// deliberate selection of frames, not as a simulation with gaps.
    pub sparse: bool,
}

impl Gaps {
    /// Number of missing frames in all gaps.
    pub fn count(&self) -> u64 {
        self.ranges.iter().map(|(first, last)| last.abs_diff(*first) / self.step.max(1) + 1).sum()
    }

    /// Keeps only the missing numbers from `first` to `last`.
    pub fn within(&self, first: i64, last: i64) -> Self {
        let step = self.step.max(1);
        let beyond = |low: i64, high: i64| if low < high { high.abs_diff(low) } else { 0 };
        let clipped = |&(lo, hi): &(i64, i64)| {
            let (below, above) =
                (beyond(lo, first).div_ceil(step), beyond(last, hi).div_ceil(step));
            (below.saturating_add(above) <= hi.abs_diff(lo) / step).then(|| {
                (lo.wrapping_add_unsigned(below * step), hi.wrapping_sub_unsigned(above * step))
            })
        };
        Self { ranges: self.ranges.iter().filter_map(clipped).collect(), ..self.clone() }
    }

    /// Removes each gap if the numbers of all its frames are in `finished`.
    pub fn without(mut self, finished: &BTreeSet<i64>) -> Self {
        let step = self.step.max(1);
        self.ranges.retain(|&(first, last)| {
            let count = last.abs_diff(first) / step + 1;
            let number = |i| first.wrapping_add_unsigned(i * step);
            count > finished.len() as u64 || !(0..count).all(|i| finished.contains(&number(i)))
        });
        self
    }
}

/// Maximum number of gaps in a message.
const MOST_LISTED: usize = 20;

impl std::fmt::Display for Gaps {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let range = |&(first, last): &(i64, i64)| {
            if first == last { first.to_string() } else { format!("{first} to {last}") }
        };
        f.write_str(
            &self.ranges.iter().take(MOST_LISTED).map(range).collect::<Vec<_>>().join(", "),
        )?;
        match self.ranges.len().saturating_sub(MOST_LISTED) {
            0 => Ok(()),
            more => write!(f, ", and {more} more gaps"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frames(numbers: &[i64]) -> Vec<FrameFile> {
        let frame = |&number: &i64| FrameFile::new(number, number.to_string(), PathBuf::new());
        numbers.iter().map(frame).collect()
    }

    #[test]
    fn gaps_use_the_greatest_common_divisor_of_the_differences() {
        let found = gaps(&frames(&[0, 10, 20, 40, 50, 90]));
        assert_eq!((found.step, &*found.ranges, found.count()), (10, &[(30, 30), (60, 80)][..], 4));
        assert!(!found.sparse);
        for (first, last, within) in [
            (i64::MIN, i64::MAX, &[(30, 30), (60, 80)][..]),
            (31, 75, &[(60, 70)]),
            (65, 80, &[(70, 80)]),
            (71, 79, &[]),
            (90, 100, &[]),
        ] {
            assert_eq!(found.within(first, last).ranges, within, "{first} to {last}");
        }
        assert_eq!(gaps(&frames(&[3, 4, 5])).ranges, []);
        assert_eq!(gaps(&frames(&[0, 2, 4, 5])).ranges, [(1, 1), (3, 3)]);
        assert!(gaps(&frames(&[1, 10, 20])).sparse);
        assert!(gaps(&frames(&[0, 12, 13, 14])).sparse, "4 of 15 frames count as a selection");
    }

    #[test]
    fn the_last_frame_does_not_affect_the_step() {
        assert_eq!(gaps(&frames(&[0, 100, 200, 300, 350])).ranges, []);
        let found = gaps(&frames(&[0, 100, 200, 400, 500, 725]));
        assert_eq!((found.step, &*found.ranges), (100, &[(300, 300), (600, 700)][..]));
        assert_eq!(gaps(&frames(&[0, 100, 200, 250, 300])).step, 50);
    }

    #[test]
    fn gaps_between_huge_frame_numbers_are_ranges() {
        let stamps = [i64::MIN, 0, 1_700_000_000_000_000_000, 1_700_000_000_016_666_667, i64::MAX];
        let found = gaps(&frames(&stamps));
        assert_eq!((found.count(), found.sparse), (u64::MAX - 4, true));
        assert_eq!(found.within(5, 8).ranges, [(5, 8)]);
        assert_eq!(found.within(i64::MAX, i64::MAX).count(), 0);
        let many: Vec<i64> = (0..100).map(|i| 3 * i + i % 2).collect();
        let text = gaps(&frames(&many)).to_string();
        assert!(text.starts_with("2, 8, 14, ") && text.ends_with(", and 30 more gaps"), "{text}");
    }
}

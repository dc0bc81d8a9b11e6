//! Time codes of a simulation's frames, and the frame rate that their times imply.
//!
//! A time code is a time in units of one frame of the scene that plays the meshes. Programs show
//! only whole time codes, and show each mesh from its own time code on. If the time code of a mesh
//! is 4.00001 instead of 4, for example because its time was printed with six digits, programs show
//! the mesh only at 5. Therefore, time codes that are close to a whole number are rounded.

use std::fmt;
use std::ops::RangeInclusive;

use super::series::SeriesFrame;

/// Frames per second in USD and Alembic if the frame rate is neither given nor implied by the
/// times. This is USD's default.
pub(crate) const FRAMES_PER_SECOND: f64 = 24.0;

/// Largest difference, in frames, between the time of a frame and an evenly spaced time.
///
/// It covers times that are printed with six digits, up to 1000 s at 100 frames per second. It also
/// covers simulators that write the first time step after the requested time, if they make at least
/// 20 steps per frame. Rounding by this difference moves a mesh by at most a twentieth of its
/// motion per frame. Without rounding, programs would show a late mesh a whole frame later.
const TOLERANCE: f64 = 0.05;

/// Largest difference between a time code and a whole number, if all frames of a simulation are
/// this close to different whole numbers.
///
/// In this case, the simulation has at most one frame per time code, and its times are presumably
/// inaccurate. The difference covers times that are printed with two decimals, up to 40 frames per
/// second, and simulators that make at least 5 steps per frame.
const TOLERANCE_OF_ALL: f64 = 0.2;

/// Frame rates that times can imply, in frames per second.
const IMPLIED: RangeInclusive<f64> = 1.0..=1000.0;

/// Whole frame rates that film and television divide by 1.001, which gives 23.976 or 29.97 frames
/// per second, for example.
const DIVIDED: [f64; 5] = [24.0, 30.0, 48.0, 60.0, 120.0];

/// If at least this many frames precede the last frame of a simulation, the last frame need not be
/// a whole number of steps after them. Many programs also write the state at the end of the
/// simulation, even if its time is not a multiple of the step.
pub(crate) const MIN_REGULAR_FRAMES: usize = 4;

/// The time of a frame in the lists and the Alembic archive of a simulation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct FrameTime {
    /// Time in seconds, or the frame number if the time and the frame rate are unknown.
    pub time: f64,
    /// Time code of the frame.
    pub code: f64,
    /// Time in seconds in an Alembic archive. If the frame rate is known, this is the time code
    /// divided by the frame rate. Otherwise, it is the exact time of the frame, or, if the times are
    /// not used, the frame number divided by [`FRAMES_PER_SECOND`].
    pub seconds: f64,
}

/// The reason why the lists and archives of a simulation do not use the times of its frames.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct UnusedTimes {
    /// The number of the first frame whose time is missing or invalid.
    pub frame: i64,
    /// The fault of the frame's time.
    pub fault: TimeFault,
    /// The frame rate, in frames per second, if it is given.
    pub fps: Option<f64>,
}

/// A fault of a frame's time.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum TimeFault {
    /// The input has no time.
    Missing,
    /// The time is NaN or infinite.
    NotFinite,
    /// The time is not later than that of the frame before it.
    NotLater {
        /// The time in seconds.
        time: f64,
        /// The number and the time, in seconds, of the frame before it.
        before: (i64, f64),
    },
}

impl fmt::Display for UnusedTimes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { frame, fault, fps } = self;
        match fault {
            TimeFault::Missing => write!(f, "frame {frame} has no time"),
            TimeFault::NotFinite => write!(f, "the time of frame {frame} is not a finite number"),
            TimeFault::NotLater { time, before: (earlier, at) } => write!(
                f,
                "the time of frame {frame}, {time} s, is not later than that of frame {earlier}, \
                 {at} s"
            ),
        }?;
        f.write_str("; meniscus ignores the times of all frames, and uses ")?;
        match fps {
            Some(fps) => write!(f, "the frame numbers divided by {fps} frames per second"),
            None => write!(
                f,
                "the frame numbers, at {FRAMES_PER_SECOND} frames per second in USD stages and \
                 Alembic archives"
            ),
        }
    }
}

/// The times of all frames of a simulation.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Timeline {
    /// Number of time codes per second.
    pub codes_per_second: f64,
    /// The time of each frame, in the order of the frames.
    pub frames: Vec<FrameTime>,
}

impl Timeline {
    /// Creates the timeline of frames that are sorted by number. `fps` is the frame rate in frames
    /// per second, if it is given.
    ///
    /// The timeline uses the times of the frames if all frames have a time, and if the times and
    /// their time codes are strictly increasing. Otherwise, it uses the frame numbers. The time
    /// codes are strictly increasing in both cases.
    pub fn of(frames: &[SeriesFrame], fps: Option<f64>) -> Self {
        Self::of_times(frames, fps).unwrap_or_else(|| Self::of_numbers(frames, fps))
    }

    /// The reason why the timeline of `frames` does not use their times. `None` if the timeline
    /// uses the times, or if the frames have fewer than two different times.
    pub fn unused_times(frames: &[SeriesFrame], fps: Option<f64>) -> Option<UnusedTimes> {
        let mut times =
            frames.iter().filter_map(|frame| frame.time).filter(|time| time.is_finite());
        let first = times.next()?;
        if times.all(|time| time == first) || Self::of_times(frames, fps).is_some() {
            return None;
        }
        let fault = |index: usize| {
            let before = index.checked_sub(1).map(|before| &frames[before]);
            let before = before.and_then(|before| Some((before.frame, before.time?)));
            match (frames[index].time, before) {
                (None, _) => Some(TimeFault::Missing),
                (Some(time), _) if !time.is_finite() => Some(TimeFault::NotFinite),
                (Some(time), Some(before)) if time <= before.1 => {
                    Some(TimeFault::NotLater { time, before })
                }
                _ => None,
            }
        };
        let found = |index: usize| Some((frames[index].frame, fault(index)?));
        let (frame, fault) = (0..frames.len()).find_map(found)?;
        Some(UnusedTimes { frame, fault, fps })
    }

    fn of_times(frames: &[SeriesFrame], fps: Option<f64>) -> Option<Self> {
        let times: Vec<f64> = frames.iter().map(|frame| frame.time).collect::<Option<_>>()?;
        if !is_increasing(&times) {
            return None;
        }
        let numbers: Vec<i64> = frames.iter().map(|frame| frame.frame).collect();
        let rate = fps.or_else(|| implied_rate(&times, &numbers));
        let codes_per_second = rate.unwrap_or(FRAMES_PER_SECOND);
        let codes = time_codes(&times, codes_per_second);
        if !is_increasing(&codes) {
            return None;
        }
        let timed = |(time, code): (f64, f64)| {
            // If the rate of the scene is unknown, an archive keeps the exact times.
            FrameTime { time, code, seconds: rate.map_or(time, |rate| code / rate) }
        };
        Some(Self { codes_per_second, frames: times.into_iter().zip(codes).map(timed).collect() })
    }

    fn of_numbers(frames: &[SeriesFrame], fps: Option<f64>) -> Self {
        let codes_per_second = fps.unwrap_or(FRAMES_PER_SECOND);
        let timed = |frame: &SeriesFrame| {
            let code = frame.frame as f64;
            FrameTime { time: code / fps.unwrap_or(1.0), code, seconds: code / codes_per_second }
        };
        Self { codes_per_second, frames: frames.iter().map(timed).collect() }
    }
}

fn is_increasing(values: &[f64]) -> bool {
    values.iter().all(|value| value.is_finite()) && values.is_sorted_by(|a, b| a < b)
}

/// Converts increasing times in seconds to time codes.
///
/// All time codes are rounded, if all are within [`TOLERANCE_OF_ALL`] of different whole numbers.
/// Otherwise, a time code is rounded if its distance to a whole number is at most [`TOLERANCE`]
/// times the smallest of 1 and its distances to the time codes before and after it. Therefore,
/// rounding never makes two time codes equal.
fn time_codes(times: &[f64], codes_per_second: f64) -> Vec<f64> {
    let exact: Vec<f64> = times.iter().map(|time| time * codes_per_second).collect();
    // Adding 0 turns -0 into 0.
    let whole: Vec<f64> = exact.iter().map(|code| code.round() + 0.0).collect();
    let is_near = |(code, whole): (&f64, &f64)| (code - whole).abs() <= TOLERANCE_OF_ALL;
    if is_increasing(&whole) && exact.iter().zip(&whole).all(is_near) {
        return whole;
    }
    let rounded = |(index, &code): (usize, &f64)| {
        let before = index.checked_sub(1).map(|before| code - exact[before]);
        let after = exact.get(index + 1).map(|after| after - code);
        let step = before.into_iter().chain(after).fold(1.0, f64::min);
        if (code - whole[index]).abs() <= TOLERANCE * step { whole[index] } else { code }
    };
    exact.iter().enumerate().map(rounded).collect()
}

/// Returns the frame rate, in frames per second, that evenly spaced times imply. The rate is a
/// whole number, or a whole number divided by 1.001.
///
/// Times are evenly spaced if they are proportional to the frame numbers, or if their differences
/// are multiples of the smallest difference. Therefore, some frames may be missing. If at least
/// [`MIN_REGULAR_FRAMES`] frames precede the last frame, its time may be irregular.
fn implied_rate(times: &[f64], numbers: &[i64]) -> Option<f64> {
    let before_last =
        Some(times.len().saturating_sub(1)).filter(|&frames| frames >= MIN_REGULAR_FRAMES);
    [times.len()].into_iter().chain(before_last).find_map(|end| {
        let times = &times[..end];
        let steps = [steps_by_number(&numbers[..end]), steps_by_time(times)];
        steps.iter().find_map(|steps| rate_of(times, steps))
    })
}

/// Counts the steps from the first frame to each frame. A step is the largest number that divides
/// all differences of frame numbers.
fn steps_by_number(numbers: &[i64]) -> Vec<f64> {
    let first = numbers.first().copied().unwrap_or_default();
    let differences = || numbers.iter().map(|number| number.abs_diff(first));
    let step = differences().fold(0, greatest_common_divisor).max(1);
    differences().map(|difference| (difference / step) as f64).collect()
}

/// Counts the steps from the first frame to each frame. A step is the smallest difference of times.
fn steps_by_time(times: &[f64]) -> Vec<f64> {
    let differences = || times.windows(2).map(|pair| pair[1] - pair[0]);
    let smallest = differences().fold(f64::INFINITY, f64::min);
    let mut steps = vec![0.0; times.len().min(1)];
    let mut sum = 0.0;
    for difference in differences() {
        sum += (difference / smallest).round();
        steps.push(sum);
    }
    steps
}

/// Returns the frame rate at which each time is `steps` frames after the first time, within
/// [`TOLERANCE`].
fn rate_of(times: &[f64], steps: &[f64]) -> Option<f64> {
    let (first, last) = (times.first()?, times.last()?);
    let whole = (steps.last()? / (last - first)).round();
    let deviation = |rate: f64| {
        let deviations =
            times.iter().zip(steps).map(|(time, step)| ((time - first) * rate - step).abs());
        deviations.fold(0.0, f64::max)
    };
    // In a short sequence, the whole rate and the divided rate are both within the tolerance. Whole
    // rates are more usual, so the deviation of the divided rate must be ten times smaller.
    let divided = DIVIDED.contains(&whole).then_some(whole * 1000.0 / 1001.0);
    let divided = divided.filter(|&divided| 10.0 * deviation(divided) < deviation(whole));
    let rate = divided.unwrap_or(whole);
    (IMPLIED.contains(&rate) && deviation(rate) <= TOLERANCE).then_some(rate)
}

/// The largest number that divides `a` and `b`.
pub(crate) fn greatest_common_divisor(a: u64, b: u64) -> u64 {
    if b == 0 { a } else { greatest_common_divisor(b, a % b) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A number with six significant digits, as simulators print it.
    fn printed(time: f64) -> f64 {
        format!("{time:.5e}").parse().unwrap()
    }

    /// The times of frames 0 to 199 at a frame rate, each changed by `change`.
    fn at_rate(rate: f64, change: impl Fn(f64) -> f64) -> Vec<f64> {
        (0..200).map(|frame| change(f64::from(frame) / rate)).collect()
    }

    fn numbers(times: &[f64]) -> Vec<i64> {
        (0..times.len() as i64).collect()
    }

    fn implied(times: &[f64]) -> Option<f64> {
        implied_rate(times, &numbers(times))
    }

    #[test]
    fn rounded_and_late_times_have_whole_time_codes() {
        let whole: Vec<f64> = (0..200).map(f64::from).collect();
        for rate in [10.0, 24.0, 25.0, 30.0, 60.0, 100.0, 24_000.0 / 1001.0] {
            assert_eq!(time_codes(&at_rate(rate, printed), rate), whole, "{rate}");
            let single = at_rate(rate, |time| f64::from(time as f32));
            assert_eq!(time_codes(&single, rate), whole, "{rate}");
            let late = at_rate(rate, |time| if time > 0.0 { time + 0.0004 } else { time });
            assert_eq!(time_codes(&late, rate), whole, "{rate}");
        }
        for rate in [24.0, 30.0] {
            let two_decimals = at_rate(rate, |time| (100.0 * time).round() / 100.0);
            assert_eq!(time_codes(&two_decimals, rate), whole, "{rate}");
        }
        assert_eq!(time_codes(&[-0.000_001, 0.25], 24.0)[0].to_bits(), 0, "no negative zero");
    }

    #[test]
    fn times_between_time_codes_stay_as_they_are() {
        // A simulation with 10 frames per second, in a stage with 24 time codes per second.
        let codes = time_codes(&[0.0, 0.500_047, 0.900_049], 24.0);
        assert_eq!(codes[..2], [0.0, 12.0]);
        assert!((codes[2] - 21.601_176).abs() < 1e-9, "{codes:?}");
        assert_eq!(time_codes(&[0.0, 0.125, 0.25], 10.0), [0.0, 1.25, 2.5]);
    }

    #[test]
    fn rounding_never_makes_two_time_codes_equal() {
        // The time between frames is much shorter than a time code.
        for step in [1e-3, 1e-5, 1e-9, 1e-13] {
            let times: Vec<f64> = (-50..50).map(|frame| 1.0 + step * f64::from(frame)).collect();
            let codes = time_codes(&times, 24.0);
            assert!(is_increasing(&codes), "{step}");
            assert!(codes.contains(&24.0), "{step}");
        }
    }

    #[test]
    fn evenly_spaced_times_imply_their_rate_even_if_frames_are_missing() {
        for rate in [1.0, 10.0, 24.0, 25.0, 30.0, 50.0, 60.0, 240.0, 1000.0] {
            let mut times = at_rate(rate, printed);
            assert_eq!(implied(&times), Some(rate));
            times.retain(|time| (time * rate).round() as i64 % 7 != 3);
            assert_eq!(implied(&times), Some(rate), "with gaps");
            assert_eq!(implied(&times[..2]), Some(rate), "two frames");
        }
        for rate in DIVIDED.map(|rate| rate * 1000.0 / 1001.0) {
            assert_eq!(implied(&at_rate(rate, printed)), Some(rate));
        }
        let late = at_rate(24.0, |time| if time > 0.0 { time + 0.0004 } else { time });
        (2..200).for_each(|end| assert_eq!(implied(&late[..end]), Some(24.0), "{end} frames"));
        // The first frame need not be at time 0, and the time of the last frame may be irregular.
        assert_eq!(implied(&[7.013, 7.053, 7.093, 7.133, 7.15]), Some(25.0));
    }

    #[test]
    fn frame_numbers_imply_the_rate_if_no_two_frames_are_adjacent() {
        let times = [0.0, 0.500_047, 0.900_049];
        assert_eq!(implied_rate(&times, &[0, 5, 9]), Some(10.0));
        assert_eq!(implied(&times), None);
        // The numbers may count time steps instead of frames. Here, 200 time steps are one frame.
        assert_eq!(implied_rate(&[0.1, 0.14, 0.22], &[500, 700, 1100]), Some(25.0));
        assert_eq!(implied_rate(&[0.0, 0.2, 0.4], &[i64::MIN, 0, i64::MAX]), Some(5.0));
    }

    #[test]
    fn uneven_times_and_rates_out_of_range_imply_nothing() {
        for times in [
            &[][..],
            &[0.5],
            &[0.0, 0.04, 0.1, 0.13],
            &[0.0, 2.0, 4.0],
            &[0.0, 1e-4, 2e-4],
            &[0.0, 0.375, 0.75],
            &[-f64::MAX, 0.0, f64::MAX],
            &[0.0, 5e-324, 1e-323],
        ] {
            assert_eq!(implied(times), None, "{times:?}");
        }
    }

    fn frame((frame, time): (i64, Option<f64>)) -> SeriesFrame {
        SeriesFrame {
            frame,
            time,
            file: String::new(),
            bytes: 0,
            particles: 0,
            vertices: 0,
            triangles: 0,
            bounds: None,
            normals: false,
            attributes: Vec::new(),
        }
    }

    #[test]
    fn the_first_frame_with_an_invalid_time_is_reported() {
        let unused = |times: &[Option<f64>]| {
            let frames: Vec<_> = (1..).zip(times.iter().copied()).map(frame).collect();
            let of_timeline =
                Timeline::of(&frames, Some(25.0)) == Timeline::of_numbers(&frames, Some(25.0));
            let unused = Timeline::unused_times(&frames, Some(25.0));
            assert!(unused.is_none() || of_timeline);
            unused.map(|unused| (unused.frame, unused.fault))
        };
        let (a, b, c) = (Some(0.0), Some(0.02), Some(0.04));
        assert_eq!(unused(&[a, b, c]), None);
        assert_eq!(unused(&[None, None, None]), None);
        assert_eq!(unused(&[a, a, a]), None, "a format without times may store 0");
        assert_eq!(unused(&[a, None, c]), Some((2, TimeFault::Missing)));
        assert_eq!(unused(&[None, b, c]), Some((1, TimeFault::Missing)));
        assert_eq!(unused(&[a, b, Some(f64::NAN)]), Some((3, TimeFault::NotFinite)));
        let later = TimeFault::NotLater { time: 0.02, before: (2, 0.04) };
        assert_eq!(unused(&[a, c, b]), Some((3, later)));
    }

    #[test]
    fn an_archive_has_exact_times_if_the_frame_rate_is_unknown() {
        let times = [0.0, 0.04, 0.1].map(Some);
        let frames: Vec<_> = (1..).zip(times).map(frame).collect();
        let seconds = |fps: Option<f64>| -> Vec<f64> {
            Timeline::of(&frames, fps).frames.iter().map(|frame| frame.seconds).collect()
        };
        // At 24 frames per second, 0.04 s is 0.96 frames, which becomes time code 1.
        assert_eq!(Timeline::of(&frames, None).frames[1].code, 1.0);
        assert_eq!(seconds(None), [0.0, 0.04, 0.1]);
        assert_eq!(seconds(Some(24.0))[1], 1.0 / 24.0);
        assert_eq!(Timeline::of(&frames, None).codes_per_second, 24.0);
    }
}

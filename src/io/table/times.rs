//! Detects a table that contains several frames: a column of times divides its rows into blocks.

use crate::io::UnreadPart;
use crate::io::names::Quantity;

/// Names of the column that contains the time or the number of a frame, compared without regard to
/// case. The name `t` also counts, but only in lower case, because `T` may be a temperature.
const NAMES: [&str; 4] = ["time", "frame", "step", "timestep"];
/// Maximum number of frames. A column with more different numbers has a time for each particle.
const MOST_FRAMES: usize = 1 << 16;
/// Minimum number of rows of a frame.
const FEWEST_ROWS: u64 = 4;

/// The runs of rows with equal times in a table.
#[derive(Debug, Default)]
pub struct Times {
    /// The time and the number of rows of each run, in ascending order of the times.
    runs: Vec<(f64, u64)>,
    /// Whether the times are not sorted, or there are too many.
    is_mixed: bool,
}

impl Times {
    /// Whether a quantity may be the time of each frame.
    pub fn are_in(quantity: &Quantity) -> bool {
        let name = &*quantity.name;
        let is_time = name == "t" || NAMES.iter().any(|known| name.eq_ignore_ascii_case(known));
        quantity.columns.len() == 1 && is_time
    }

    /// Adds `rows` rows with the same number.
    pub fn push(&mut self, number: f64, rows: u64) {
        let is_full = self.runs.len() == MOST_FRAMES;
        match self.runs.last_mut() {
            Some((last, count)) if *last == number => *count += rows,
            Some((last, _)) if *last < number && !is_full => {
                self.runs.push((number, rows));
            }
            None if !number.is_nan() => self.runs.push((number, rows)),
            _ => self.is_mixed = true,
        }
    }

    /// Adds the rows of the next piece of a table.
    pub fn append(&mut self, next: Self) {
        self.is_mixed |= next.is_mixed;
        next.runs.into_iter().for_each(|(number, rows)| self.push(number, rows));
    }

    /// A message about the frames that the column `name` divides the rows into. `None` if particles
    /// may have times of their own.
    ///
    /// The column divides the rows into frames if its numbers are sorted, each of them has at least
    /// [`FEWEST_ROWS`] rows, and two consecutive numbers have similar numbers of rows.
    pub fn frames(&self, name: &str) -> Option<UnreadPart> {
        let [(first, _), .., (last, _)] = self.runs[..] else { return None };
        let are_similar = |a: u64, b: u64| 10 * a.abs_diff(b) <= a.max(b);
        let is_divided = !self.is_mixed
            && self.runs.iter().all(|(_, rows)| *rows >= FEWEST_ROWS)
            && self.runs.windows(2).any(|pair| are_similar(pair[0].1, pair[1].1));
        is_divided.then(|| UnreadPart::Times {
            column: name.to_owned(),
            count: self.runs.len(),
            first: first.to_string(),
            last: last.to_string(),
        })
    }
}

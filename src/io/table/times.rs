//! Detects a table that contains several frames. In such a table, a column contains several
//! different times, and at least half of these times occur in several rows.

use hashbrown::HashMap;

use crate::io::UnreadPart;
use crate::io::names::{Quantity, bare_name};

/// Names of the column that contains the time or the number of a frame, in lower case and without
/// punctuation. `times` also stands for `time_s`, a name with the unit s. The name `t` also counts,
/// but only in lower case, because `T` may be a temperature.
const NAMES: [&str; 20] = [
    "time",
    "times",
    "timestep",
    "timestamp",
    "timeindex",
    "simtime",
    "simulationtime",
    "physicaltime",
    "frame",
    "frameid",
    "frameindex",
    "frameno",
    "framenumber",
    "step",
    "stepnumber",
    "snapshot",
    "snapshotnumber",
    "snap",
    "iteration",
    "iter",
];
/// Names that often mean something else, such as a temperature or the iterations of a solver.
const AMBIGUOUS: [&str; 4] = ["t", "step", "iteration", "iter"];
/// Maximum number of frames. A column with more different numbers has a time for each particle.
const MOST_FRAMES: usize = 1 << 16;
/// Minimum number of rows that at least half of the frames must have.
const FEWEST_ROWS: u64 = 4;

/// The different times in a column of a table, and the number of rows with each time.
#[derive(Debug, Default)]
pub struct Times {
    /// The number of rows for the bits of each time.
    rows: HashMap<u64, u64>,
    /// Whether there are more than [`MOST_FRAMES`] times. The further times are not counted.
    are_too_many: bool,
}

impl Times {
    /// Whether a quantity may be the time of each frame.
    pub fn are_in(quantity: &Quantity) -> bool {
        let name = bare_name(&quantity.name);
        let plain: String = name.chars().filter(char::is_ascii_alphanumeric).collect();
        let is_time = name == "t" || NAMES.contains(&&*plain.to_ascii_lowercase());
        quantity.columns.len() == 1 && is_time
    }

    /// Adds `rows` rows with the same number. Ignores rows without a number (NaN).
    pub fn push(&mut self, number: f64, rows: u64) {
        if number.is_nan() || self.are_too_many {
            return;
        }
        // Adding 0 turns -0 into 0.
        *self.rows.entry((number + 0.0).to_bits()).or_default() += rows;
        self.are_too_many = self.rows.len() > MOST_FRAMES;
    }

    /// Adds the rows of the next piece of a table.
    pub fn append(&mut self, next: Self) {
        self.are_too_many |= next.are_too_many;
        next.rows.into_iter().for_each(|(bits, rows)| self.push(f64::from_bits(bits), rows));
    }

    /// A description of the frames into which the column `name` divides the rows. `None` if the
    /// column may contain a separate time for each particle.
    ///
    /// The column divides the rows into frames if there are several times, and at least half of
    /// them have [`FEWEST_ROWS`] rows or more. The rows can have any order. If the name is one of
    /// [`AMBIGUOUS`], all times must also have nearly the same number of rows.
    pub fn frames(&self, name: &str) -> Option<UnreadPart> {
        let count = self.rows.len();
        let most = self.rows.values().copied().max().unwrap_or(0);
        let least = self.rows.values().copied().min().unwrap_or(0);
        if AMBIGUOUS.contains(&&*bare_name(name).to_ascii_lowercase()) && 10 * least < 9 * most {
            return None;
        }
        let shared = self.rows.values().filter(|rows| **rows >= FEWEST_ROWS).count();
        let is_divided = !self.are_too_many && count > 1 && 2 * shared >= count;
        let times = || self.rows.keys().map(|&bits| f64::from_bits(bits));
        is_divided.then(|| UnreadPart::Times {
            column: name.to_owned(),
            count,
            first: times().fold(f64::INFINITY, f64::min).to_string(),
            last: times().fold(f64::NEG_INFINITY, f64::max).to_string(),
        })
    }
}

//! Why a mesh cannot be made in parts, or its parts not be merged.

use std::path::PathBuf;

use thiserror::Error;

/// A mesh that is made in parts, of which something is not as it has to be.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PartsError {
    /// A number of parts that none can have.
    #[error("the number of parts must be from 1 to {most}, got {asked}")]
    Count {
        /// The number that was asked for.
        asked: u32,
        /// The most that there can be.
        most: u32,
    },
    /// A part beyond the last.
    #[error("the part must be from 0 to {last}, got {part}", last = of - 1)]
    NoPart {
        /// The part's number.
        part: u32,
        /// How many parts there are.
        of: u32,
    },
    /// An output that has no folder beside it.
    #[error("{}: the output of a mesh in parts must be a regular file", .0.display())]
    NoFile(PathBuf),
    /// Nothing is planned yet.
    #[error("{}: there is no plan yet", .0.display())]
    NoPlan(PathBuf),
    /// A plan that is damaged, or no plan.
    #[error("{}: {what}", path.display())]
    Plan {
        /// The plan's file.
        path: PathBuf,
        /// The damage.
        what: String,
    },
    /// A plan for something else.
    #[error("{}: the plan was made with other settings ({differing})", path.display())]
    Settings {
        /// The plan's file.
        path: PathBuf,
        /// The settings' names.
        differing: String,
    },
    /// Particles that are not those that the plan was made for.
    #[error("{}: differs from the input of {}, or has changed since", input.display(), plan.display())]
    Changed {
        /// The particles' file.
        input: PathBuf,
        /// The plan's file.
        plan: PathBuf,
    },
    /// Parts that are not there.
    #[error("{}: {} of {of} parts are missing: {}", folder.display(), missing.len(), shortened(missing))]
    Missing {
        /// Where they would be.
        folder: PathBuf,
        /// Numbers of those parts.
        missing: Vec<u32>,
        /// How many parts there are.
        of: u32,
    },
    /// A part that is damaged.
    #[error("{}: damaged: {what}", path.display())]
    Damaged {
        /// The part's file.
        path: PathBuf,
        /// The damage.
        what: String,
    },
    /// A part that was made by another plan.
    #[error("{}: belongs to another plan", .0.display())]
    Foreign(PathBuf),
    /// A folder, the plan or a part that cannot be read or written.
    #[error("{}: {fault}", path.display())]
    Io {
        /// Where.
        path: PathBuf,
        /// The system's own refusal.
        #[source]
        fault: std::io::Error,
    },
}

/// Numbers that are listed, at the most.
const LISTED: usize = 16;

/// Numbers as people read them: those that follow one another as a range, and no more than the
/// first few.
fn shortened(numbers: &[u32]) -> String {
    let ranges = numbers.chunk_by(|a, b| a + 1 == *b).map(|range| match range {
        [first, .., last] => format!("{first} to {last}"),
        one => one[0].to_string(),
    });
    let mut ranges: Vec<String> = ranges.collect();
    if ranges.len() > LISTED {
        ranges.truncate(LISTED);
        ranges.push("...".into());
    }
    ranges.join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_that_follow_one_another_are_a_range_and_many_are_cut_short() {
        assert_eq!(shortened(&[3]), "3");
        assert_eq!(shortened(&[0, 1, 2, 5, 7, 8]), "0 to 2, 5, 7 to 8");
        let odd: Vec<u32> = (0..100).map(|i| 2 * i + 1).collect();
        assert!(shortened(&odd).ends_with("31, ..."));
    }
}

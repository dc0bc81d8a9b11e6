//! Errors while making a mesh in parts, or while merging the parts.

use std::path::PathBuf;

use thiserror::Error;

/// An error while making a mesh in parts.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PartsError {
    /// An invalid number of parts.
    #[error("the number of parts must be from 1 to {most}, got {asked}")]
    Count {
        /// The requested number.
        asked: u32,
        /// The maximum.
        most: u32,
    },
    /// A part number that is greater than the number of the last part.
    #[error("the part number must be from 0 to {last}, got {part}", last = of - 1)]
    NoPart {
        /// The part's number.
        part: u32,
        /// The number of parts.
        of: u32,
    },
    /// An output that cannot have a folder of parts next to it.
    #[error("{}: to make a mesh in parts, the output must be a regular file", .0.display())]
    NoFile(PathBuf),
    /// The plan does not exist yet.
    #[error("{}: there is no plan yet; make the plan first", .0.display())]
    NoPlan(PathBuf),
    /// A plan that is damaged, or was written by another version of meniscus.
    #[error(
        "{}: cannot use this plan ({what}); it may be damaged, or another version of meniscus may \
         have written it; make the plan again",
        path.display()
    )]
    Plan {
        /// The plan's file.
        path: PathBuf,
        /// The damage.
        what: String,
    },
    /// A plan with other settings.
    #[error(
        "{}: the plan was made with different settings ({differing}); undo the changes, or make \
         the plan again",
        path.display()
    )]
    Settings {
        /// The plan's file.
        path: PathBuf,
        /// The names of the settings that differ.
        differing: String,
    },
    /// A particle file for which the plan was not made, or that has changed since then.
    #[error(
        "{}: this is not the file for which {} was made, or it has changed since then; make the \
         plan again",
        input.display(), plan.display()
    )]
    Changed {
        /// The particles' file.
        input: PathBuf,
        /// The plan's file.
        plan: PathBuf,
    },
    /// Missing parts.
    #[error(
        "{}: {} of {of} parts are missing: {}; make them first",
        folder.display(), missing.len(), shortened(missing)
    )]
    Missing {
        /// The folder of the parts.
        folder: PathBuf,
        /// Numbers of the missing parts.
        missing: Vec<u32>,
        /// The number of parts.
        of: u32,
    },
    /// A damaged part.
    #[error("{}: this part is damaged: {what}; make it again", path.display())]
    Damaged {
        /// The part's file.
        path: PathBuf,
        /// The damage.
        what: String,
    },
    /// A part that was made with another plan.
    #[error(
        "{}: this part was made with a different plan than the plan.json in its folder; make the \
         part again",
        .0.display()
    )]
    OtherPlan(PathBuf),
    /// A folder, plan or part that cannot be read or written.
    #[error("{}: {fault}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        #[source]
        fault: std::io::Error,
    },
}

/// Maximum number of ranges in a message.
const LISTED: usize = 16;

/// Lists numbers, with consecutive numbers joined into ranges. Only the first `LISTED` ranges are
/// shown.
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
    fn consecutive_numbers_are_shown_as_ranges_and_long_lists_are_shortened() {
        assert_eq!(shortened(&[3]), "3");
        assert_eq!(shortened(&[0, 1, 2, 5, 7, 8]), "0 to 2, 5, 7 to 8");
        let odd: Vec<u32> = (0..100).map(|i| 2 * i + 1).collect();
        assert!(shortened(&odd).ends_with("31, ..."));
    }
}

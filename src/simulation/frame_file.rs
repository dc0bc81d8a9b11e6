//! A frame of a simulation with its number, time and files; and the selection of frames by number.

use std::path::{Path, PathBuf};

use crate::io::bytes::Unpacking;
use crate::io::frame_files::files_of;
use crate::io::input::open_joined;
use crate::io::stamp::Stamp;
use crate::io::wanted::WantedParticles;
use crate::io::{ParticleFile, ReadError, ReadFault};

/// A frame and its files.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameFile {
    /// The frame's number.
    pub number: i64,
    /// The number as spelled in the file's name.
    pub digits: String,
    /// The time in the name, if there is one.
    pub time: Option<f64>,
    /// The file, or the first of several.
    pub path: PathBuf,
    /// Other files with particles of this frame.
    pub others: Vec<PathBuf>,
    /// The files of the solids of this frame.
    pub solids: Vec<PathBuf>,
    /// A message that says what the frame lacks, if it has fewer files with particles than other
    /// frames. Such a frame cannot be read.
    pub lacking: Option<String>,
}

impl FrameFile {
    /// A frame in one file.
    #[must_use]
    pub fn new(number: i64, digits: String, path: PathBuf) -> Self {
        let (others, solids) = (Vec::new(), Vec::new());
        Self { number, digits, time: None, path, others, solids, lacking: None }
    }

    /// All files with particles of this frame.
    pub fn paths(&self) -> impl Iterator<Item = &Path> {
        std::iter::once(&self.path).chain(&self.others).map(PathBuf::as_path)
    }

    /// Total size, in bytes, of the frame's files and their pieces. Missing files count as 0.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        let bytes = |file: &PathBuf| file.metadata().map_or(0, |metadata| metadata.len());
        self.paths().flat_map(files_of).map(|file| bytes(&file)).sum()
    }

    /// Returns the current stamp of the frame's files and of its existing solids.
    pub(super) fn stamp(&self) -> Result<Stamp, ReadError> {
        let solids = self.solids.iter().map(PathBuf::as_path).filter(|path| path.exists());
        Stamp::of_all(self.paths().chain(solids))
    }

    pub(super) fn open(
        &self,
        wanted: WantedParticles,
        unpacking: Unpacking,
    ) -> Result<ParticleFile, ReadError> {
        if let Some(lacking) = &self.lacking {
            return Err(ReadError::new(&self.path, ReadFault::Incomplete(lacking.clone())));
        }
        let file = open_joined(&self.paths().collect::<Vec<_>>(), wanted, unpacking)?;
        Ok(ParticleFile { time: file.time.or(self.time), ..file })
    }
}

/// Iterates over all pairs of consecutive frames.
pub(super) fn neighbours(frames: &[FrameFile]) -> impl Iterator<Item = (&FrameFile, &FrameFile)> {
    frames.iter().zip(frames.iter().skip(1))
}

/// A selection of frame numbers. Both ends are included.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Selection {
    /// The first number.
    pub start: i64,
    /// The last number.
    pub end: i64,
    /// Difference between consecutive selected numbers.
    pub step: u64,
}

impl Default for Selection {
    fn default() -> Self {
        Self { start: i64::MIN, end: i64::MAX, step: 1 }
    }
}

impl Selection {
    /// Whether a number is between the first and the last number.
    pub fn spans(self, number: i64) -> bool {
        (self.start..=self.end).contains(&number)
    }

    /// Returns the selected frames. The steps begin at `start` if it is given, and otherwise at the
    /// first of `frames`.
    pub fn of(self, frames: Vec<FrameFile>) -> Vec<FrameFile> {
        let is_given = self.start > i64::MIN;
        let first = frames.first().filter(|_| !is_given).map(|frame| frame.number);
        let from = first.unwrap_or(self.start);
        let wanted = |number: i64| {
            self.spans(number) && number.abs_diff(from).is_multiple_of(self.step.max(1))
        };
        frames.into_iter().filter(|frame| wanted(frame.number)).collect()
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
    fn a_selection_includes_both_ends_and_steps_from_its_first_frame() {
        let numbers = |selection: Selection| {
            selection
                .of(frames(&[1, 2, 3, 4, 5, 6, 7]))
                .iter()
                .map(|f| f.number)
                .collect::<Vec<_>>()
        };
        assert_eq!(numbers(Selection { start: 3, end: 6, step: 1 }), [3, 4, 5, 6]);
        assert_eq!(numbers(Selection { step: 3, ..Selection::default() }), [1, 4, 7]);
        assert_eq!(numbers(Selection { start: -1, step: 3, ..Selection::default() }), [2, 5]);
        assert_eq!(numbers(Selection { start: 2, end: i64::MAX, step: 2 }), [2, 4, 6]);
    }
}

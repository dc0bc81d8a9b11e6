//! Groups files into frames by the numbers and times in their names: one file per frame, several
//! pieces with the same number, or frames with the same number from several simulations.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use crate::error::SimulationError;

use super::frame_file::FrameFile;
use super::inputs::Sequence;
use super::pattern::{FrameCandidate, Pattern};

/// Groups files into frames by the integers in their names. If the pattern has a place for the
/// number of a piece, files with the same frame number are pieces of one frame.
pub(super) fn whole(
    pattern: &Pattern,
    files: Vec<(String, FrameCandidate)>,
) -> Result<Vec<FrameFile>, SimulationError> {
    let number = |(digits, file): (String, FrameCandidate)| match digits.parse() {
        Ok(number) => Ok((number, digits, file)),
        Err(_) => Err(SimulationError::Names(format!(
            "{}: the frame number must be from {} to {}",
            file.path.display(),
            i64::MIN,
            i64::MAX
        ))),
    };
    let files = files.into_iter().map(number).collect::<Result<Vec<_>, _>>()?;
    if !pattern.has_pieces() {
        let frame = |(number, digits, file): (i64, String, FrameCandidate)| {
            FrameFile::new(number, digits, file.path)
        };
        return Ok(files.into_iter().map(frame).collect());
    }
    let mut frames: BTreeMap<i64, BTreeMap<u64, (String, PathBuf)>> = BTreeMap::new();
    for (number, digits, file) in files {
        let Some(piece) = pattern.piece(&file.name) else { continue };
        let pieces = frames.entry(number).or_default();
        if let Some((_, other)) = pieces.insert(piece, (digits, file.path.clone())) {
            return Err(SimulationError::Names(format!(
                "{} and {} are both piece {piece} of frame {number}; remove one",
                other.display(),
                file.path.display(),
            )));
        }
    }
    let all: BTreeSet<u64> = frames.values().flat_map(|pieces| pieces.keys().copied()).collect();
    let mut joined = Vec::new();
    for (number, pieces) in frames {
        if let Some(lacking) = all.iter().find(|piece| !pieces.contains_key(piece)) {
            return Err(SimulationError::Names(format!(
                "{pattern}: frame {number} has no piece {lacking}, but other frames do; add the \
                 piece, or leave that frame out"
            )));
        }
        let mut pieces = pieces.into_values();
        if let Some((digits, path)) = pieces.next() {
            let others = pieces.map(|(_, path)| path).collect();
            joined.push(FrameFile { others, ..FrameFile::new(number, digits, path) });
        }
    }
    Ok(joined)
}

/// Sorts files by the times in their names, and numbers them from 0.
pub(super) fn timed(files: Vec<(String, FrameCandidate)>) -> Vec<FrameFile> {
    let time =
        |(digits, file): (String, FrameCandidate)| Some((digits.parse().ok()?, digits, file));
    let mut files: Vec<(f64, String, FrameCandidate)> =
        files.into_iter().filter_map(time).collect();
    files.sort_by(|(a, _, one), (b, _, other)| {
        a.total_cmp(b).then_with(|| one.path.cmp(&other.path))
    });
    let frame = |(number, (time, digits, file)): (i64, (f64, String, FrameCandidate))| FrameFile {
        time: Some(time),
        ..FrameFile::new(number, digits, file.path)
    };
    (0..).zip(files).map(frame).collect()
}

/// Joins the frames with the same number from several simulations.
pub(super) fn joined(
    sequences: &[Sequence],
    lists: Vec<Vec<FrameFile>>,
) -> Result<Vec<FrameFile>, SimulationError> {
    let mut lists = lists.into_iter().zip(sequences);
    let Some((mut frames, first)) = lists.next() else { return Ok(Vec::new()) };
    for (list, sequence) in lists {
        let numbers =
            |frames: &[FrameFile]| frames.iter().map(|f| f.number).collect::<BTreeSet<_>>();
        let [own, other] = [numbers(&frames), numbers(&list)];
        if let Some(number) = own.symmetric_difference(&other).next() {
            let (has, lacks) =
                if own.contains(number) { (first, sequence) } else { (sequence, first) };
            return Err(SimulationError::Names(format!(
                "{} has frame {number}, but {} does not; joined inputs need the same frame numbers",
                has.source().describe(),
                lacks.source().describe()
            )));
        }
        let times = |(a, b): (&FrameFile, &FrameFile)| a.time != b.time;
        if let Some((one, other)) = frames.iter().zip(&list).find(|(a, b)| times((a, b))) {
            return Err(SimulationError::Names(format!(
                "{} and {} have different times; the frames of joined inputs need the same times",
                one.path.display(),
                other.path.display()
            )));
        }
        for (frame, other) in frames.iter_mut().zip(list) {
            frame.others.push(other.path);
            frame.others.extend(other.others);
        }
    }
    Ok(frames)
}

//! Groups files into frames by the numbers and times in their names: one file per frame, several
//! pieces with the same number, or frames with the same number from several simulations.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use crate::error::SimulationError;

use super::frame_file::FrameFile;
use super::inputs::Sequence;
use super::pattern::{FrameCandidate, Pattern};

/// Groups files into frames by the integers in their names. If the pattern has a placeholder for
/// the number of a piece, files with the same frame number are pieces of one frame.
pub(super) fn group_by_number(
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
        let lacking = all.iter().find(|piece| !pieces.contains_key(piece)).map(|piece| {
            format!(
                "frame {number} has no file for piece {piece}, but others have one; add the file"
            )
        });
        let mut pieces = pieces.into_values();
        if let Some((digits, path)) = pieces.next() {
            let others = pieces.map(|(_, path)| path).collect();
            joined.push(FrameFile { others, lacking, ..FrameFile::new(number, digits, path) });
        }
    }
    Ok(joined)
}

/// Sorts files by the times in their names, and numbers them from 0.
pub(super) fn number_by_time(files: Vec<(String, FrameCandidate)>) -> Vec<FrameFile> {
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

/// Joins the frames with the same number from several simulations. If one of the simulations lacks
/// a frame, the joined frame is incomplete.
///
/// # Errors
/// [`SimulationError::Names`] if a simulation has no frame number in common with the simulations
/// before it, or if frames with the same number have different times.
pub(super) fn join_simulations(
    sequences: &[Sequence],
    lists: Vec<Vec<FrameFile>>,
) -> Result<Vec<FrameFile>, SimulationError> {
    let mut lists = lists.into_iter().zip(sequences);
    let Some((frames, first)) = lists.next() else { return Ok(Vec::new()) };
    let by_number = |frames: Vec<FrameFile>| {
        frames.into_iter().map(|frame| (frame.number, frame)).collect::<BTreeMap<_, _>>()
    };
    let lacking = |number: i64, sequence: &Sequence| {
        format!(
            "the other inputs have frame {number}, but {} does not; add its file",
            sequence.source().describe()
        )
    };
    let mut frames = by_number(frames);
    for (list, sequence) in lists {
        let list = by_number(list);
        let is_empty = frames.is_empty() && list.is_empty();
        if !is_empty && !list.keys().any(|number| frames.contains_key(number)) {
            return Err(SimulationError::Names(format!(
                "{} and {} have no frame number in common; joined inputs need the same frame \
                 numbers",
                first.source().describe(),
                sequence.source().describe()
            )));
        }
        for frame in frames.values_mut().filter(|frame| !list.contains_key(&frame.number)) {
            frame.lacking.get_or_insert_with(|| lacking(frame.number, sequence));
        }
        for (number, other) in list {
            let Some(frame) = frames.get_mut(&number) else {
                let lacking = Some(lacking(number, first));
                frames.insert(number, FrameFile { lacking, ..other });
                continue;
            };
            if frame.time != other.time {
                return Err(SimulationError::Names(format!(
                    "{} and {} have different times; the frames of joined inputs need the same \
                     times",
                    frame.path.display(),
                    other.path.display()
                )));
            }
            frame.others.push(other.path);
            frame.others.extend(other.others);
            frame.lacking = frame.lacking.take().or(other.lacking);
        }
    }
    Ok(frames.into_values().collect())
}

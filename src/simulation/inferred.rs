//! Infers the pattern of a simulation's files from all of their names: the number that varies is
//! the frame number. Ambiguous names are rejected with an error that lists the possible patterns.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use crate::error::SimulationError;

use super::pattern::{FrameCandidate, NumberKind, PIECE, Pattern, skeleton};

/// Infers the patterns of files, one for each simulation. Files without a number are ignored.
///
/// Names that differ in more than their numbers belong to different simulations. In names that
/// differ only in numbers, the number that varies is the frame number. In the name of a single
/// file, the last number is the frame number. If several numbers vary, and all of them except the
/// last distinguish parallel simulations, the last one is the frame number. A number after a word
/// such as `rank` or `proc` is the number of a piece if more than half of the frames have all
/// pieces. Some decimal numbers are times: see [`times`].
///
/// # Errors
/// [`SimulationError::Names`] if several numbers could be the frame number.
pub(super) fn infer(files: &[FrameCandidate]) -> Result<Vec<Pattern>, SimulationError> {
    let numbered = files.iter().filter(|file| !file.runs.is_empty());
    let mut found: BTreeMap<[String; 2], Pattern> = BTreeMap::new();
    let mut add = |pattern: Pattern| {
        let key = [&pattern.prefix, &pattern.suffix].map(String::clone);
        found.entry(key).or_insert(pattern);
    };
    let mut kinds: BTreeMap<String, Vec<FrameCandidate>> = BTreeMap::new();
    for files in group_by(numbered, |file| skeleton(&file.name, &file.decimals())).into_values() {
        match times(&files) {
            Some(pattern) => add(pattern),
            None => files
                .into_iter()
                .for_each(|file| kinds.entry(file.skeleton()).or_default().push(file.clone())),
        }
    }
    merge_signed_names(&mut kinds);
    for files in kinds.into_values() {
        let mut files: Vec<&FrameCandidate> = files.iter().collect();
        files.sort_by(|a, b| a.path.cmp(&b.path));
        match frame_number(&files)? {
            FrameNumber::InPieces(pattern) => add(pattern),
            FrameNumber::Run(run) => files.iter().for_each(|file| add(file.pattern(run))),
        }
    }
    Ok(found.into_values().collect())
}

/// Groups files by a key.
fn group_by<'a>(
    files: impl IntoIterator<Item = &'a FrameCandidate>,
    key: impl Fn(&FrameCandidate) -> String,
) -> BTreeMap<String, Vec<&'a FrameCandidate>> {
    let mut groups: BTreeMap<String, Vec<&FrameCandidate>> = BTreeMap::new();
    for file in files {
        groups.entry(key(file)).or_default().push(file);
    }
    groups
}

/// Treats `f-1` and `f1` as names of one kind: if both exist, the dash is a sign.
fn merge_signed_names(kinds: &mut BTreeMap<String, Vec<FrameCandidate>>) {
    let dashed: Vec<String> =
        kinds.keys().filter(|kind| kind.matches("-\0").count() == 1).cloned().collect();
    for kind in dashed {
        let plain = kind.replace("-\0", "\0");
        let Some(number) = kind.find("-\0").map(|at| kind[..at].matches('\0').count()) else {
            continue;
        };
        let Some(files) = kinds.contains_key(&plain).then(|| kinds.remove(&kind)).flatten() else {
            continue;
        };
        let signed = files.into_iter().map(|mut file| {
            file.runs[number].start -= 1;
            file
        });
        kinds.entry(plain).or_default().extend(signed);
    }
}

/// Returns the pattern of files whose names differ in one decimal number, if this number must be a
/// time. It must be a time if it has an exponent in one of the names, if it follows a separator and
/// begins with `0.` in all names, or if the numbers continue from one integer to the next. The
/// numbers continue if every step across an integer is less than 1.5 times as long as the longest
/// step that crosses no integer.
fn times(files: &[&FrameCandidate]) -> Option<Pattern> {
    let first = files[0];
    let numbers: Vec<Vec<Range<usize>>> = files.iter().map(|file| file.decimals()).collect();
    let text = |file: usize, number: usize| &files[file].name[numbers[file][number].clone()];
    let all = |number: usize| (0..files.len()).map(move |file| text(file, number));
    let varies = |&number: &usize| all(number).any(|other| other != text(0, number));
    let is_fraction = |number: usize| all(number).any(|text| text.contains(['.', 'e', 'E']));
    let mut varying = (0..numbers[0].len()).filter(varies);
    let number = match (varying.next(), varying.next()) {
        (Some(number), None) => number,
        (None, _) => numbers[0].len().checked_sub(1)?,
        _ => return None,
    };
    if !is_fraction(number) {
        return None;
    }
    let pattern = || first.pattern_at(numbers[0][number].clone(), NumberKind::Times);
    if all(number).any(|text| text.contains(['e', 'E'])) {
        return Some(pattern());
    }
    let wholes: BTreeSet<&str> =
        all(number).map(|text| text.split('.').next().unwrap_or(text)).collect();
    let fractions: BTreeSet<&str> =
        all(number).map(|text| text.split_once('.').map_or("", |(_, fraction)| fraction)).collect();
    // If the numbers have different numbers of decimal places and one of them ends in 0, as in 0.9
    // and 0.10, the digits after the dot are integers, and the numbers are not decimal.
    let lengths: BTreeSet<usize> = fractions.iter().map(|fraction| fraction.len()).collect();
    if lengths.len() > 1 && fractions.iter().any(|f| f.len() > 1 && f.ends_with('0')) {
        return None;
    }
    if wholes.len() == 1 {
        let before = first.name[..numbers[0][number].start].chars().next_back();
        let follows_separator = !before.is_some_and(char::is_alphanumeric);
        return (follows_separator && wholes.contains("0")).then(pattern);
    }
    let mut values: Vec<f64> = all(number).filter_map(|text| text.parse().ok()).collect();
    values.sort_by(f64::total_cmp);
    let longest = |within: bool| {
        let pairs = values.windows(2).filter(|pair| (pair[0].floor() == pair[1].floor()) == within);
        pairs.map(|pair| pair[1] - pair[0]).fold(0.0, f64::max)
    };
    (fractions.len() > 1 && longest(false) < 1.5 * longest(true)).then(pattern)
}

/// Where the frame number is, in names that differ only in digits.
enum FrameNumber {
    /// A run of digits.
    Run(usize),
    /// The number in this pattern, which also has a placeholder for the number of a piece.
    InPieces(Pattern),
}

fn frame_number(files: &[&FrameCandidate]) -> Result<FrameNumber, SimulationError> {
    let first = files[0];
    let varies = |&run: &usize| files.iter().any(|file| file.digits(run) != first.digits(run));
    let varying: Vec<usize> = (0..first.runs.len()).filter(varies).collect();
    let Some((&last, others)) = varying.split_last() else {
        return Ok(FrameNumber::Run(first.runs.len() - 1));
    };
    match with_known_count(files, &varying) {
        Some(KnownCount { pattern, is_certain: true, .. }) => {
            return Ok(FrameNumber::InPieces(pattern));
        }
        Some(KnownCount { pattern, count, frame, .. }) => {
            return Err(SimulationError::Names(format!(
                "these files could be {count} simulations, or {count} pieces of each frame; use \
                 the input pattern \"{pattern}\" for pieces, or \"{}\" for one of the simulations",
                first.pattern(frame)
            )));
        }
        None => {}
    }
    let numbers = first.decimals();
    let is_in_decimal = |&&run: &&usize| {
        let is_part = |number: &&Range<usize>| {
            number.start <= first.runs[run].start && first.runs[run].end <= number.end
        };
        numbers.iter().find(is_part).is_some_and(|number| *number != first.runs[run])
    };
    let decimal = varying.iter().filter(|_| !others.is_empty()).find(is_in_decimal);
    if decimal.is_none() {
        match pieces(files, &varying)? {
            PiecesGuess::In(pattern) => return Ok(FrameNumber::InPieces(pattern)),
            PiecesGuess::Unlikely
                if others.is_empty() || are_parallel_simulations(files, others, last) =>
            {
                return Ok(FrameNumber::Run(last));
            }
            PiecesGuess::Unlikely | PiecesGuess::Unclear => {}
        }
    }
    let mut choices: Vec<String> = Vec::new();
    if let Some(&run) = decimal {
        let time = numbers.iter().find(|number| number.end >= first.runs[run].end);
        let time = time.map(|number| first.pattern_at(number.clone(), NumberKind::Times));
        choices.extend(time.map(|pattern| format!("\"{pattern}\"")));
    }
    choices.extend(varying.iter().map(|&run| format!("\"{}\"", first.pattern(run))));
    if let (None, [frame, piece]) = (decimal, &varying[..]) {
        choices.push(format!("\"{}\" for frames in pieces", in_pieces(first, *frame, *piece)));
    }
    let choices = choices.join(" or ");
    Err(SimulationError::Names(match decimal {
        Some(_) => format!(
            "{}: the digits in this name could be one decimal number (1_2 as 1.2) or two integers; \
             use the input pattern {choices}, where {{time}} is a decimal number",
            first.path.display()
        ),
        None => format!(
            "more than one number varies in these file names, so the frame number is ambiguous; \
             give one of the patterns {choices} as the input, or rename the files so that only the \
             frame number varies"
        ),
    }))
}

/// Texts between the number of a piece and the total number of pieces.
const COUNT_SEPARATORS: [&str; 3] = ["of", "_of_", "-of-"];
/// Texts that can stand between the number of a piece and the total number of pieces, but also
/// between other numbers.
const POSSIBLE_COUNT_SEPARATORS: [&str; 3] = ["_", "-", "."];

/// Files whose names seem to contain the number of pieces.
struct KnownCount {
    pattern: Pattern,
    count: usize,
    /// The run of digits with the frame number.
    frame: usize,
    is_certain: bool,
}

/// Finds the number of pieces in the names of files: `a_0of2_050` and `a_1of2_050` are the two
/// pieces of frame 50. `a_0_2_050` and `a_1_2_050` may be two pieces of frame 50, or frames of two
/// simulations. Every frame must have all pieces.
fn with_known_count(files: &[&FrameCandidate], varying: &[usize]) -> Option<KnownCount> {
    let (first, &[one, other]) = (files[0], varying) else { return None };
    let count = |run: usize| {
        let after = first.runs.get(run + 1).filter(|_| !varying.contains(&(run + 1)))?;
        let between = &first.name[first.runs[run].end..after.start];
        let count = first.digits(run + 1).parse::<usize>().ok().filter(|&count| count > 1)?;
        let is_certain = COUNT_SEPARATORS.contains(&between);
        (is_certain || POSSIBLE_COUNT_SEPARATORS.contains(&between)).then_some((count, is_certain))
    };
    let mut guesses = [(one, other), (other, one)].into_iter();
    guesses.find_map(|(piece, frame)| {
        let (count, is_certain) = count(piece)?;
        let mut frames: BTreeMap<&str, BTreeSet<usize>> = BTreeMap::new();
        for file in files {
            let number = file.digits(piece).parse().ok()?;
            frames.entry(file.digits(frame)).or_default().insert(number);
        }
        let is_complete = frames.values().all(|own| own.iter().copied().eq(0..count));
        let pattern = || in_pieces(first, frame, piece);
        is_complete.then(|| KnownCount { pattern: pattern(), count, frame, is_certain })
    })
}

/// Words that precede the number of a process in the name of a file. Each process writes one piece
/// of each frame.
const PROCESSES: [&str; 6] = ["rank", "proc", "procs", "process", "processor", "processors"];
/// Words directly before the number of a frame.
const FRAMES: [&str; 7] = ["t", "f", "fr", "frame", "step", "time", "it"];
/// Words that often stand before the number of a piece, but also before other numbers.
const MAY_BE_PIECES: [&str; 5] = ["p", "part", "piece", "block", "domain"];

/// Whether files are pieces of frames.
enum PiecesGuess {
    /// The files are pieces of frames with this pattern.
    In(Pattern),
    /// The files can be pieces or frames.
    Unclear,
    /// The names give no sign of pieces.
    Unlikely,
}

/// Whether a number has leading zeros, as frame numbers often do.
fn is_padded(digits: &str) -> bool {
    digits.len() > 1 && digits.starts_with('0')
}

/// Finds files that are pieces of frames, by the word before the piece's number. A word such as
/// `rank` is sufficient evidence. After a word with other uses, such as `part`, the number counts
/// as the number of a piece only if there are at most as many pieces as frames.
///
/// # Errors
/// [`SimulationError::Names`] if a word such as `rank` precedes the piece's number, and half or
/// more of the frames lack pieces, the pieces are not numbered from 0 without gaps, or this number
/// is the only number in the names.
fn pieces(files: &[&FrameCandidate], varying: &[usize]) -> Result<PiecesGuess, SimulationError> {
    let first = files[0];
    let is_called = |run: usize, words: &[&str]| {
        let before = first.name[..first.runs[run].start].trim_end_matches(['_', '-', '.', ' ']);
        let start = before
            .rfind(|c: char| !c.is_ascii_alphabetic())
            .map_or(0, |at| at + before[at..].chars().next().map_or(1, char::len_utf8));
        words.contains(&before[start..].to_ascii_lowercase().as_str())
    };
    let is_process = |&run: &usize| is_called(run, &PROCESSES);
    let (piece, frame) = match varying {
        [piece] if is_process(piece) => {
            // Only the number of the piece varies, so the frame number is the last other number in
            // the name.
            let Some(frame) = (0..first.runs.len()).rev().find(|run| run != piece) else {
                return Err(SimulationError::Names(format!(
                    "{}: the only number in this name looks like the number of a process, not of \
                     a frame; if the files are pieces of one frame, join them; if they are frames, \
                     use the input pattern \"{}\"",
                    first.path.display(),
                    first.pattern(*piece),
                )));
            };
            let before = &first.name[..first.runs[frame].start];
            let word = before.trim_end_matches(char::is_alphabetic).len();
            let word = before[word..].to_ascii_lowercase();
            if !word.is_empty() && !FRAMES.contains(&word.as_str()) {
                // In `case1_rank0`, for example, `rank0` may be a piece, or a frame of the
                // simulation `case1`.
                return Ok(PiecesGuess::Unclear);
            }
            if files.iter().any(|file| is_padded(file.digits(*piece))) {
                return Ok(PiecesGuess::Unclear);
            }
            (*piece, frame)
        }
        &[one, other] => match [one, other].map(|run| is_process(&run)) {
            [false, true] => (other, one),
            [true, false] => (one, other),
            _ => match [one, other].map(|run| is_called(run, &MAY_BE_PIECES)) {
                [false, true] => (other, one),
                [true, false] => (one, other),
                _ => return Ok(PiecesGuess::Unlikely),
            },
        },
        _ => return Ok(PiecesGuess::Unlikely),
    };
    let mut frames: BTreeMap<&str, BTreeSet<Option<usize>>> = BTreeMap::new();
    for file in files {
        frames.entry(file.digits(frame)).or_default().insert(file.digits(piece).parse().ok());
    }
    let pieces = frames.values().map(BTreeSet::len).max().unwrap_or(0);
    let counted: BTreeSet<Option<usize>> = (0..pieces).map(Some).collect();
    let is_same = frames.values().all(|own| *own == counted);
    let pattern = in_pieces(first, frame, piece);
    if is_process(&piece) {
        // If more than half of the frames have all pieces, the other frames are accepted here. They
        // fail when they are converted.
        let whole = frames.values().filter(|own| **own == counted).count();
        let is_part = |own: &BTreeSet<Option<usize>>| own.is_subset(&counted);
        if 2 * whole > frames.len() && frames.values().all(is_part) {
            return Ok(PiecesGuess::In(pattern));
        }
        let (frame, own) = frames.iter().find(|(_, own)| **own != counted).expect("one differs");
        let lacking = counted.difference(own).flatten().next();
        let lacking = lacking.map_or(String::new(), |piece| format!(" (piece {piece} is missing)"));
        return Err(SimulationError::Names(format!(
            "these files look like pieces of frames, but the pieces of frame {frame} are not \
             exactly 0 to {}{lacking}; complete or remove that frame, or use the input pattern \
             \"{pattern}\" (pieces) or \"{}\" (frames)",
            pieces - 1,
            first.pattern(varying.iter().copied().find(|run| *run != piece).unwrap_or(piece)),
        )));
    }
    Ok(if files.iter().any(|file| is_padded(file.digits(piece))) {
        PiecesGuess::Unlikely
    } else if is_same && pieces > 1 && pieces <= frames.len() {
        PiecesGuess::In(pattern)
    } else {
        PiecesGuess::Unclear
    })
}

/// The pattern of frames whose number is the run of digits `frame`, and whose pieces are numbered
/// by the run `piece`.
fn in_pieces(file: &FrameCandidate, frame: usize, piece: usize) -> Pattern {
    let mut pattern = file.pattern(frame);
    let Range { start, end } = file.runs[piece].clone();
    if piece < frame {
        pattern.prefix.replace_range(start..end, PIECE);
    } else {
        let from = file.runs[frame].end;
        pattern.suffix.replace_range(start - from..end - from, PIECE);
    }
    pattern
}

/// Whether the runs of digits in `others` distinguish simulations, and the run of digits `last` is
/// the number of the frame. There must be fewer simulations than frames in the longest one, and at
/// least half of the frame numbers of each simulation must also occur in the longest one. If all
/// simulations have the same numbers 0, 1, 2 and so on, these can be the numbers of pieces, so the
/// result is false unless the numbers are padded with zeros like frame numbers.
fn are_parallel_simulations(files: &[&FrameCandidate], others: &[usize], last: usize) -> bool {
    let mut simulations: BTreeMap<Vec<&str>, BTreeSet<&str>> = BTreeMap::new();
    for file in files {
        let simulation = others.iter().map(|&run| file.digits(run)).collect();
        simulations.entry(simulation).or_default().insert(file.digits(last));
    }
    let is_padded_longest = |file: &&FrameCandidate| {
        let text = file.digits(last);
        let longest = others.iter().map(|&run| file.digits(run).len()).max().unwrap_or(0);
        is_padded(text) && text.len() >= longest
    };
    let counts_from_zero = |numbers: &BTreeSet<&str>| {
        let counted: BTreeSet<Option<usize>> = (0..numbers.len()).map(Some).collect();
        numbers.iter().map(|number| number.parse().ok()).collect::<BTreeSet<_>>() == counted
    };
    let mut all = simulations.values();
    let is_alike =
        all.next().is_some_and(|first| counts_from_zero(first) && all.all(|own| own == first));
    if is_alike && !files.iter().any(is_padded_longest) {
        return false;
    }
    let longest = simulations.values().max_by_key(|numbers| numbers.len());
    longest.is_some_and(|longest| {
        let overlaps_longest =
            |numbers: &BTreeSet<&str>| 2 * numbers.intersection(longest).count() >= numbers.len();
        simulations.len() < longest.len() && simulations.values().all(overlaps_longest)
    })
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    fn patterns(names: &[impl AsRef<Path>]) -> Result<Vec<String>, SimulationError> {
        let files: Vec<_> = names.iter().map(|name| name.as_ref().to_owned().into()).collect();
        infer(&files).map(|patterns| patterns.iter().map(Pattern::to_string).collect())
    }

    #[test]
    fn case_numbers_are_not_pieces_and_counted_decimals_are_not_times() {
        let names = |prefix: &str, numbers: &[&str]| -> Vec<String> {
            numbers.iter().map(|number| format!("{prefix}{number}.csv")).collect()
        };
        for (prefix, numbers) in [
            ("case1_cpu_", &["0000", "0001", "0002"][..]),
            ("dam3d_mpi_", &["0", "1", "2"]),
            ("f2_pe", &["0", "1", "2"]),
        ] {
            let found = patterns(&names(prefix, numbers)).unwrap();
            assert_eq!(found, [format!("{prefix}{{}}.csv")]);
        }
        for (prefix, numbers) in
            [("case1_rank", &["0", "1", "2"][..]), ("out_0001_rank", &["0000", "0001"])]
        {
            assert!(patterns(&names(prefix, numbers)).is_err(), "{prefix}");
        }
        let counted = patterns(&names("sim_0.", &["8", "9", "10", "11"]));
        assert!(counted.is_ok_and(|found| found == ["sim_0.{}.csv"]));
        let times = patterns(&names("sim_0.", &["80", "90", "95"]));
        assert!(times.is_ok_and(|found| found == ["sim_{time}.csv"]));
    }

    #[test]
    fn the_last_number_in_a_single_file_name_is_the_frame_number() {
        for (name, pattern) in [
            ("ParticleData_Fluid_12.bgeo", "ParticleData_Fluid_{}.bgeo"),
            ("fluid.0042.bgeo.gz", "fluid.{}.bgeo"),
            ("Part_0005.bi4", "Part_{}.bi4"),
            ("run3_é7.csv", "run3_é{}.csv"),
            ("12.npy", "{}.npy"),
            ("v2.final_3.ply", "v2.final_{}.ply"),
            ("fluid.0042", "fluid.{}"),
            ("run2024_01.xyz", "run2024_{}.xyz"),
            ("0001_v2.xyz", "0001_v{}.xyz"),
        ] {
            assert_eq!(patterns(&[name]).unwrap(), [pattern]);
        }
        assert_eq!(patterns(&["fluid.bgeo", "a.h5"]).unwrap(), [""; 0]);
    }

    #[test]
    fn the_number_that_varies_is_the_frame_number() {
        for (names, pattern) in [
            (&["frame_0001_v2.ply", "frame_0002_v2.ply"][..], "frame_{}_v2.ply"),
            (&["run2024_01.xyz", "run2024_02.xyz"], "run2024_{}.xyz"),
            (&["f_10.xyz", "f_9.xyz"], "f_{}.xyz"),
            (&["0002_a.xyz", "0001_a.xyz"], "{}_a.xyz"),
            (&["1", "2", "10"], "{}"),
            (&["水_1_é3.csv", "水_2_é3.csv"], "水_{}_é3.csv"),
            (&["f_1_x3.csv.gz", "f_2_x3.csv", "f_3_x3.csv.gz"], "f_{}_x3.csv"),
            (&["a/f_1_v2.xyz", "a/f_2_v2.xyz"], "a/f_{}_v2.xyz"),
            (&["t_1.50.xyz", "t_2.50.xyz"], "t_{}.50.xyz"),
        ] {
            assert_eq!(patterns(names).unwrap(), [pattern], "{names:?}");
        }
    }

    #[test]
    fn names_from_a_random_pattern_give_back_the_pattern_in_any_order() {
        let mut state = 1_u64;
        let mut pick = |below: usize| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as usize % below
        };
        let texts = ["a", "run2024_", "é", "_v", "-", " ", "水3.", ".", "x1y22z", "_07_", "e-"];
        for _ in 0..2000 {
            let mut text =
                |from: &[&str]| (0..pick(4)).map(|_| from[pick(from.len())]).collect::<String>();
            // Allow no digits next to the number, so that it is a separate run of digits.
            let prefix = text(&texts).trim_end_matches(|c: char| c.is_ascii_digit()).to_owned();
            let middle = text(&texts).trim_start_matches(|c: char| c.is_ascii_digit()).to_owned();
            let suffix = middle + [".ply", ".bi4", ".h5", ".xyz"][pick(4)];
            let (width, first, step) = (pick(6), pick(100), 1 + pick(10));
            let mut names: Vec<String> = (0..2 + pick(12))
                .map(|i| {
                    format!("{prefix}{:0width$}{suffix}{}", first + i * step, ["", ".gz"][pick(2)])
                })
                .collect();
            for i in 0..names.len() {
                names.swap(i, pick(i + 1));
            }
            // A dash after a separator is the number's sign.
            let before = prefix
                .strip_suffix('-')
                .filter(|before| before.is_empty() || before.ends_with(['_', '.', ' ', '-']));
            let prefix = before.unwrap_or(&prefix);
            assert_eq!(patterns(&names).unwrap(), [format!("{prefix}{{}}{suffix}")], "{names:?}");
        }
    }

    #[test]
    fn another_varying_number_distinguishes_simulations() {
        let fluids = |name: fn(u32, u32) -> String, frames: [u32; 2]| {
            let names: Vec<_> = (0..2)
                .flat_map(|fluid| (frames[fluid as usize]..9).map(move |i| name(fluid, i)))
                .collect();
            patterns(&names)
        };
        let split = ["fluid0_{}.xyz", "fluid1_{}.xyz"];
        assert_eq!(fluids(|fluid, i| format!("fluid{fluid}_{i:04}.xyz"), [1, 5]).unwrap(), split);
        // The second fluid may be a restart of the first, and a version number may follow the frame
        // number.
        fluids(|fluid, i| format!("fluid{fluid}_{:04}.xyz", i + 100 * fluid), [1, 1]).unwrap_err();
        fluids(|version, i| format!("f_{i:04}_v{version}.xyz"), [1, 1]).unwrap_err();
        assert_eq!(patterns(&["f_1.xyz", "oil_1.xyz"]).unwrap(), ["f_{}.xyz", "oil_{}.xyz"]);
    }

    #[test]
    fn ambiguous_names_are_refused_with_the_possible_patterns() {
        for (names, choices) in [
            (&["run1_0001.ply", "run2_0002.ply"][..], ["\"run{}_0001.ply\"", "\"run1_{}.ply\""]),
            (&["a1_1.xyz", "a1_2.xyz", "a2_1.xyz", "a2_2.xyz"], ["\"a{}_1.xyz\"", "\"a1_{}.xyz\""]),
            (&["p_1_0.vtu", "p_1_1.vtu", "p_2_0.vtu"], ["\"p_{}_0.vtu\"", "\"p_1_{}.vtu\""]),
            (&["f_0.95.xyz", "f_1.00.xyz"], ["\"f_{time}.xyz\"", "\"f_0.{}.xyz\""]),
            (
                &["f_1.01.xyz", "f_1.02.xyz", "f_2.01.xyz", "f_2.02.xyz"],
                ["\"f_{time}.xyz\"", "\"f_1.{}.xyz\""],
            ),
            // These files can be the pieces of two frames, or the frames of two simulations.
            (
                &["a_1_0.xyz", "a_1_1.xyz", "a_1_2.xyz", "a_2_0.xyz", "a_2_1.xyz", "a_2_2.xyz"],
                ["\"a_{}_{piece}.xyz\"", "\"a_1_{}.xyz\""],
            ),
            (
                &[
                    "a_1_p0.xyz",
                    "a_1_p1.xyz",
                    "a_1_p2.xyz",
                    "a_2_p0.xyz",
                    "a_2_p1.xyz",
                    "a_2_p2.xyz",
                ],
                ["\"a_{}_p{piece}.xyz\"", "\"a_1_p{}.xyz\""],
            ),
            (
                &["a_1_rank0.xyz", "a_1_rank1.xyz", "a_2_rank0.xyz"],
                ["\"a_{}_rank{piece}.xyz\"", "\"a_{}_rank0.xyz\""],
            ),
            (&["rank0.xyz", "rank1.xyz"], ["\"rank{}.xyz\"", "join"]),
            // In `g-0_2-050`, for example, 2 may be the number of pieces.
            (
                &["g-0_2-050.xyz", "g-1_2-050.xyz", "g-0_2-100.xyz", "g-1_2-100.xyz"],
                ["\"g-{piece}_2-{}.xyz\"", "\"g-0_2-{}.xyz\""],
            ),
            (
                &["P_n0.2_01.xyz", "P_n1.2_01.xyz", "P_n0.2_02.xyz", "P_n1.2_02.xyz"],
                ["\"P_n{piece}.2_{}.xyz\"", "\"P_n0.2_{}.xyz\""],
            ),
        ] {
            let refused = patterns(names).unwrap_err().to_string();
            assert!(choices.iter().all(|choice| refused.contains(choice)), "{refused}");
        }
    }

    #[test]
    fn decimals_that_span_several_integers_are_times() {
        let quarters: Vec<_> =
            (0..12).map(|i| format!("f_{}.{:02}.xyz", i / 4, i % 4 * 25)).collect();
        assert_eq!(patterns(&quarters).unwrap(), ["f_{time}.xyz"]);
        for (names, pattern) in [
            (&["f_0.90.xyz", "f_0.95.xyz", "f_1.00.xyz"][..], "f_{time}.xyz"),
            (&["f_0.xyz", "f_0.05.xyz", "f_0.1.xyz", "f_0.15.xyz"], "f_{time}.xyz"),
            (&["f_1e-05.xyz", "f_1e-04.xyz", "f_5e-05.xyz"], "f_{time}.xyz"),
            (&["f_1.000e-02.csv", "f_2.000e-03.csv", "f_0.000e+00.csv"], "f_{time}.csv"),
            (&["f_0.05.xyz"], "f_{time}.xyz"),
            (&["v1.1001.xyz", "v1.1002.xyz"], "v1.{}.xyz"),
            (&["1.2.3.xyz", "1.2.4.xyz"], "1.2.{}.xyz"),
        ] {
            assert_eq!(patterns(names).unwrap(), [pattern], "{names:?}");
        }
        let times = Pattern::parse(Path::new("f_{time}.xyz")).unwrap().unwrap();
        for (name, digits) in [
            ("f_0.5.xyz", Some("0.5")),
            ("f_-1.5e-03.xyz", Some("-1.5e-03")),
            ("f_1.2.3.xyz", None),
        ] {
            assert_eq!(times.digits(name), digits);
        }
        for name in ["f_.xyz", "f_inf.xyz", "f_1e999.xyz", "f_+1.xyz", "f_1..xyz"] {
            assert_eq!(times.digits(name), None, "{name}");
        }
    }

    #[test]
    fn a_dash_is_a_sign_after_a_separator_or_if_other_names_lack_it() {
        for (names, pattern) in [
            (&["f_-0010.npy", "f_-0009.npy"][..], "f_{}.npy"),
            (&["f_-1.npy", "f_0.npy", "f_1.npy"], "f_{}.npy"),
            (&["f-1.npy", "f0.npy", "f1.npy"], "f{}.npy"),
            (&["f-1.npy", "f-2.npy"], "f-{}.npy"),
            (&["2024-01-05.npy", "2024-01-06.npy"], "2024-01-{}.npy"),
        ] {
            assert_eq!(patterns(names).unwrap(), [pattern], "{names:?}");
        }
    }

    #[test]
    fn a_process_number_is_a_piece_if_most_frames_have_all_pieces() {
        for (names, pattern) in [
            (&["a_1_rank0", "a_1_rank1", "a_2_rank0", "a_2_rank1"][..], "a_{}_rank{piece}"),
            (
                &["a_1_rank0", "a_1_rank1", "a_2_rank0", "a_3_rank0", "a_3_rank1"],
                "a_{}_rank{piece}",
            ),
            (&["proc_0.t7", "proc_1.t7", "proc_2.t7"], "proc_{piece}.t{}"),
            (&["a_1_p0", "a_1_p1", "a_2_p0", "a_2_p1"], "a_{}_p{piece}"),
            (&["g-0of2-050", "g-1of2-050", "g-0of2-100", "g-1of2-100"], "g-{piece}of2-{}"),
        ] {
            let names: Vec<_> = names.iter().map(|name| format!("{name}.xyz")).collect();
            assert_eq!(patterns(&names).unwrap(), [format!("{pattern}.xyz")], "{names:?}");
        }
        let pattern = Pattern::parse(Path::new("a_{}_rank{piece}.xyz")).unwrap().unwrap();
        assert_eq!(pattern.digits("a_0007_rank12.xyz"), Some("0007"));
        assert_eq!(pattern.piece("a_0007_rank12.xyz"), Some(12));
        assert_eq!(pattern.digits("a_0007_rank.xyz"), None);
        let pattern = Pattern::parse(Path::new("p{piece}_{}.xyz")).unwrap().unwrap();
        assert_eq!((pattern.digits("p3_7.xyz"), pattern.piece("p3_7.xyz")), (Some("7"), Some(3)));
    }
}

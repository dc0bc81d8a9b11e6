//! The pattern of a simulation's file names: which digits are the frame's number.
//!
//! In a pattern, `{}` stands for the frame's number, which may be negative. `{time}` stands for a
//! decimal number by which frames are ordered, and `{piece}` for the number of a piece, if a frame
//! is stored in several files. Notations of other programs also stand for the frame's number:
//! `%04d`, `####`, `$F4`, `<frame>`. If the request has no pattern, `inferred::infer` compares all
//! names to derive one.

use std::ops::Range;
use std::path::{Path, PathBuf};

use crate::error::SimulationError;
use crate::io::compression::plain_name;

use super::placeholder::{Placeholder, find_placeholders};

/// The kind of numbers in the names of frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NumberKind {
    /// Integers, which may be negative.
    Whole,
    /// Decimal numbers that are times. Frames are numbered in the order of their times.
    Times,
}

/// A file name with a placeholder for a number.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Pattern {
    /// The folder of the files.
    pub folder: PathBuf,
    /// The text before the number.
    pub prefix: String,
    /// The text after the number.
    pub suffix: String,
    /// The minimum number of digits, such as 4 for `{:04}`; shorter numbers are padded with zeros.
    pub width: Option<usize>,
    /// The kind of number.
    pub numbers: NumberKind,
}

/// The text that stands for a piece's number in a prefix or suffix.
pub(super) const PIECE: &str = "{piece}";

impl std::fmt::Display for Pattern {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { folder, prefix, suffix, numbers, .. } = self;
        let number = match numbers {
            NumberKind::Whole => "{}",
            NumberKind::Times => "{time}",
        };
        folder.join(format!("{prefix}{number}{suffix}")).display().fmt(f)
    }
}

impl Pattern {
    /// Finds the placeholder for the number in the name of `path`: `{}`, `{:04}`, `{time}`, or
    /// another program's notation. Returns `None` if the name has no such placeholder, or if the
    /// placeholder is in another program's notation and a file with exactly this name exists.
    ///
    /// # Errors
    /// [`SimulationError::Names`] if the name has more than one placeholder or an unknown notation,
    /// if the name of a folder that does not exist has a placeholder, or if `{piece}` occurs
    /// without another placeholder or directly next to it.
    pub fn parse(path: &Path) -> Result<Option<Self>, SimulationError> {
        let wrong = |what: &str| Err(SimulationError::Names(format!("{}: {what}", path.display())));
        let Some(name) = path.file_name().and_then(|name| name.to_str()) else { return Ok(None) };
        let folder = path.parent().unwrap_or(Path::new(""));
        let in_folder = folder.iter().filter_map(|name| name.to_str());
        if in_folder.flat_map(find_placeholders).next().is_some() && !folder.is_dir() {
            return wrong("{} must be in the file name, not in the name of a folder");
        }
        let (pieces, mut found): (Vec<_>, Vec<_>) = find_placeholders(name)
            .into_iter()
            .partition(|(_, placeholder)| *placeholder == Placeholder::Piece);
        let has_braces = |(at, _): &(Range<usize>, Placeholder)| name[at.start..].starts_with('{');
        if !found.iter().all(has_braces) && path.is_file() {
            return Ok(None);
        }
        if found.len() > 1 || pieces.len() > 1 {
            return wrong("a name can contain only one {} and one {piece}");
        }
        let Some((at, placeholder)) = found.pop() else {
            let lacks = "{piece} stands for the number of a piece; add {} for the frame number";
            return if pieces.is_empty() { Ok(None) } else { wrong(lacks) };
        };
        let (prefix, suffix) = (&name[..at.start], &name[at.end..]);
        if prefix.ends_with(PIECE) || suffix.starts_with(PIECE) {
            return wrong("there must be text between {} and {piece}");
        }
        let (width, numbers) = match placeholder {
            Placeholder::Number(width) => (width, NumberKind::Whole),
            Placeholder::Time | Placeholder::Piece => (None, NumberKind::Times),
            Placeholder::Unknown(better) => {
                let suggested = folder.join(format!("{prefix}{better}{suffix}"));
                return wrong(&format!(
                    "{} does not stand for the frame number; use {{}}, or {{:04}} for four digits, \
                     as in \"{}\"",
                    &name[at],
                    suggested.display()
                ));
            }
        };
        let (prefix, suffix) = (prefix.to_owned(), suffix.to_owned());
        Ok(Some(Self { folder: folder.to_owned(), prefix, suffix, width, numbers }))
    }

    /// Whether the pattern contains `{piece}`, so that a frame may consist of several files.
    pub(super) fn has_pieces(&self) -> bool {
        self.prefix.contains(PIECE) || self.suffix.contains(PIECE)
    }

    /// The byte range of the number in a name; `None` if the name does not match the pattern.
    pub(super) fn number_range(&self, name: &str) -> Option<Range<usize>> {
        let digits =
            |text: &str| text.len() - text.trim_start_matches(|c: char| c.is_ascii_digit()).len();
        let start = match self.prefix.split_once(PIECE) {
            None => name.starts_with(&*self.prefix).then_some(self.prefix.len())?,
            Some((before, after)) => {
                let rest = name.strip_prefix(before)?;
                let piece = digits(rest);
                (piece > 0 && rest[piece..].starts_with(after))
                    .then_some(before.len() + piece + after.len())?
            }
        };
        let rest = &name[start..];
        let end = match self.suffix.split_once(PIECE) {
            None => rest.strip_suffix(&*self.suffix)?.len(),
            Some((before, after)) => {
                let rest = rest.strip_suffix(after)?;
                let number = rest.trim_end_matches(|c: char| c.is_ascii_digit());
                (number.len() < rest.len()).then(|| number.strip_suffix(before))??.len()
            }
        };
        let number = &rest[..end];
        let plain = number.strip_prefix('-').unwrap_or(number);
        let padded = |width: usize| {
            let spelled = [plain.len(), number.len()];
            spelled.contains(&width) || plain.len() > width && !plain.starts_with('0')
        };
        let fits = match self.numbers {
            NumberKind::Whole => all_digits(plain) && self.width.is_none_or(padded),
            NumberKind::Times => is_decimal(number),
        };
        fits.then_some(start..start + end)
    }

    /// The digits of the number in a matching name, with the sign.
    pub(super) fn digits<'a>(&self, name: &'a str) -> Option<&'a str> {
        self.number_range(name).map(|range| &name[range])
    }

    /// The number of the piece in a matching name; 0 for frames without pieces.
    pub(super) fn piece(&self, name: &str) -> Option<u64> {
        let range = self.number_range(name)?;
        let text = match (self.prefix.split_once(PIECE), self.suffix.split_once(PIECE)) {
            (Some((before, after)), _) => &name[before.len()..range.start - after.len()],
            (None, Some((before, after))) => {
                &name[range.end + before.len()..name.len() - after.len()]
            }
            (None, None) => return Some(0),
        };
        text.parse().ok()
    }

    /// The folder of the files, `.` if the pattern has none.
    pub fn folder(&self) -> &Path {
        if self.folder.as_os_str().is_empty() { Path::new(".") } else { &self.folder }
    }

    /// Returns the path for a number, which is written as `digits` if the pattern has no width.
    pub fn path(&self, number: i64, digits: &str) -> PathBuf {
        let Self { folder, prefix, suffix, width, .. } = self;
        folder.join(match width {
            Some(width) => format!("{prefix}{number:0width$}{suffix}"),
            None => format!("{prefix}{digits}{suffix}"),
        })
    }
}

/// Whether a name has placeholders, and all of them are in the notations of other programs.
pub(super) fn is_foreign(path: &Path) -> bool {
    let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    let placeholders = find_placeholders(name);
    let is_foreign = |(at, _): &(Range<usize>, Placeholder)| !name[at.start..].starts_with('{');
    !placeholders.is_empty() && placeholders.iter().all(is_foreign)
}

pub(super) fn all_digits(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit())
}

/// Whether a text is a finite decimal number, such as a time in a file's name.
fn is_decimal(text: &str) -> bool {
    let spelled = text.bytes().all(|b| b.is_ascii_digit() || b"+-.eE".contains(&b));
    let ends = text.ends_with(|c: char| c.is_ascii_digit())
        && text.trim_start_matches('-').starts_with(|c: char| c.is_ascii_digit());
    spelled && ends && text.parse().is_ok_and(f64::is_finite)
}

/// The runs of digits in a text.
pub(super) fn digit_runs(text: &str) -> Vec<Range<usize>> {
    let mut runs: Vec<Range<usize>> = Vec::new();
    for (at, _) in text.bytes().enumerate().filter(|(_, byte)| byte.is_ascii_digit()) {
        match runs.last_mut() {
            Some(run) if run.end == at => run.end += 1,
            _ => runs.push(at..at + 1),
        }
    }
    runs
}

/// Replaces each of the `runs` of digits with a zero byte. Texts that differ only in the replaced
/// digits have the same skeleton.
pub(super) fn skeleton(text: &str, runs: &[Range<usize>]) -> String {
    let mut skeleton = text.to_owned();
    // No file name contains a zero byte.
    runs.iter().rev().for_each(|run| skeleton.replace_range(run.clone(), "\0"));
    skeleton
}

/// A name without its extension. Digits are not an extension: `fluid.0042` is frame 42.
pub(super) fn stem(name: &str) -> &str {
    let plain = plain_name(name);
    match plain.rsplit_once('.') {
        Some((stem, extension)) if !all_digits(extension) => stem,
        _ => plain,
    }
}

/// A file that may be a frame.
#[derive(Debug, Clone)]
pub(super) struct FrameCandidate {
    /// The file.
    pub(super) path: PathBuf,
    /// The file's name without `.gz` and similar endings, so that compressed and uncompressed
    /// frames have the same pattern.
    pub(super) name: String,
    /// The runs of digits before the extension, with their signs. Each of them may be the frame's
    /// number.
    pub(super) runs: Vec<Range<usize>>,
}

impl From<PathBuf> for FrameCandidate {
    fn from(path: PathBuf) -> Self {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let name = plain_name(&name).to_owned();
        let mut runs = digit_runs(stem(&name));
        for run in &mut runs {
            // A dash after a letter or a digit separates two parts of a name, so it is not a sign.
            let sign = name[..run.start].strip_suffix('-');
            let signs = |before: &str| {
                before.is_empty() || before.ends_with(['_', '.', ' ', '-', '=', '(', '['])
            };
            run.start -= usize::from(sign.is_some_and(signs));
        }
        Self { runs, path, name }
    }
}

impl FrameCandidate {
    /// The name with a zero byte for each number. It is the same for all files whose names differ
    /// only in their numbers.
    pub(super) fn skeleton(&self) -> String {
        skeleton(&self.name, &self.runs)
    }

    pub(super) fn digits(&self, run: usize) -> &str {
        &self.name[self.runs[run].clone()]
    }

    /// The pattern of the names that differ from this name only in the run of digits with index
    /// `run`.
    pub(super) fn pattern(&self, run: usize) -> Pattern {
        self.pattern_at(self.runs[run].clone(), NumberKind::Whole)
    }

    pub(super) fn pattern_at(
        &self,
        Range { start, end }: Range<usize>,
        numbers: NumberKind,
    ) -> Pattern {
        let folder = self.path.parent().unwrap_or(Path::new("")).to_owned();
        let [prefix, suffix] = [&self.name[..start], &self.name[end..]].map(str::to_owned);
        Pattern { folder, prefix, suffix, width: None, numbers }
    }

    /// The numbers in the name. A decimal number such as `0.95` or `1e-05` counts as one number,
    /// and a version such as `1.2.3` as three.
    pub(super) fn decimals(&self) -> Vec<Range<usize>> {
        let between = |run: usize| {
            self.runs.get(run + 1).map(|next| &self.name[self.runs[run].end..next.start])
        };
        let is_dot =
            |run: usize| between(run) == Some(".") && !self.digits(run + 1).starts_with('-');
        let is_exponent = |run: usize| {
            between(run).is_some_and(|text| matches!(text, "e" | "E" | "e-" | "E-" | "e+" | "E+"))
        };
        let (mut numbers, mut run) = (Vec::new(), 0);
        while run < self.runs.len() {
            let mut last = run;
            if is_dot(run) && !is_dot(run + 1) && !(run > 0 && is_dot(run - 1)) {
                last += 1;
            }
            if is_exponent(last) && (last > run || between(last).is_some_and(|text| text.len() > 1))
            {
                last += 1;
            }
            numbers.push(self.runs[run].start..self.runs[last].end);
            run = last + 1;
        }
        numbers
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pattern_matches_exactly_the_names_that_it_writes() {
        let padded = Pattern::parse(Path::new("a/x_{:04}.ply")).unwrap().unwrap();
        assert_eq!(padded.path(42, "42"), Path::new("a/x_0042.ply"));
        assert_eq!(padded.digits("x_0042.ply"), Some("0042"));
        assert_eq!(padded.digits("x_12345.ply"), Some("12345"));
        assert_eq!((padded.digits("x_42.ply"), padded.digits("x_01234567.ply")), (None, None));
        assert_eq!(padded.path(-42, "-42"), Path::new("a/x_-042.ply"));
        for (name, fits) in [("x_-042.ply", true), ("x_-0042.ply", true), ("x_-42.ply", false)] {
            assert_eq!(padded.digits(name).is_some(), fits, "{name}");
        }
        let plain = Pattern::parse(Path::new("x{}")).unwrap().unwrap();
        assert_eq!(plain.path(42, "0042"), Path::new("x0042"));
        assert_eq!(
            (plain.digits("x"), plain.digits("x4a"), plain.digits("x007")),
            (None, None, Some("007"))
        );
        for wrong in [
            "x_{}_{}.ply",
            "x_{:4}.ply",
            "x_{n}.ply",
            "a_{}/x_{}.ply",
            "x_{piece}.ply",
            "x_{}{piece}.ply",
            "x_{}_{piece:}.ply",
        ] {
            Pattern::parse(Path::new(wrong)).unwrap_err();
        }
        assert_eq!(Pattern::parse(Path::new("x.ply")).unwrap(), None);
    }
}

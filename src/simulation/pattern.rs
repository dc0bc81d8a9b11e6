//! The pattern of the names of a simulation's files: which digits are the frame's number.
//!
//! `{}` in a name says where the number is. Without it, [`infer`] finds the pattern from all names
//! together: the number that varies is the frame's. Names that leave a choice are refused, with the
//! patterns to choose from.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::path::{Path, PathBuf};

use crate::error::SimulationError;
use crate::io::compression::plain_name;

/// A file name with a place for a number.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Pattern {
    /// The folder of the files.
    pub folder: PathBuf,
    /// Before the number.
    pub prefix: String,
    /// After the number.
    pub suffix: String,
    /// The least number of digits, where `{:04}` says so; padded with zeros.
    pub width: Option<usize>,
}

impl std::fmt::Display for Pattern {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { folder, prefix, suffix, .. } = self;
        folder.join(format!("{prefix}{{}}{suffix}")).display().fmt(f)
    }
}

impl Pattern {
    /// Reads `{}` or `{:04}` in the name of `path`; `None` where there is none.
    ///
    /// # Errors
    /// [`SimulationError::Names`] for more than one, one in a folder's name, or braces that say
    /// something else.
    pub fn parse(path: &Path) -> Result<Option<Self>, SimulationError> {
        let wrong = |what: &str| Err(SimulationError::Names(format!("{}: {what}", path.display())));
        let Some(name) = path.file_name().and_then(|name| name.to_str()) else { return Ok(None) };
        let folder = path.parent().unwrap_or(Path::new(""));
        if folder.to_string_lossy().contains("{}") {
            return wrong("{} stands for the number in a file's name, not in a folder's");
        }
        let Some((prefix, rest)) = name.split_once('{') else { return Ok(None) };
        let Some((inside, suffix)) = rest.split_once('}') else { return Ok(None) };
        if suffix.contains('{') {
            return wrong("one {} is enough");
        }
        let width = match inside {
            "" => None,
            _ => match inside.strip_prefix(":0").and_then(|width| width.parse().ok()) {
                Some(width @ 1..=20) => Some(width),
                _ => {
                    return wrong(
                        "a frame's number is written {} or, padded to four digits, {:04}",
                    );
                }
            },
        };
        let (prefix, suffix) = (prefix.to_owned(), suffix.to_owned());
        Ok(Some(Self { folder: folder.to_owned(), prefix, suffix, width }))
    }

    /// The digits of a name that fits.
    pub(super) fn digits<'a>(&self, name: &'a str) -> Option<&'a str> {
        let digits = name.strip_prefix(&*self.prefix)?.strip_suffix(&*self.suffix)?;
        let padded = |width: usize| {
            digits.len() == width || digits.len() > width && !digits.starts_with('0')
        };
        let fits = all_digits(digits) && self.width.is_none_or(padded);
        fits.then_some(digits)
    }

    /// The folder of the files, where no name means the current one.
    pub fn folder(&self) -> &Path {
        if self.folder.as_os_str().is_empty() { Path::new(".") } else { &self.folder }
    }

    /// The name for a number, spelled `digits` where no width is given.
    pub fn path(&self, number: u64, digits: &str) -> PathBuf {
        let Self { folder, prefix, suffix, width } = self;
        folder.join(match width {
            Some(width) => format!("{prefix}{number:0width$}{suffix}"),
            None => format!("{prefix}{digits}{suffix}"),
        })
    }
}

pub(super) fn all_digits(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit())
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

/// A text without the digits of these runs: two texts have the same skeleton if they differ in
/// those digits only.
pub(super) fn skeleton(text: &str, runs: &[Range<usize>]) -> String {
    let mut skeleton = text.to_owned();
    // No file's name has a zero byte.
    runs.iter().rev().for_each(|run| skeleton.replace_range(run.clone(), "\0"));
    skeleton
}

/// A name without its extension. Digits are no extension: `fluid.0042` is frame 42.
pub(super) fn stem(name: &str) -> &str {
    let plain = plain_name(name);
    match plain.rsplit_once('.') {
        Some((stem, extension)) if !all_digits(extension) => stem,
        _ => plain,
    }
}

/// A file that may be a frame.
#[derive(Debug, Clone)]
pub(super) struct Candidate {
    /// The file.
    pub(super) path: PathBuf,
    /// The file's name without `.gz` or the like: a compressed frame belongs to the
    /// others.
    pub(super) name: String,
    /// The digits of the name that may be the frame's number, before the extension.
    pub(super) runs: Vec<Range<usize>>,
}

impl From<PathBuf> for Candidate {
    fn from(path: PathBuf) -> Self {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let name = plain_name(&name).to_owned();
        Self { runs: digit_runs(stem(&name)), path, name }
    }
}

impl Candidate {
    /// The text that all files of the same kind share, whatever their numbers.
    pub(super) fn skeleton(&self) -> String {
        skeleton(&self.name, &self.runs)
    }

    fn digits(&self, run: usize) -> &str {
        &self.name[self.runs[run].clone()]
    }

    /// The pattern of the names that differ from this one in a run of digits.
    pub(super) fn pattern(&self, run: usize) -> Pattern {
        let Range { start, end } = self.runs[run];
        let folder = self.path.parent().unwrap_or(Path::new("")).to_owned();
        let [prefix, suffix] = [&self.name[..start], &self.name[end..]].map(str::to_owned);
        Pattern { folder, prefix, suffix, width: None }
    }
}

/// Infers the patterns of files, one for each simulation. Files without a number are ignored.
///
/// Names that differ in text besides numbers belong to different simulations. Among the others the
/// number that varies is the frame's; of a single file it is the last one. Where several numbers
/// vary, the last is the frame's if the others tell simulations apart that ran side by side.
///
/// # Errors
/// [`SimulationError::Names`] where several numbers could be the frame's.
pub(super) fn infer(files: &[Candidate]) -> Result<Vec<Pattern>, SimulationError> {
    let mut kinds: BTreeMap<String, Vec<&Candidate>> = BTreeMap::new();
    for file in files.iter().filter(|file| !file.runs.is_empty()) {
        kinds.entry(file.skeleton()).or_default().push(file);
    }
    let mut found: BTreeMap<[String; 2], Pattern> = BTreeMap::new();
    for mut files in kinds.into_values() {
        files.sort_by(|a, b| a.path.cmp(&b.path));
        let run = frame_run(&files)?;
        for file in files {
            let pattern = file.pattern(run);
            let key = [&pattern.prefix, &pattern.suffix].map(String::clone);
            found.entry(key).or_insert(pattern);
        }
    }
    Ok(found.into_values().collect())
}

/// The run of digits that is the frame's number, in files that differ in digits only.
fn frame_run(files: &[&Candidate]) -> Result<usize, SimulationError> {
    let first = files[0];
    let varies = |&run: &usize| files.iter().any(|file| file.digits(run) != first.digits(run));
    let varying: Vec<usize> = (0..first.runs.len()).filter(varies).collect();
    let Some((&last, others)) = varying.split_last() else { return Ok(first.runs.len() - 1) };
    // The digits of 0.95 or 1e-05 are one number in two runs.
    let is_joint = |text: &str| matches!(text, "." | "e" | "E" | "e-" | "E-" | "e+" | "E+");
    let joins = |&&run: &&usize| {
        varying.contains(&(run + 1))
            && is_joint(&first.name[first.runs[run].end..first.runs[run + 1].start])
    };
    let decimal = others.iter().find(joins);
    if others.is_empty() || decimal.is_none() && side_by_side(files, others, last) {
        return Ok(last);
    }
    let patterns: Vec<_> =
        varying.iter().map(|&run| format!("\"{}\"", first.pattern(run))).collect();
    let patterns = patterns.join(" or ");
    Err(SimulationError::Names(match decimal {
        Some(&run) => {
            let number = &first.name[first.runs[run].start..first.runs[run + 1].end];
            format!(
                "{}: {number} looks like a decimal, and frames have whole numbers; rename the files, or name some of them with \
                 {patterns}",
                first.path.display()
            )
        }
        None => format!(
            "more than one number varies in these names: frames could be numbered by {patterns}; give one of these patterns as the \
             input, or rename the files so that only the frame's number varies"
        ),
    }))
}

/// Whether the runs in `others` tell simulations apart whose frames are numbered by the run `last`:
/// fewer simulations than frames, and at least half of the numbers of each are also those of the
/// longest.
fn side_by_side(files: &[&Candidate], others: &[usize], last: usize) -> bool {
    let mut simulations: BTreeMap<Vec<&str>, BTreeSet<&str>> = BTreeMap::new();
    for file in files {
        let simulation = others.iter().map(|&run| file.digits(run)).collect();
        simulations.entry(simulation).or_default().insert(file.digits(last));
    }
    let longest = simulations.values().max_by_key(|numbers| numbers.len());
    longest.is_some_and(|longest| {
        let is_beside =
            |numbers: &BTreeSet<&str>| 2 * numbers.intersection(longest).count() >= numbers.len();
        simulations.len() < longest.len() && simulations.values().all(is_beside)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn patterns(names: &[impl AsRef<Path>]) -> Result<Vec<String>, SimulationError> {
        let files: Vec<_> = names.iter().map(|name| name.as_ref().to_owned().into()).collect();
        infer(&files).map(|patterns| patterns.iter().map(Pattern::to_string).collect())
    }

    #[test]
    fn of_a_single_file_the_last_number_before_the_extension_is_the_frame_s() {
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
    fn the_number_that_varies_is_the_frame_s_wherever_it_is() {
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
    fn names_of_a_random_pattern_give_that_pattern_in_any_order() {
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
            // The number is a run of its own.
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
            assert_eq!(patterns(&names).unwrap(), [format!("{prefix}{{}}{suffix}")], "{names:?}");
        }
    }

    #[test]
    fn another_number_tells_simulations_apart_that_ran_side_by_side() {
        let fluids = |name: fn(u32, u32) -> String, frames: [u32; 2]| {
            let names: Vec<_> = (0..2)
                .flat_map(|fluid| (frames[fluid as usize]..9).map(move |i| name(fluid, i)))
                .collect();
            patterns(&names)
        };
        let split = ["fluid0_{}.xyz", "fluid1_{}.xyz"];
        assert_eq!(fluids(|fluid, i| format!("fluid{fluid}_{i:04}.xyz"), [1, 5]).unwrap(), split);
        // One is the other's restart, or a version stands behind the number.
        fluids(|fluid, i| format!("fluid{fluid}_{:04}.xyz", i + 100 * fluid), [1, 1]).unwrap_err();
        fluids(|version, i| format!("f_{i:04}_v{version}.xyz"), [1, 1]).unwrap_err();
        assert_eq!(patterns(&["f_1.xyz", "oil_1.xyz"]).unwrap(), ["f_{}.xyz", "oil_{}.xyz"]);
    }

    #[test]
    fn names_that_leave_a_choice_are_refused_with_the_patterns() {
        for (names, choices) in [
            (&["run1_0001.ply", "run2_0002.ply"][..], ["\"run{}_0001.ply\"", "\"run1_{}.ply\""]),
            (&["a1_1.xyz", "a1_2.xyz", "a2_1.xyz", "a2_2.xyz"], ["\"a{}_1.xyz\"", "\"a1_{}.xyz\""]),
            (&["p_1_0.vtu", "p_1_1.vtu", "p_2_0.vtu"], ["\"p_{}_0.vtu\"", "\"p_1_{}.vtu\""]),
            (&["f_0.90.xyz", "f_0.95.xyz", "f_1.00.xyz"], ["\"f_{}.90.xyz\"", "\"f_0.{}.xyz\""]),
            (
                &["f_1e-05.xyz", "f_1e-04.xyz", "f_5e-05.xyz"],
                ["\"f_{}e-04.xyz\"", "\"f_1e-{}.xyz\""],
            ),
        ] {
            let refused = patterns(names).unwrap_err().to_string();
            assert!(choices.iter().all(|choice| refused.contains(choice)), "{refused}");
        }
        // Four numbers side by side in three whole ones are no simulations.
        let times: Vec<_> = (0..12).map(|i| format!("f_{}.{:02}.xyz", i / 4, i % 4 * 25)).collect();
        assert!(patterns(&times).unwrap_err().to_string().contains("0.00 looks like a decimal"));
    }

    #[test]
    fn a_pattern_matches_what_it_writes() {
        let padded = Pattern::parse(Path::new("a/x_{:04}.ply")).unwrap().unwrap();
        assert_eq!(padded.path(42, "42"), Path::new("a/x_0042.ply"));
        assert_eq!(padded.digits("x_0042.ply"), Some("0042"));
        assert_eq!(padded.digits("x_12345.ply"), Some("12345"));
        assert_eq!((padded.digits("x_42.ply"), padded.digits("x_01234567.ply")), (None, None));
        let plain = Pattern::parse(Path::new("x{}")).unwrap().unwrap();
        assert_eq!(plain.path(42, "0042"), Path::new("x0042"));
        assert_eq!(
            (plain.digits("x"), plain.digits("x4a"), plain.digits("x007")),
            (None, None, Some("007"))
        );
        for wrong in ["x_{}_{}.ply", "x_{:4}.ply", "x_{n}.ply", "a_{}/x_{}.ply"] {
            Pattern::parse(Path::new(wrong)).unwrap_err();
        }
        assert_eq!(Pattern::parse(Path::new("x.ply")).unwrap(), None);
    }
}

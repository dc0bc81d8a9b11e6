//! The files that are the frames of a simulation, and their order.
//!
//! A frame has a number. `{}` in a name says where it stands, padded or not; otherwise it is the last digits of the
//! name before its extensions. Order is that of the numbers.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use glob::MatchOptions;

use crate::io::frame_files::{files_of, snapshot_piece};
use crate::io::input::{holds_mesh, is_known, steps};

use crate::error::{Error, SimulationError};

use super::numbers::{Family, Pattern, split_number};
use super::pieces::{Whole, may_be_piece, whole_frames};

/// How long it may be from a piece of a frame to the file that names it.
const PATIENCE: Duration = Duration::from_secs(300);

/// One frame, as found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FrameFile {
    /// The frame's number.
    pub number: u64,
    /// The number as the name spells it.
    pub digits: String,
    /// The file.
    pub path: PathBuf,
}

/// A way to find the frames, which can be asked again as they come.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Inputs {
    /// A name with `{}` for the number.
    Pattern(Pattern),
    /// All that we read in a folder.
    Folder(PathBuf),
    /// Files of a folder or a glob whose names differ in their numbers alone.
    Part {
        /// All of them.
        of: Box<Self>,
        /// The names that tell them from other files.
        family: Family,
    },
    /// Frames of a folder or a glob that come while a simulation runs: what may be a piece of one that is not there yet is none, until it
    /// has not changed for so long.
    Followed {
        /// All of them.
        of: Box<Self>,
        /// How long.
        patience: Duration,
    },
    /// Frames in one file.
    Steps(PathBuf),
    /// A pattern that a shell would expand.
    Glob(String),
    /// Files that are named one by one.
    Files(Vec<PathBuf>),
}

impl Inputs {
    /// Reads the arguments as a simulation; `None` where they name one file.
    ///
    /// # Errors
    /// [`SimulationError::Names`] for a pattern that cannot be one.
    pub fn of(arguments: &[PathBuf]) -> Result<Option<Self>, SimulationError> {
        let [path] = arguments else { return Ok(Some(Self::Files(arguments.to_vec()))) };
        if path.is_file() {
            // A file that cannot be read is told of as a single frame.
            let several = steps(path).is_ok_and(|steps| steps.len() > 1);
            return Ok(several.then(|| Self::Steps(path.clone())));
        }
        if path.is_dir() {
            return Ok(Some(Self::Folder(path.clone())));
        }
        if let Some(pattern) = Pattern::parse(path)? {
            return Ok(Some(Self::Pattern(pattern)));
        }
        let text = path.to_string_lossy();
        Ok(text.contains(['*', '?', '[']).then(|| Self::Glob(text.into_owned())))
    }

    /// Looks at the frames as they come, for so many seconds without news.
    #[must_use]
    pub fn followed(self, idle: f64) -> Self {
        let patience = Duration::try_from_secs_f64(idle).unwrap_or(PATIENCE).min(PATIENCE);
        match self {
            Self::Folder(_) | Self::Glob(_) => Self::Followed { of: Box::new(self), patience },
            other => other,
        }
    }

    /// Returns the inputs in the words of the request.
    #[must_use]
    pub fn describe(&self) -> String {
        match self {
            Self::Pattern(Pattern { folder, prefix, suffix, .. }) => {
                folder.join(format!("{prefix}{{}}{suffix}")).display().to_string()
            }
            Self::Folder(folder) => folder.display().to_string(),
            Self::Part { of, family } => match &**of {
                Self::Folder(folder) => folder.join(family.to_string()).display().to_string(),
                all => all.describe(),
            },
            Self::Followed { of, .. } => of.describe(),
            Self::Steps(file) => file.display().to_string(),
            Self::Glob(pattern) => pattern.clone(),
            Self::Files(files) => files.first().map_or(String::new(), |file| file.display().to_string()),
        }
    }

    /// The frames that are there now, in order.
    ///
    /// # Errors
    /// [`SimulationError::Io`] for a folder that cannot be read, [`SimulationError::Names`] where two files are the same
    /// frame, [`SimulationError::Several`] where the files are of several simulations.
    pub fn list(&self) -> Result<Vec<FrameFile>, SimulationError> {
        let mut frames = self.found()?;
        let families = self.families(&frames);
        if families.len() > 1 {
            let each = families.iter().map(|(family, files)| format!("{family} ({})", files.len()));
            let families = each.collect::<Vec<_>>().join(", ");
            return Err(SimulationError::Several { from: self.describe(), families });
        }
        frames.sort_by(|a: &FrameFile, b| (a.number, &a.path).cmp(&(b.number, &b.path)));
        if let Some(family) = families.keys().next() {
            refuse_decimals(family, &frames)?;
        }
        if let Some((a, b)) = neighbours(&frames).find(|(a, b)| a.number == b.number) {
            return Err(SimulationError::Names(format!(
                "{} and {} are both frame {}; name one simulation, with {{}} for its numbers",
                a.path.display(),
                b.path.display(),
                a.number
            )));
        }
        Ok(frames)
    }

    /// The simulations that the files belong to, told by their names: of a scene with several fluids each is one. Of a folder that
    /// holds particles, meshes are none, whoever made them.
    ///
    /// # Errors
    /// As [`list`](Self::list), but for several.
    pub fn simulations(&self) -> Result<Vec<Self>, SimulationError> {
        let mut families = self.families(&self.found()?);
        let all = families.len();
        let own = if let Self::Followed { of, .. } = self { &**of } else { self };
        if let Self::Folder(folder) = own {
            // What cannot be read is told of when its turn comes.
            let is_mesh = |file: &PathBuf| holds_mesh(file).unwrap_or(false);
            families.retain(|_, files| !files.first().is_some_and(is_mesh));
            if families.len() < all.min(1) {
                return Err(SimulationError::Names(format!(
                    "{}: holds meshes and no particles",
                    folder.display()
                )));
            }
        }
        if all < 2 {
            return Ok(vec![self.clone()]);
        }
        let part = |(family, files): (Family, Vec<PathBuf>)| match own {
            Self::Folder(_) => Self::Part { of: Box::new(self.clone()), family },
            _ => Self::Files(files),
        };
        Ok(families.into_iter().map(part).collect())
    }

    /// Leaves out whatever comes to be in its folder and is named otherwise than `first`, such as the meshes that are made.
    #[must_use]
    pub fn like(&self, first: &FrameFile) -> Self {
        match self {
            Self::Folder(_) | Self::Glob(_) => {
                Self::Part { of: Box::new(self.clone()), family: first.family() }
            }
            // What belongs to the first frame's simulation is a frame at once.
            Self::Followed { of, .. } => of.like(first),
            _ => self.clone(),
        }
    }

    /// Whether a file would be taken for a frame if it were there.
    #[must_use]
    pub fn takes(&self, path: &Path) -> bool {
        let named = |path: &Path| {
            path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
        };
        let is_in = |folder: &Path| {
            let whole = |folder: &Path| match folder.as_os_str().is_empty() {
                true => Path::new(".").canonicalize(),
                false => folder.canonicalize(),
            };
            path.parent()
                .and_then(|parent| whole(parent).ok())
                .is_some_and(|own| whole(folder).is_ok_and(|f| f == own))
        };
        match self {
            Self::Pattern(pattern) => is_in(&pattern.folder) && pattern.digits(&named(path)).is_some(),
            Self::Folder(folder) => is_in(folder) && is_known(path),
            Self::Glob(pattern) => {
                // What stands for several letters stands for no folder, as where files are looked for.
                let in_one_folder = MatchOptions { require_literal_separator: true, ..MatchOptions::new() };
                glob::Pattern::new(pattern)
                    .is_ok_and(|pattern| pattern.matches_path_with(path, in_one_folder))
            }
            Self::Part { of, family } => {
                of.takes(path)
                    && by_last_digits(path.to_owned().into())
                        .is_some_and(|frame| frame.is_ok_and(|f| f.family() == *family))
            }
            Self::Followed { of, .. } => of.takes(path),
            Self::Steps(_) | Self::Files(_) => false,
        }
    }

    /// The files of each simulation. A pattern, or a file of steps, says itself what belongs together.
    fn families(&self, frames: &[FrameFile]) -> BTreeMap<Family, Vec<PathBuf>> {
        let mut families: BTreeMap<Family, Vec<PathBuf>> = BTreeMap::new();
        for frame in frames.iter().filter(|_| !matches!(self, Self::Pattern(_) | Self::Steps(_))) {
            families.entry(frame.family()).or_default().push(frame.path.clone());
        }
        families
    }

    /// The frames that are there now, in any order.
    fn found(&self) -> Result<Vec<FrameFile>, SimulationError> {
        Ok(match self {
            Self::Pattern(pattern) => {
                let number = |path: PathBuf| {
                    let digits = pattern.digits(path.file_name()?.to_str()?)?.to_owned();
                    Some(frame(digits, path))
                };
                let folder = Some(&*pattern.folder).filter(|folder| !folder.as_os_str().is_empty());
                let here = folder.is_none();
                let files = files_in(folder.unwrap_or(Path::new(".")))?.into_iter();
                let named = |path: PathBuf| {
                    if here { path.file_name().map_or_else(PathBuf::new, Into::into) } else { path }
                };
                files.map(named).filter_map(number).collect::<Result<_, _>>()?
            }
            Self::Folder(folder) => {
                // A folder holds other things too: what has no number is no frame.
                let known = files_in(folder)?.into_iter().filter(|path| is_known(path)).collect();
                whole_frames(known).into_iter().filter_map(by_last_digits).collect::<Result<_, _>>()?
            }
            Self::Part { of, family } => {
                let mut frames = of.found()?;
                frames.retain(|frame| frame.family() == *family);
                frames
            }
            Self::Followed { of, patience } => {
                let mut frames = of.found()?;
                frames.retain(|frame| !may_be_piece(&frame.path) || rests(&frame.path, *patience));
                frames
            }
            Self::Steps(file) => {
                let frame = |number: u64| FrameFile {
                    number,
                    digits: number.to_string(),
                    path: PathBuf::from(format!("{}#{number}", file.display())),
                };
                let steps = steps(file).map_err(|e| SimulationError::Names(e.to_string()))?;
                steps.into_iter().map(frame).collect()
            }
            Self::Glob(pattern) => {
                let fail = |e: glob::PatternError| SimulationError::Names(format!("{pattern}: {e}"));
                glob::Pattern::new(pattern).map_err(fail)?;
                let paths = glob::glob(&below(pattern)).map_err(fail)?.filter_map(Result::ok);
                numbered(whole_frames(paths.filter(|path| path.is_file()).collect()))?
            }
            Self::Files(files) => numbered(whole_frames(files.clone()))?,
        })
    }
}

/// A glob that looks for names that begin with a dot without coming to `.` and `..`, which such a name would match, too: frames beside the
/// folder are not asked for, and several such names one below the other would not come to an end.
fn below(pattern: &str) -> String {
    let name = |name: &str| match name.strip_prefix('.') {
        Some(rest) if rest.contains(['*', '?', '[']) => format!("[.]{rest}"),
        _ => name.to_owned(),
    };
    pattern.split_inclusive(std::path::is_separator).map(name).collect()
}

/// Lists the frames that a request for a simulation names, in the order of their numbers: by a name with `{}`, a folder, a glob, a file
/// of several steps, or files one by one.
///
/// # Errors
/// [`Error::Simulation`] for a folder that cannot be read, names that cannot be those of frames, files of several simulations, and where
/// there is no frame.
pub fn frames(inputs: &[PathBuf]) -> Result<Vec<FrameFile>, Error> {
    let inputs = Inputs::of(inputs)?.unwrap_or_else(|| Inputs::Files(inputs.to_vec()));
    // Meshes in a folder of particles are none of them.
    let simulations = inputs.simulations()?;
    let frames = match &*simulations {
        [one] => one.list()?,
        _ => inputs.list()?,
    };
    if frames.is_empty() {
        return Err(SimulationError::NoFrames(inputs.describe()).into());
    }
    Ok(frames)
}

impl FrameFile {
    /// Bytes of its file and of its pieces; 0 of what is gone.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        let bytes = |file: &PathBuf| file.metadata().map_or(0, |metadata| metadata.len());
        files_of(&self.path).iter().map(bytes).sum()
    }

    /// The part of its name that it shares with the others of its simulation; nothing where it has no number.
    pub(super) fn family(&self) -> Family {
        let name = self.path.file_name().unwrap_or_default().to_string_lossy();
        // The first of a snapshot's files is numbered by what stands before the piece's own number.
        let base = snapshot_piece(&self.path).filter(|(_, number)| *number == 0).map(|(base, _)| base);
        let base = base.as_deref().and_then(Path::file_name).map(|base| base.to_string_lossy());
        let cuts = [base.as_deref(), Some(&*name)].into_iter().flatten().filter_map(split_number);
        let cut = cuts.into_iter().find(|(_, digits, _)| *digits == self.digits);
        cut.map_or_else(Family::default, |(prefix, digits, _)| {
            let suffix = &name[prefix.len() + digits.len()..];
            let suffix = suffix.strip_suffix(".gz").unwrap_or(suffix).to_owned();
            Family { prefix: prefix.to_owned(), suffix }
        })
    }
}

/// Whether a file has not changed for so long.
fn rests(path: &Path, patience: Duration) -> bool {
    let modified = path.metadata().and_then(|metadata| metadata.modified());
    modified.is_ok_and(|modified| modified.elapsed().is_ok_and(|since| since >= patience))
}

pub(super) fn neighbours(frames: &[FrameFile]) -> impl Iterator<Item = (&FrameFile, &FrameFile)> {
    frames.iter().zip(frames.iter().skip(1))
}

fn frame(digits: String, path: PathBuf) -> Result<FrameFile, SimulationError> {
    match digits.parse() {
        Ok(number) => Ok(FrameFile { number, digits, path }),
        Err(_) => {
            let what = format!("{}: frames are numbered up to {}", path.display(), u64::MAX);
            Err(SimulationError::Names(what))
        }
    }
}

/// The frame that a file is by its name; nothing where that has no number.
fn by_last_digits(Whole { path, named }: Whole) -> Option<Result<FrameFile, SimulationError>> {
    let name = named.file_name()?.to_string_lossy().into_owned();
    let (_, digits, _) = split_number(&name)?;
    Some(frame(digits.to_owned(), path))
}

/// Refuses numbers that may be decimals, `f_0.15` before `f_0.2`: read as whole ones they are in another order.
fn refuse_decimals(family: &Family, frames: &[FrameFile]) -> Result<(), SimulationError> {
    let before = family.prefix.strip_suffix('.').and_then(|before| before.chars().last());
    if !before.is_some_and(|last| last.is_ascii_digit()) {
        return Ok(());
    }
    let fraction = |frame: &FrameFile| frame.digits.trim_end_matches('0').to_owned();
    match neighbours(frames).find(|(a, b)| fraction(a) > fraction(b)) {
        None => Ok(()),
        Some((a, b)) => Err(SimulationError::Names(format!(
            "{} and {}: their numbers may be decimals; where {} and {} are the frames' numbers, say so by {family}",
            a.path.display(),
            b.path.display(),
            a.number,
            b.number,
        ))),
    }
}

/// Each has a number in its name, or none has and they are counted.
fn numbered(whole: Vec<Whole>) -> Result<Vec<FrameFile>, SimulationError> {
    let files: Vec<PathBuf> = whole.iter().map(|file| file.path.clone()).collect();
    let frames: Vec<_> = whole.into_iter().map(by_last_digits).collect();
    match frames.iter().position(Option::is_none) {
        None => frames.into_iter().flatten().collect(),
        Some(_) if frames.iter().all(Option::is_none) => {
            let count = |(number, path): (usize, PathBuf)| FrameFile {
                number: number as u64,
                digits: number.to_string(),
                path,
            };
            Ok(files.into_iter().enumerate().map(count).collect())
        }
        Some(odd) => Err(SimulationError::Names(format!(
            "{}: its name has no number, those of other frames have",
            files[odd].display()
        ))),
    }
}

fn files_in(folder: &Path) -> Result<Vec<PathBuf>, SimulationError> {
    let fail = |fault| SimulationError::Io { path: folder.to_owned(), fault };
    let entries = std::fs::read_dir(folder).map_err(fail)?;
    let mut files = Vec::new();
    for entry in entries {
        let entry = entry.map_err(fail)?;
        let path = entry.path();
        let is_dir = match entry.file_type() {
            Ok(kind) if !kind.is_symlink() => kind.is_dir(),
            _ => path.is_dir(),
        };
        if !is_dir {
            files.push(path);
        }
    }
    Ok(files)
}

/// The numbers of the frames that are wanted. Ends are included.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Selection {
    /// The first number.
    pub start: u64,
    /// The last number.
    pub end: u64,
    /// Every so many numbers from the first.
    pub step: u64,
}

impl Default for Selection {
    fn default() -> Self {
        Self { start: 0, end: u64::MAX, step: 1 }
    }
}

impl Selection {
    /// The frames that are wanted. Steps count from the first number asked for, else from the first there is.
    #[must_use]
    pub fn of(self, frames: Vec<FrameFile>) -> Vec<FrameFile> {
        let from = if self.start > 0 { self.start } else { frames.first().map_or(0, |frame| frame.number) };
        let wanted = |number: u64| {
            (self.start..=self.end).contains(&number) && (number - from).is_multiple_of(self.step.max(1))
        };
        frames.into_iter().filter(|frame| wanted(frame.number)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frames(numbers: &[u64]) -> Vec<FrameFile> {
        let frame = |&number: &u64| FrameFile { number, digits: number.to_string(), path: PathBuf::new() };
        numbers.iter().map(frame).collect()
    }

    #[test]
    fn a_selection_takes_both_ends_and_steps_from_the_first() {
        let numbers = |selection: Selection| {
            selection.of(frames(&[1, 2, 3, 4, 5, 6, 7])).iter().map(|f| f.number).collect::<Vec<_>>()
        };
        assert_eq!(numbers(Selection { start: 3, end: 6, step: 1 }), [3, 4, 5, 6]);
        assert_eq!(numbers(Selection { step: 3, ..Selection::default() }), [1, 4, 7]);
        assert_eq!(numbers(Selection { start: 2, end: u64::MAX, step: 2 }), [2, 4, 6]);
    }

    #[test]
    fn a_glob_takes_no_files_of_folders_below_its_own() {
        let inputs = Inputs::Glob("sim/*_?.[xp]*".to_owned());
        assert!(inputs.takes(Path::new("sim/f_1.xyz")) && inputs.takes(Path::new("sim/mesh_1.ply")));
        for below in ["sim/mesh/f_1.ply", "sim/a_b/c_1.ply", "sim/a_1.p/c", "sim/a_/.ply"] {
            assert!(!inputs.takes(Path::new(below)), "{below}");
        }
        assert!(Inputs::Glob("sim/**/*.xyz".to_owned()).takes(Path::new("sim/a/b/f_1.xyz")));
    }

    #[test]
    fn a_glob_of_names_that_begin_with_a_dot_does_not_leave_its_folder() {
        let folder = tempfile::tempdir().unwrap();
        let names =
            ["f_1.xyz", ".a/f_2.xyz", ".a/.b/f_3.xyz", "a/f_4.xyz"].map(|name| folder.path().join(name));
        for name in &names {
            std::fs::create_dir_all(name.parent().unwrap()).unwrap();
            std::fs::write(name, "").unwrap();
        }
        let found = |glob: &str| {
            let inputs = Inputs::Glob(folder.path().join(glob).to_str().unwrap().to_owned());
            inputs.found().unwrap().into_iter().map(|frame| frame.path).collect::<Vec<_>>()
        };
        assert_eq!(found(".*/f_*.xyz"), [names[1].clone()]);
        assert_eq!(found(".a/.?*/f_*.xyz"), [names[2].clone()]);
        assert_eq!(found("./.a/../f_*.xyz"), [folder.path().join(".a/../f_1.xyz")]);
        assert!(found(&".*/".repeat(40)).is_empty());
    }
}

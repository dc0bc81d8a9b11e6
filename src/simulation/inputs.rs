//! Finds the files of a simulation's frames, and puts them in order.
//!
//! Frames are ordered by their numbers, which [`pattern`](super::pattern) finds in the file names.

use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::path::{Path, PathBuf, is_separator};
use std::time::Duration;

use glob::MatchOptions;

use crate::io::collection::{ListedFrame, is_list, listed};
use crate::io::input::{InputFormat, file_and_step, holds_mesh, is_known, steps};
use crate::io::mnf::is_packed;

use crate::error::{Error, SimulationError, WhyOne};

use super::frame_file::{FrameFile, neighbours};
use super::inferred::infer;
use super::numbered::{group_by_number, join_simulations, number_by_time};
use super::pattern::{FrameCandidate, NumberKind, Pattern, digit_runs};
use super::pieces::{may_be_piece, whole_frames};

/// Upper limit of [`Sequence::patience`]. A file with an ambiguous name counts as a frame if it has
/// not changed for this time. Until then, another file can appear that shows how to interpret the
/// name.
const PATIENCE: Duration = Duration::from_secs(300);

/// A request for the frames of one or several simulations.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Inputs {
    /// A name with `{}` for the number.
    Pattern(Pattern),
    /// All supported files in a folder. Packed frames count only if there are no particle files.
    Folder(PathBuf),
    /// A glob, such as `sim/*.vtk`.
    Glob(String),
    /// A list of files.
    Files(Vec<PathBuf>),
    /// Steps inside one file.
    Steps {
        /// The file.
        file: PathBuf,
        /// The requested format, if it differs from the format that the extension implies.
        format: Option<InputFormat>,
    },
    /// Several inputs whose frames with the same number are joined.
    Together(Vec<Inputs>),
}

/// The frames of one simulation. They can be listed again to find new ones.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sequence {
    source: Inputs,
    /// The pattern of the files' names; `None` for steps of a file, and for files without numbers,
    /// which are numbered in order.
    pattern: Option<Pattern>,
    /// Time without changes after which a file with an ambiguous name counts as a frame.
    /// `None` unless a folder or a glob is watched.
    patience: Option<Duration>,
}

impl Inputs {
    /// Interprets the arguments as a simulation; `None` if they name one file. `format` is the
    /// requested format, if it differs from the format that the extension implies.
    ///
    /// # Errors
    /// [`SimulationError::Names`] for an invalid pattern, and if there are no arguments.
    pub fn of(
        arguments: &[PathBuf],
        format: Option<InputFormat>,
    ) -> Result<Option<Self>, SimulationError> {
        if arguments.is_empty() {
            return Err(SimulationError::Names("no input file; name one".into()));
        }
        let [path] = arguments else { return Ok(Some(Self::Files(arguments.to_vec()))) };
        if path.is_file() {
            // A file that cannot be read counts as a single frame, and fails when it is converted.
            let several = steps(path, format).is_ok_and(|steps| steps.len() > 1);
            return Ok(several.then(|| Self::Steps { file: path.clone(), format }));
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

    /// Interprets the arguments as simulations whose frames with the same number are joined.
    ///
    /// # Errors
    /// [`SimulationError::Names`] for an invalid pattern.
    pub fn together(
        arguments: &[PathBuf],
        format: Option<InputFormat>,
    ) -> Result<Self, SimulationError> {
        let each = arguments.iter().map(|one| Self::of(std::slice::from_ref(one), format));
        let each = each.collect::<Result<Vec<_>, _>>()?;
        let is_file = |argument: &Option<Self>| argument.is_none();
        let has_number =
            |argument: &PathBuf| !FrameCandidate::from(argument.clone()).runs.is_empty();
        let members = if each.iter().all(is_file) && arguments.iter().any(has_number) {
            vec![Self::Files(arguments.to_vec())]
        } else {
            let member = |(inputs, argument): (Option<Self>, &PathBuf)| {
                inputs.unwrap_or_else(|| Self::Files(vec![argument.clone()]))
            };
            each.into_iter().zip(arguments).map(member).collect()
        };
        Ok(Self::Together(members))
    }

    /// The pattern, path or glob of the request. For a list of files, the path of the first file.
    pub fn describe(&self) -> String {
        match self {
            Self::Pattern(pattern) => pattern.to_string(),
            Self::Folder(path) | Self::Steps { file: path, .. } => path.display().to_string(),
            Self::Glob(pattern) => pattern.clone(),
            Self::Files(files) => {
                files.first().map_or(String::new(), |file| file.display().to_string())
            }
            Self::Together(members) => {
                members.iter().map(Self::describe).collect::<Vec<_>>().join(" and ")
            }
        }
    }

    /// The simulations among the existing files. In a folder with particles, meshes are ignored.
    ///
    /// When watching, the simulation is over after `idle` seconds without a new or changed file. In
    /// a folder or a glob, a file with an ambiguous name counts as a frame when the file has not
    /// changed for `idle` seconds, or for 5 minutes if `idle` is longer. In the meantime, another
    /// file can show whether the ambiguous file is a piece, or which number in its name is the
    /// frame number.
    ///
    /// # Errors
    /// [`SimulationError::Unreadable`] for an input that cannot be read, [`SimulationError::Names`]
    /// if the names do not determine the frame number.
    pub fn simulations(&self, idle: Option<f64>) -> Result<Vec<Sequence>, SimulationError> {
        let may_grow = matches!(self, Self::Folder(_) | Self::Glob(_));
        let patience = idle
            .filter(|_| may_grow)
            .map(|idle| Duration::try_from_secs_f64(idle).unwrap_or(PATIENCE).min(PATIENCE));
        let sequence = |pattern| Sequence { source: self.clone(), pattern, patience };
        let mut files = match self {
            Self::Pattern(pattern) => return Ok(vec![sequence(Some(pattern.clone()))]),
            Self::Steps { .. } => return Ok(vec![sequence(None)]),
            Self::Together(members) => {
                let found = members_of(members)?;
                let pattern = found.iter().find_map(|sequence| sequence.pattern.clone());
                return match &found[..] {
                    [] => Ok(Vec::new()),
                    [only] if !only.is_joined() => Err(SimulationError::Names(format!(
                        "{}: cannot join a single simulation; give at least two",
                        only.describe()
                    ))),
                    _ => Ok(vec![sequence(pattern)]),
                };
            }
            _ => self.candidates()?,
        };
        files.retain(|file| {
            patience.is_none_or(|patience| {
                !may_be_piece(&file.path) || is_unchanged_for(file, patience)
            })
        });
        if let Self::Files(named) = self {
            reject_folders(named)?;
        }
        if let Some(unnumbered) = files.iter().find(|file| file.runs.is_empty()) {
            if let Some(missing) = missing_file_error(&unnumbered.path).filter(|_| idle.is_none()) {
                return Err(missing);
            }
            if files.iter().all(|file| file.runs.is_empty()) {
                return Ok(vec![sequence(None)]);
            }
            return Err(SimulationError::Names(format!(
                "{}: this name has no number, but the names of the other frames do; rename the \
                 file, or leave it out",
                unnumbered.path.display()
            )));
        }
        if matches!(self, Self::Folder(_)) && !files.is_empty() {
            files = without_meshes(files);
            if files.is_empty() {
                let what = format!("{}: contains meshes, but no particles", self.describe());
                return Err(SimulationError::Names(what));
            }
        }
        if let ([file], Some(patience)) = (&*files, patience)
            && file.runs.len() > 1
            && !is_unchanged_for(file, patience)
        {
            return Ok(Vec::new());
        }
        Ok(infer(&files)?.into_iter().map(|pattern| sequence(Some(pattern))).collect())
    }

    /// The only simulation in the inputs, with its frames in order.
    ///
    /// # Errors
    /// The errors of [`simulations`](Self::simulations) and [`Sequence::list`],
    /// [`SimulationError::Several`] for several simulations, and the error of
    /// [`no_frames`](Self::no_frames) if there are no frames.
    pub fn only(&self) -> Result<(Sequence, Vec<FrameFile>), SimulationError> {
        let mut found = self.simulations(None)?;
        if found.len() > 1 {
            return Err(self.several(&found, WhyOne::Request));
        }
        let sequence = found.pop().ok_or_else(|| self.no_frames())?;
        let frames = sequence.list()?;
        if frames.is_empty() { Err(self.no_frames()) } else { Ok((sequence, frames)) }
    }

    /// Checks that the inputs contain a frame, and that the named files exist.
    ///
    /// # Errors
    /// The errors of [`simulations`](Self::simulations) and [`Sequence::list`], the error of
    /// [`no_frames`](Self::no_frames) if there are no frames, and [`SimulationError::Unreadable`]
    /// for a named file that does not exist.
    pub fn expect_frames(&self) -> Result<(), SimulationError> {
        let mut frames = Vec::new();
        for sequence in self.simulations(None)? {
            frames.extend(sequence.list()?);
        }
        if frames.is_empty() { Err(self.no_frames()) } else { self.expect_files(&frames) }
    }

    /// Returns an error if a file of `frames` was named in the request, but does not exist.
    fn expect_files(&self, frames: &[FrameFile]) -> Result<(), SimulationError> {
        let Self::Files(_) = self else { return Ok(()) };
        frames.iter().flat_map(FrameFile::paths).find_map(missing_file_error).map_or(Ok(()), Err)
    }

    /// The error for inputs without frames.
    pub fn no_frames(&self) -> SimulationError {
        let folder = match self {
            Self::Pattern(pattern) => Some(pattern.folder()),
            Self::Folder(folder) => Some(&**folder),
            Self::Glob(_) | Self::Files(_) | Self::Steps { .. } | Self::Together(_) => None,
        };
        if let Some(folder) = folder.filter(|folder| !folder.exists()) {
            return SimulationError::NoFolder(folder.to_owned());
        }
        if let Self::Pattern(pattern) = self {
            let times = Pattern { numbers: NumberKind::Times, ..pattern.clone() };
            let files = self.candidates().unwrap_or_default();
            let is_decimal =
                |file: &FrameCandidate| times.digits(&file.name).is_some_and(|t| t.contains('.'));
            if files.iter().any(is_decimal) {
                return SimulationError::Names(format!(
                    "{pattern}: the numbers of these files are decimals; use the pattern \
                     \"{times}\""
                ));
            }
            return SimulationError::NoMatch(pattern.to_string());
        }
        SimulationError::NoFrames(self.describe())
    }

    /// The error for several simulations, with their names.
    pub fn several(&self, simulations: &[Sequence], why: WhyOne) -> SimulationError {
        let each = simulations.iter().filter_map(|sequence| {
            let Pattern { prefix, suffix, .. } = sequence.pattern.as_ref()?;
            let frames = sequence.list().map_or(0, |frames| frames.len());
            let unit = if frames == 1 { "frame" } else { "frames" };
            Some(format!("{prefix}{{}}{suffix} ({frames} {unit})"))
        });
        SimulationError::Several {
            from: self.describe(),
            families: each.collect::<Vec<_>>().join(", "),
            why,
        }
    }

    /// Whether the inputs would include the file at `path` if it existed.
    fn would_include(&self, path: &Path) -> bool {
        let is_in = |folder: &Path| {
            let canonical = |folder: &Path| match folder.as_os_str().is_empty() {
                true => Path::new(".").canonicalize(),
                false => folder.canonicalize(),
            };
            path.parent()
                .and_then(|parent| canonical(parent).ok())
                .is_some_and(|own| canonical(folder).is_ok_and(|f| f == own))
        };
        match self {
            Self::Pattern(pattern) => is_in(&pattern.folder),
            Self::Folder(folder) => is_in(folder) && (is_known(path) || is_packed(path)),
            Self::Glob(pattern) => {
                // As in the search for files, a wildcard does not match a folder separator.
                let in_one_folder =
                    MatchOptions { require_literal_separator: true, ..MatchOptions::new() };
                glob::Pattern::new(pattern)
                    .is_ok_and(|pattern| pattern.matches_path_with(path, in_one_folder))
            }
            Self::Together(members) => members_of(members)
                .is_ok_and(|members| members.iter().any(|member| member.would_include(path))),
            Self::Steps { .. } | Self::Files(_) => false,
        }
    }

    /// Whether these inputs leave out a file because its name begins with a dot, such as
    /// `._f_1.npy` of macOS. Such files are used only if the requested pattern or glob itself
    /// begins with a dot, or if the files are named one by one.
    fn hides(&self, path: &Path) -> bool {
        let includes_hidden = match self {
            Self::Pattern(pattern) => pattern.prefix.starts_with('.'),
            Self::Glob(pattern) => {
                pattern.rsplit(is_separator).next().is_some_and(|name| name.starts_with(['.', '[']))
            }
            Self::Folder(_) => false,
            Self::Files(_) | Self::Steps { .. } | Self::Together(_) => true,
        };
        !includes_hidden
            && path.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b"."))
    }

    /// The existing files that may be frames.
    fn candidates(&self) -> Result<Vec<FrameCandidate>, SimulationError> {
        Ok(match self {
            Self::Pattern(pattern) => {
                let named =
                    |path: PathBuf| pattern.folder.join(path.file_name().unwrap_or_default());
                files_and_broken_links_in(pattern.folder())?
                    .into_iter()
                    .filter(|path| !self.hides(path))
                    .map(|path| FrameCandidate::from(named(path)))
                    .collect()
            }
            Self::Folder(folder) => {
                let all = files_and_broken_links_in(folder)?;
                let frames = |is_frame: fn(&Path) -> bool| {
                    let files = all.iter().filter(|path| is_frame(path) && !self.hides(path));
                    // A folder may contain files other than frames, so files without a number are
                    // ignored.
                    let mut frames = whole_frames(files.cloned().collect());
                    frames.retain(|frame| !frame.runs.is_empty());
                    frames
                };
                // If the folder also contains particle files, the packed frames may have been made
                // from them, so the packed frames are ignored.
                let of_particles = frames(is_known);
                if of_particles.is_empty() { frames(is_packed) } else { of_particles }
            }
            Self::Glob(pattern) => {
                let fail =
                    |e: glob::PatternError| SimulationError::Names(format!("{pattern}: {e}"));
                glob::Pattern::new(pattern).map_err(fail)?;
                let paths =
                    glob::glob(&without_dot_folders(pattern)).map_err(fail)?.filter_map(Result::ok);
                whole_frames(paths.filter(|path| path.is_file() && !self.hides(path)).collect())
            }
            Self::Files(files) => whole_frames(files.clone()),
            Self::Steps { .. } | Self::Together(_) => Vec::new(),
        })
    }
}

impl Sequence {
    /// The pattern of the frames or, if there is no pattern, the
    /// [description](Inputs::describe) of the inputs.
    pub fn describe(&self) -> String {
        self.pattern.as_ref().map_or_else(|| self.source.describe(), Pattern::to_string)
    }

    /// The error if no frame of this sequence exists.
    pub fn no_frames(&self) -> SimulationError {
        match self.source.no_frames() {
            SimulationError::NoFrames(_) => SimulationError::NoFrames(self.describe()),
            missing => missing,
        }
    }

    /// The inputs of the request.
    pub(super) fn source(&self) -> &Inputs {
        &self.source
    }

    /// The pattern of the files' names; `None` for steps of a file, and for files without numbers,
    /// which are numbered in order.
    pub fn pattern(&self) -> Option<&Pattern> {
        self.pattern.as_ref()
    }

    /// The path, without links, of the folder or file that contains the frames; `None` for files
    /// without numbers, which can be in several folders.
    pub fn location(&self) -> Option<String> {
        let location = match (&self.source, &self.pattern) {
            (Inputs::Steps { file, .. }, _) => file,
            (_, pattern) => pattern.as_ref()?.folder(),
        };
        Some(location.canonicalize().ok()?.to_string_lossy().into_owned())
    }

    /// Whether each frame's number is in the name of its file, so that it does not depend on other
    /// files.
    pub fn has_own_numbers(&self) -> bool {
        self.pattern.as_ref().is_some_and(|pattern| pattern.numbers == NumberKind::Whole)
    }

    /// Whether the numbers in the names count as times although the request has no pattern with
    /// `{time}`.
    pub(super) fn infers_times(&self) -> bool {
        let is_inferred = match &self.source {
            Inputs::Together(members) => {
                members.iter().any(|member| !matches!(member, Inputs::Pattern(_)))
            }
            source => !matches!(source, Inputs::Pattern(_)),
        };
        let pattern = self.pattern.as_ref().filter(|_| is_inferred);
        pattern.is_some_and(|pattern| pattern.numbers == NumberKind::Times)
    }

    /// The existing frames, in order. A frame that lacks a file that other frames have is
    /// [incomplete](FrameFile::lacking).
    ///
    /// # Errors
    /// [`SimulationError::Unreadable`] for a folder that cannot be read, [`SimulationError::Names`]
    /// if two files have the same frame number, or if a newer file shows that another number in the
    /// names is the frame number.
    pub fn list(&self) -> Result<Vec<FrameFile>, SimulationError> {
        let counted = |number: i64, path| FrameFile::new(number, number.to_string(), path);
        let mut frames: Vec<_> = match (&self.source, &self.pattern) {
            (Inputs::Together(members), _) => {
                let members = members_of(members)?;
                let lists = members.iter().map(Self::list).collect::<Result<_, _>>()?;
                return join_simulations(&members, lists);
            }
            (Inputs::Steps { file, format }, _) => {
                let steps =
                    steps(file, *format).map_err(|e| SimulationError::Names(e.to_string()))?;
                let path = |number| PathBuf::from(format!("{}#{number}", file.display()));
                let counted = |number: u64| counted(number as i64, path(number));
                steps.into_iter().map(counted).collect()
            }
            (source, None) => (0..)
                .zip(source.candidates()?)
                .map(|(number, file)| counted(number, file.path))
                .collect(),
            (source, Some(pattern)) => {
                let files = source.candidates()?;
                self.confirm(pattern, &files)?;
                let numbered = |file: FrameCandidate| {
                    let digits = self.digits(pattern, &file)?.to_owned();
                    Some((digits, file))
                };
                let files: Vec<_> = files.into_iter().filter_map(numbered).collect();
                match pattern.numbers {
                    NumberKind::Whole => group_by_number(pattern, files)?,
                    NumberKind::Times => number_by_time(files),
                }
            }
        };
        frames.sort_by(|a: &FrameFile, b| (a.number, &a.path).cmp(&(b.number, &b.path)));
        if let Some(pattern) =
            self.pattern.as_ref().filter(|_| !matches!(self.source, Inputs::Pattern(_)))
        {
            reject_decimals(pattern, &frames)?;
        }
        if let Some((a, b)) = neighbours(&frames)
            .find(|(a, b)| a.number == b.number || a.time.is_some() && a.time == b.time)
        {
            return Err(SimulationError::Names(format!(
                "{} and {} are both frame {}; use a pattern with {{}} for the frame number that \
                 matches only one of them",
                a.path.display(),
                b.path.display(),
                a.digits
            )));
        }
        Ok(frames)
    }

    /// Returns the frame's number in the name of a file. A pattern from the request must match the
    /// whole name; an inferred pattern ignores `.gz` and similar endings.
    fn digits<'a>(&self, pattern: &Pattern, file: &'a FrameCandidate) -> Option<&'a str> {
        match self.source {
            Inputs::Pattern(_) => pattern.digits(file.path.file_name()?.to_str()?),
            _ => pattern.digits(&file.name),
        }
    }

    /// Infers the pattern again if new files differ from the known frames in a number other than
    /// the frame number. Returns an error if the result differs from `pattern`.
    fn confirm(&self, pattern: &Pattern, files: &[FrameCandidate]) -> Result<(), SimulationError> {
        let Some(patience) = self.patience else { return Ok(()) };
        let is_frame = |file: &FrameCandidate| pattern.digits(&file.name).is_some();
        let Some(first) = files.iter().find(|file| is_frame(file)) else { return Ok(()) };
        let kind = first.skeleton();
        let is_alike = |file: &&FrameCandidate| {
            file.skeleton() == kind
                && (is_frame(file) || !may_be_piece(&file.path) || is_unchanged_for(file, patience))
        };
        let (mut alike, others): (Vec<_>, Vec<_>) =
            files.iter().filter(is_alike).cloned().partition(is_frame);
        // Leave out meshes, because they can be the outputs of this conversion.
        let others = without_meshes(others);
        if others.is_empty() {
            return Ok(());
        }
        alike.extend(others);
        let patterns = infer(&alike)?;
        if patterns
            .iter()
            .any(|new| (&new.prefix, &new.suffix) == (&pattern.prefix, &pattern.suffix))
        {
            return Ok(());
        }
        let patterns: Vec<_> = patterns.iter().map(|new| format!("\"{new}\"")).collect();
        Err(SimulationError::Names(format!(
            "the first files matched the pattern \"{pattern}\", but in the names of later files, \
             another number varies; use the input pattern {}",
            patterns.join(" or ")
        )))
    }

    /// Whether the file at `path` would be a frame if it existed.
    pub fn would_include(&self, path: &Path) -> bool {
        let file = FrameCandidate::from(path.to_owned());
        let is_joined = matches!(self.source, Inputs::Together(_));
        self.source.would_include(path)
            && !self.source.hides(path)
            && (is_joined
                || self
                    .pattern
                    .as_ref()
                    .is_none_or(|pattern| self.digits(pattern, &file).is_some()))
    }

    /// Whether a frame may consist of several files that no index file lists.
    pub(super) fn is_joined(&self) -> bool {
        matches!(self.source, Inputs::Together(_))
            || self.pattern.as_ref().is_some_and(Pattern::has_pieces)
    }
}

/// Changes a glob so that its components with a leading dot do not match `.` and `..`. Otherwise,
/// the glob would find frames outside the folder, and a search through several such components
/// would never end.
fn without_dot_folders(pattern: &str) -> String {
    let name = |name: &str| match name.strip_prefix('.') {
        Some(rest) if rest.contains(['*', '?', '[']) => format!("[.]{rest}"),
        _ => name.to_owned(),
    };
    pattern.split_inclusive(is_separator).map(name).collect()
}

/// Lists the frames that the inputs name, in the order of their numbers. Inputs are a name with
/// `{}`, a folder, a glob, a file with several steps, or a list of files.
///
/// # Errors
/// [`Error::Simulation`] for a file that does not exist, a folder that cannot be read, names that
/// do not determine frame numbers, files of several simulations, and inputs without frames.
pub fn frames(inputs: &[PathBuf]) -> Result<Vec<FrameFile>, Error> {
    let inputs = Inputs::of(inputs, None)?.unwrap_or_else(|| Inputs::Files(inputs.to_vec()));
    let frames = inputs.only()?.1;
    inputs.expect_files(&frames)?;
    Ok(frames)
}

/// Expands arguments to files. A folder expands to its `wanted` files, a glob to the `wanted` files
/// that it matches, a name with `{}` to the files of its frames, and a list of frames, such as a
/// `.pvd` file, to the files that it lists. Any other argument is returned unchanged. Sorts the
/// files of each argument by name, where numbers are compared by value.
///
/// # Errors
/// [`Error::Simulation`] for a folder that cannot be read, an invalid pattern, and arguments that
/// match no file.
pub fn files(arguments: &[PathBuf], wanted: impl Fn(&Path) -> bool) -> Result<Vec<PathBuf>, Error> {
    let mut all = Vec::new();
    for argument in arguments {
        let mut found = match Inputs::of(std::slice::from_ref(argument), None)? {
            Some(Inputs::Folder(folder)) => files_in(&folder, &wanted)?,
            Some(inputs @ Inputs::Glob(_)) => {
                let files = inputs.candidates()?.into_iter().map(|file| file.path);
                files.filter(|file| wanted(file)).collect()
            }
            _ if argument.is_file() && is_list(argument) => {
                let frames = listed(argument)?;
                frames.iter().flat_map(ListedFrame::files).map(Path::to_owned).collect()
            }
            Some(inputs @ Inputs::Pattern(_)) => inputs
                .only()
                .map(|(_, frames)| frames)?
                .iter()
                .flat_map(|frame| frame.paths().map(Path::to_owned))
                .collect(),
            None if argument.to_string_lossy().ends_with(is_separator) => {
                return Err(SimulationError::NoFolder(argument.clone()).into());
            }
            Some(Inputs::Steps { .. } | Inputs::Files(_) | Inputs::Together(_)) | None => {
                vec![argument.clone()]
            }
        };
        if found.is_empty() {
            return Err(SimulationError::NoFiles(argument.display().to_string()).into());
        }
        found.sort_by_cached_key(|path| natural_sort_key(path));
        all.append(&mut found);
    }
    Ok(all)
}

/// The wanted files of a folder, in the order of their names.
pub(super) fn files_in(
    folder: &Path,
    wanted: impl Fn(&Path) -> bool,
) -> Result<Vec<PathBuf>, SimulationError> {
    let mut files = files_and_broken_links_in(folder)?;
    files.retain(|file| wanted(file));
    files.sort();
    Ok(files)
}

/// Splits a name into alternating text and numbers, as a sort key.
fn natural_sort_key(path: &Path) -> Vec<(String, u64)> {
    let name = path.to_string_lossy();
    let mut parts = Vec::new();
    let mut begin = 0;
    for run in digit_runs(&name) {
        parts.push((
            name[begin..run.start].to_owned(),
            name[run.clone()].parse().unwrap_or(u64::MAX),
        ));
        begin = run.end;
    }
    parts.push((name[begin..].to_owned(), 0));
    parts
}

/// Removes meshes. Files whose names differ only in the last number are assumed to be either all
/// meshes or all particles, so only the first of them is read.
fn without_meshes(files: Vec<FrameCandidate>) -> Vec<FrameCandidate> {
    let mut by_last: BTreeMap<_, Vec<_>> = BTreeMap::new();
    for file in files {
        let last = file.pattern(file.runs.len() - 1);
        by_last.entry((last.prefix, last.suffix)).or_default().push(file);
    }
    // Keep a file that cannot be read, because its conversion will report the error.
    by_last.retain(|_, files| !holds_mesh(&files[0].path).unwrap_or(false));
    by_last.into_values().flatten().collect()
}

/// Rejects folders among several inputs.
fn reject_folders(inputs: &[PathBuf]) -> Result<(), SimulationError> {
    match inputs.iter().find(|input| inputs.len() > 1 && input.is_dir()) {
        None => Ok(()),
        Some(folder) => Err(SimulationError::Names(format!(
            "{}: this input is a folder; use either one folder or a list of files",
            folder.display()
        ))),
    }
}

/// The error for an input that does not exist; `None` if the input exists.
fn missing_file_error(input: &Path) -> Option<SimulationError> {
    let fault = file_and_step(input).0.metadata().err()?;
    Some(SimulationError::Unreadable { path: input.to_owned(), fault })
}

/// Whether a file has not changed for at least `patience`.
fn is_unchanged_for(file: &FrameCandidate, patience: Duration) -> bool {
    let modified = file.path.metadata().and_then(|metadata| metadata.modified());
    modified.is_ok_and(|modified| modified.elapsed().is_ok_and(|since| since >= patience))
}

/// Rejects numbers that may be decimals, such as in `f_0.15` and `f_0.2`, because the integers 15
/// and 2 would put these frames in the wrong order.
fn reject_decimals(pattern: &Pattern, frames: &[FrameFile]) -> Result<(), SimulationError> {
    let before = pattern.prefix.strip_suffix('.').and_then(|before| before.chars().last());
    if !before.is_some_and(|last| last.is_ascii_digit()) {
        return Ok(());
    }
    let fraction = |frame: &FrameFile| frame.digits.trim_end_matches('0').to_owned();
    match neighbours(frames).find(|(a, b)| fraction(a) > fraction(b)) {
        None => Ok(()),
        Some((a, b)) => Err(SimulationError::Names(format!(
            "{} and {}: the numbers in these names could be decimals; if {} and {} are the frame \
             numbers, use the input pattern \"{pattern}\"",
            a.path.display(),
            b.path.display(),
            a.number,
            b.number,
        ))),
    }
}

/// Returns the simulations of all `members`.
fn members_of(members: &[Inputs]) -> Result<Vec<Sequence>, SimulationError> {
    let mut sequences = Vec::new();
    for member in members {
        sequences.extend(member.simulations(None)?);
    }
    Ok(sequences)
}

fn files_and_broken_links_in(folder: &Path) -> Result<Vec<PathBuf>, SimulationError> {
    let fail = |fault| SimulationError::Unreadable { path: folder.to_owned(), fault };
    let entries = match std::fs::read_dir(folder) {
        // A missing folder is not an error here, because a simulation that is being watched may
        // still create it.
        Err(fault) if fault.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries.map_err(fail)?,
    };
    let mut files = Vec::new();
    for entry in entries {
        let entry = entry.map_err(fail)?;
        let path = entry.path();
        // Leave out pipes, because opening a pipe would wait for another program. Keep broken
        // links, so that they are reported.
        let is_file = match entry.file_type() {
            Ok(kind) if !kind.is_symlink() => kind.is_file(),
            _ => path.metadata().map_or(true, |file| file.is_file()),
        };
        if is_file {
            files.push(path);
        }
    }
    Ok(files)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_glob_does_not_match_files_in_subfolders() {
        let inputs = Inputs::Glob("sim/*_?.[xp]*".to_owned());
        assert!(
            inputs.would_include(Path::new("sim/f_1.xyz"))
                && inputs.would_include(Path::new("sim/mesh_1.ply"))
        );
        for below in ["sim/mesh/f_1.ply", "sim/a_b/c_1.ply", "sim/a_1.p/c", "sim/a_/.ply"] {
            assert!(!inputs.would_include(Path::new(below)), "{below}");
        }
        assert!(
            Inputs::Glob("sim/**/*.xyz".to_owned()).would_include(Path::new("sim/a/b/f_1.xyz"))
        );
    }

    #[cfg(unix)]
    #[test]
    fn a_folder_has_files_and_broken_links_but_no_pipes_and_no_folders() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::write(at("a_1.xyz"), "").unwrap();
        std::fs::create_dir(at("a_2.xyz")).unwrap();
        std::os::unix::fs::symlink("nowhere", at("a_3.xyz")).unwrap();
        let made = std::process::Command::new("mkfifo").arg(at("a_4.xyz")).status().unwrap();
        assert!(made.success());
        let mut files = files_and_broken_links_in(folder.path()).unwrap();
        files.sort();
        assert_eq!(files, [at("a_1.xyz"), at("a_3.xyz")]);
    }

    #[test]
    fn a_glob_with_leading_dots_does_not_match_parent_folders() {
        let folder = tempfile::tempdir().unwrap();
        let names = ["f_1.xyz", ".a/f_2.xyz", ".a/.b/f_3.xyz", "a/f_4.xyz"]
            .map(|name| folder.path().join(name));
        for name in &names {
            std::fs::create_dir_all(name.parent().unwrap()).unwrap();
            std::fs::write(name, "").unwrap();
        }
        let found = |glob: &str| {
            let inputs = Inputs::Glob(folder.path().join(glob).to_str().unwrap().to_owned());
            inputs.candidates().unwrap().into_iter().map(|file| file.path).collect::<Vec<_>>()
        };
        assert_eq!(found(".*/f_*.xyz"), [names[1].clone()]);
        assert_eq!(found(".a/.?*/f_*.xyz"), [names[2].clone()]);
        assert_eq!(found("./.a/../f_*.xyz"), [folder.path().join(".a/../f_1.xyz")]);
        assert!(found(&".*/".repeat(40)).is_empty());
    }
}

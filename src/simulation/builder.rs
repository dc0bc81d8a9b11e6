//! The request for the meshes of a simulation's frames, built option by option.

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf, is_separator};

use crate::error::{Error, FPS, SimulationError};
use crate::io::input::{InputFormat, is_known};
use crate::reconstruction::Reconstruction;

use super::frame_file::Selection;

use super::inputs::{Inputs, Sequence};
use super::naming::Naming;
use super::pattern::is_foreign;

/// A request for the mesh of each frame of a simulation.
///
/// Grid and calibration are measured once and stored next to the outputs, so that all frames are
/// consistent, even if several processes make them.
///
/// ```no_run
/// use meniscus::Simulation;
///
/// Simulation::new("sim/frame_{}.bgeo", "mesh/frame_{}.ply").run(|event| println!("{event}"))?;
/// # Ok::<(), meniscus::Error>(())
/// ```
#[derive(Debug, Clone)]
#[must_use]
pub struct Simulation {
    pub(super) inputs: Vec<PathBuf>,
    pub(super) output: PathBuf,
    pub(super) request: Reconstruction,
    pub(super) selection: Selection,
    pub(super) frames: (i64, i64),
    pub(super) resume: bool,
    pub(super) overwrite: bool,
    pub(super) watch: Option<f64>,
    pub(super) fps: Option<f64>,
    pub(super) also_written: Vec<PathBuf>,
    /// Whether this run only makes a plan. A plan converts no frames, so existing meshes from
    /// earlier runs of this simulation are not an error.
    pub(super) planned: bool,
    /// Whether a contact sheet will be drawn.
    pub(super) sheet: bool,
    /// Whether inputs with the same frame number are joined.
    pub(super) together: bool,
}

impl Simulation {
    /// A request for the meshes of a simulation's frames.
    ///
    /// The input is a pattern with `{}` for the frame number, a folder, a glob, or a file with
    /// several steps. The output is a pattern with `{}` or `{:04}`, a folder for `.ply` files,
    /// which exists or ends in `/`, or an Alembic archive for all frames (`.abc`). Missing folders
    /// are created.
    pub fn new(input: impl Into<PathBuf>, output: impl Into<PathBuf>) -> Self {
        Self::of_files([input], output)
    }

    /// A request for the meshes of the frames in these files.
    pub fn of_files(
        inputs: impl IntoIterator<Item = impl Into<PathBuf>>,
        output: impl Into<PathBuf>,
    ) -> Self {
        Self {
            inputs: inputs.into_iter().map(Into::into).collect(),
            output: output.into(),
            request: Reconstruction::new(),
            selection: Selection::default(),
            frames: (i64::MIN, i64::MAX),
            resume: false,
            overwrite: false,
            watch: None,
            fps: None,
            also_written: Vec::new(),
            planned: false,
            sheet: false,
            together: false,
        }
    }

    /// A request for a simulation if the inputs or the output name several frames; `None` if both
    /// name a single frame. If the input is a single file, only `{}` in the output stands for a
    /// frame number, and `##` and `%04d` are ordinary text. `format` is the format of the inputs if
    /// it differs from the format that their extension implies.
    ///
    /// # Errors
    /// [`Error::Simulation`] for names that do not determine frame numbers. For several inputs and
    /// one output, [`Error::Request`], or [`Error::Simulation`] if the inputs contain no frame.
    pub fn detect(
        inputs: &[PathBuf],
        output: &Path,
        format: Option<InputFormat>,
    ) -> Result<Option<Self>, Error> {
        let several = Inputs::of(inputs, format)?;
        if several.is_none() && is_foreign(output) {
            return Ok(None);
        }
        let naming = match &several {
            Some(_) => Naming::of_several(output)?,
            None => Naming::of(output)?,
        };
        match (several, naming) {
            (None, None) => Ok(None),
            (_, Some(_)) => Ok(Some(Self::of_files(inputs, output))),
            (Some(inputs), None) => Err(one_output(output, &inputs)?),
        }
    }

    /// A request for a simulation whose inputs are [joined](Self::together), if the output names
    /// several frames; `None` if the output names a single frame. `format` is the format of the
    /// inputs if it differs from the format that their extension implies.
    ///
    /// # Errors
    /// [`Error::Simulation`] for names that do not determine frame numbers. For several frames and
    /// one output, [`Error::Request`], or [`Error::Simulation`] if the inputs contain no frame.
    pub fn detect_together(
        inputs: &[PathBuf],
        output: &Path,
        format: Option<InputFormat>,
    ) -> Result<Option<Self>, Error> {
        if Naming::of(output)?.is_some() {
            return Ok(Some(Self::of_files(inputs, output).together()));
        }
        for input in inputs {
            let Some(several) = Inputs::of(std::slice::from_ref(input), format)? else { continue };
            let is_one = || {
                let found = several.simulations(None)?;
                let frames = found.iter().map(Sequence::list).collect::<Result<Vec<_>, _>>()?;
                Ok::<_, SimulationError>(frames.iter().all(|frames| frames.len() < 2))
            };
            match several {
                Inputs::Folder(_) | Inputs::Glob(_) if is_one()? => {}
                Inputs::Files(_) => {}
                _ if Naming::of_several(output)?.is_some() => {
                    return Ok(Some(Self::of_files(inputs, output).together()));
                }
                _ => return Err(one_output(output, &several)?),
            }
        }
        Ok(None)
    }

    /// Sets the request for each frame's surface.
    pub fn reconstruction(mut self, request: Reconstruction) -> Self {
        self.request = request;
        self
    }

    /// Sets the number of the first frame.
    pub fn start(mut self, number: i64) -> Self {
        self.selection.start = number;
        self
    }

    /// Sets the number of the last frame.
    pub fn end(mut self, number: i64) -> Self {
        self.selection.end = number;
        self
    }

    /// Uses only every `numbers`-th frame number, starting with the first.
    pub fn step(mut self, numbers: u64) -> Self {
        self.selection.step = numbers;
        self
    }

    /// Converts only these frames of the simulation, as one of several jobs. All jobs share the
    /// same calibration.
    pub fn frames(mut self, numbers: RangeInclusive<i64>) -> Self {
        self.frames = numbers.into_inner();
        self
    }

    /// Resumes an interrupted conversion: keeps meshes that are complete and made from the same
    /// inputs. Changed settings are an error, unless outputs may be [replaced](Self::overwrite).
    pub fn resume(mut self) -> Self {
        self.resume = true;
        self
    }

    /// Replaces existing outputs.
    pub fn overwrite(mut self) -> Self {
        self.overwrite = true;
        self
    }

    /// Follows a running simulation until its last frame, or until no file has appeared or
    /// changed for `seconds` seconds.
    pub fn watch(mut self, seconds: f64) -> Self {
        self.watch = Some(seconds);
        self
    }

    /// Joins the frames with the same number from all inputs. The particles of the joined frames
    /// make one surface, with the attributes that all these frames have.
    pub fn together(mut self) -> Self {
        self.together = true;
        self
    }

    /// Sets the frames per second of the simulation. If the files have no times, a frame's time is
    /// its number divided by this rate. A USD stage has this many time codes per second.
    pub fn fps(mut self, rate: f64) -> Self {
        self.fps = Some(rate);
        self
    }

    /// Names a file that the caller writes during the conversion. If the conversion would write the
    /// same file, [`run`](Self::run) fails.
    pub fn also_writes(mut self, file: impl Into<PathBuf>) -> Self {
        self.also_written.push(file.into());
        self
    }

    /// The names of inputs and outputs.
    pub(super) fn names(&self) -> Result<(Inputs, Naming), Error> {
        let Some(naming) = Naming::of_several(&self.output)? else {
            let what = format!(
                "{}: this output is one file for all frames; use {{}} for the frame number, or a \
                 folder (an existing one, or a name that ends in /)",
                self.output.display()
            );
            return Err(SimulationError::Names(what).into());
        };
        let format = self.request.settings.format;
        if self.together {
            return Ok((Inputs::together(&self.inputs, format)?, naming));
        }
        let inputs = match (Inputs::of(&self.inputs, format)?, &self.inputs[..]) {
            (Some(inputs), _) => inputs,
            // A path that does not exist counts as a folder if it ends with a separator, or if it
            // is watched and does not have the extension of an input file.
            (None, [path])
                if !path.exists()
                    && (self.watch.is_some() && !is_known(path)
                        || path.to_string_lossy().ends_with(is_separator)) =>
            {
                Inputs::Folder(path.clone())
            }
            (None, files) => Inputs::Files(files.to_vec()),
        };
        Ok((inputs, naming))
    }

    /// Whether this request makes all frames again.
    pub(super) fn makes_all_again(&self) -> bool {
        let is_plain = !self.resume && !self.planned && self.watch.is_none();
        let has_all = self.frames == (i64::MIN, i64::MAX) && self.selection == Selection::default();
        self.overwrite && is_plain && has_all
    }

    /// Whether this conversion includes the frame with this number.
    pub(super) fn includes(&self, number: i64) -> bool {
        let (first, last) = self.frames;
        (first..=last).contains(&number)
    }

    /// Rejects invalid numbers.
    pub(super) fn validate(&self) -> Result<(), Error> {
        if let Some(fps) = self.fps.filter(|fps| !FPS.contains(fps)) {
            return Err(SimulationError::Rate { rate: fps, range: FPS }.into());
        }
        if let Some(seconds) = self.watch.filter(|seconds| seconds.is_nan() || *seconds < 0.0) {
            return Err(SimulationError::Timeout(seconds).into());
        }
        let Selection { start, end, step } = self.selection;
        if start > end {
            return Err(SimulationError::Range { first: start, last: end }.into());
        }
        if step == 0 {
            return Err(SimulationError::Step.into());
        }
        Ok(())
    }
}

/// The error for an output that names one file for several frames.
///
/// # Errors
/// [`Error::Simulation`] if the inputs cannot be read or contain no frame, because another output
/// would not help.
fn one_output(output: &Path, inputs: &Inputs) -> Result<Error, Error> {
    inputs.expect_frames()?;
    Ok(Error::Request(format!(
        "{}: this output is one file for all frames of {}; use {{}} for the frame number, or a \
         folder (an existing one, or a name that ends in /)",
        output.display(),
        inputs.describe()
    )))
}

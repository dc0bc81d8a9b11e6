//! The Python class `Simulation`, which reconstructs frames from memory while a simulation runs, or
//! converts particle files to mesh files.

use std::path::PathBuf;
use std::sync::{Mutex, TryLockError};

use meniscus::Source;
use meniscus::{LiveSimulation, Reconstruction, Simulation as FileSimulation};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::errors::{InputError, exception, other, warn};
use crate::files::paths;
use crate::mesh::Mesh;
use crate::options::{KeywordGroup, Keywords};
use crate::particles::Arrays;
use crate::summary::{Event, Summary};
use crate::values::Keyword;
use crate::work::{Message, Work, on_all_cores, with_progress};

/// The keywords of a conversion.
pub const SIMULATION_KEYWORDS: [&str; 10] = [
    "start",
    "end",
    "step",
    "frames",
    "resume",
    "overwrite",
    "watch",
    "fps",
    "together",
    "preview",
];

/// The frames of a simulation, all with the same cells, grid and calibration.
///
/// For a running simulation, create an object without inputs, and call ``frame(positions)`` for
/// each frame. The calibration is measured on the first frame with fluid deeper than the reach of
/// the filters (see ``settled``). A frame without particles gives an empty mesh. The object has its
/// own threads, and can be used only in the process that created it.
///
/// With inputs and an output, ``run()`` converts files to mesh files, as the program does.
///
/// Parameters
/// ----------
/// inputs : path or list of paths, optional
///     A name with ``{}`` for the frame number, a folder, a glob, a file with several steps, or a
///     list of files.
/// output : path, optional
///     A name with ``{}`` or ``{:04}`` for the frame number, a folder, or one ``.abc`` file for all
///     frames.
/// start, end, step : int, optional
///     The first and last frame of the simulation, and the step between the numbers of frames to
///     convert. Frame numbers may be negative.
/// frames : pair of int, optional
///     First and last frame to convert, both included, as one of several jobs.
/// resume : bool, optional
///     Resume an interrupted conversion.
/// overwrite : bool, optional
///     Replace existing outputs.
/// watch : float, optional
///     Convert frames as a running simulation writes them, until no file has appeared or changed
///     for this many seconds.
/// fps : float, optional
///     Frames per second, if the files contain no times.
/// together : bool, optional
///     Join the frames with the same number from all inputs, such as several fluids. Each input is
///     a name with ``{}``, a folder or a glob.
/// preview : bool, optional
///     Draw a contact sheet of the frames next to the meshes, as .png.
/// attributes : list of str, optional
///     Attributes for the vertices; by default, the velocity.
/// format : str, optional
///     The format of the files, such as "csv"; by default, the extension selects it.
/// where : str or list of str, optional
///     Use only particles whose attributes satisfy conditions, such as "Type=1" or "age<2.5";
///     ``type`` selects one of several types of particles in a file.
///
/// Other keywords are those of ``reconstruct``.
///
/// Raises
/// ------
/// TypeError, meniscus.InputError, meniscus.FileError, meniscus.DeviceError
///     For the same reasons as in ``reconstruct``.
#[pyclass(frozen, module = "meniscus")]
pub struct Simulation {
    kind: Kind,
    request: Reconstruction,
    /// The value of the keyword `attributes`, if the caller passed it.
    names: Option<Vec<String>>,
    process: u32,
}

enum Kind {
    Live(Box<Mutex<LiveSimulation>>),
    /// A conversion of files, and whether to draw a contact sheet.
    Files(Box<FileSimulation>, bool),
}

impl Simulation {
    /// Returns an error if `arrays` has an attribute that the simulation's keyword `attributes`
    /// does not name.
    fn check_attribute_names(&self, arrays: &Arrays<'_>) -> PyResult<()> {
        arrays.first_unnamed(self.names.as_deref()).map_or(Ok(()), |name| {
            Err(InputError::new_err(format!(
                "attributes: {name:?} was not named when the simulation was made; name it in the \
                 keyword attributes of Simulation"
            )))
        })
    }
}

#[pymethods]
impl Simulation {
    #[new]
    #[pyo3(
        signature = (inputs=None, output=None, **keywords),
        text_signature = "(inputs=None, output=None, *, start=None, end=None, step=None, frames=None, resume=None, \
            overwrite=None, watch=None, fps=None, together=None, preview=None, attributes=None, format=None, where=None, \
            spacing=None, radius=None, size=None, cell=None, cell_size=None, origin=None, domain=None, periodic=None, periodic_mesh=None, indicator=None, mu0=None, method=None, \
            skip_invalid=None, smooth=None, sheets=None, solid=None, solid_offset=None, sigma=None, iso=None, detail=None, normals=None, simplify=None, smallest_component=None, \
            smallest_drop=None, compress=None, up=None, particles_up=None, backend=None, device=None, threads=None, \
            memory=None, scratch=None)"
    )]
    fn new(
        inputs: Option<&Bound<'_, PyAny>>,
        output: Option<PathBuf>,
        keywords: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let process = std::process::id();
        let names =
            match keywords.map(|keywords| keywords.get_item("attributes")).transpose()?.flatten() {
                Some(value) if !value.is_none() => {
                    Some(Keyword { name: "attributes", value: &value }.names()?)
                }
                _ => None,
            };
        let known = &[
            KeywordGroup::Sampling,
            KeywordGroup::Where,
            KeywordGroup::Surface,
            KeywordGroup::Machine,
            KeywordGroup::Files,
            KeywordGroup::Attributes,
            KeywordGroup::Simulation,
        ];
        let parsed = Keywords::of("Simulation", keywords, known)?;
        let (Some(inputs), Some(output)) = (inputs, &output) else {
            if inputs.is_some() || output.is_some() {
                return Err(InputError::new_err(
                    "output: inputs and output must be given together",
                ));
            }
            reject_file_keywords(keywords)?;
            let request = parsed.on_machine(None)?;
            let live = LiveSimulation::new(&request).map_err(exception)?;
            return Ok(Self {
                kind: Kind::Live(Box::new(Mutex::new(live))),
                request,
                names,
                process,
            });
        };
        let (files, preview) = file_simulation(paths("inputs", inputs)?, output.clone(), keywords)?;
        let files = files.reconstruction(parsed.request.clone());
        let bytes = on_all_cores(|| files.check().map(|()| files.input_bytes()));
        let request = parsed.on_machine(bytes.flatten().map_err(exception)?)?;
        let files = files.reconstruction(request.clone());
        Ok(Self { kind: Kind::Files(Box::new(files), preview), request, names, process })
    }

    /// Reconstructs the next frame of a running simulation.
    ///
    /// Parameters
    /// ----------
    /// positions : array of shape (N, 3), float32 or float64
    ///     The array is read in place, as in ``reconstruct``. If N is 0, the mesh is empty.
    /// velocity : array of shape (N, 3), optional
    ///     Velocities, which are interpolated to the vertices.
    /// attributes : mapping from names to arrays of shape (N,) or (N, K), optional
    ///     Values of the attributes that the simulation's keyword ``attributes`` names.
    /// progress : callable, optional
    ///     A function that is called with the name of a stage and its progress from 0 to 1.
    ///
    /// Returns
    /// -------
    /// Mesh
    #[pyo3(signature = (positions, *, velocity=None, attributes=None, progress=None))]
    fn frame(
        &self,
        py: Python<'_>,
        positions: &Bound<'_, PyAny>,
        velocity: Option<&Bound<'_, PyAny>>,
        attributes: Option<&Bound<'_, PyAny>>,
        progress: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Mesh> {
        let Kind::Live(live) = &self.kind else {
            return Err(InputError::new_err("this simulation converts files; use run() instead"));
        };
        if self.process != std::process::id() {
            let what = "the simulation was made in another process and cannot be used in this one";
            return Err(other(what));
        }
        let arrays = Arrays::from_python(positions, velocity, attributes)?;
        self.check_attribute_names(&arrays)?;
        // Do not wait for another thread that uses this simulation, because that thread may need
        // the interpreter's lock, which this thread holds.
        let mut live = match live.try_lock() {
            Ok(live) => live,
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
            Err(TryLockError::WouldBlock) => {
                return Err(other("another thread is using this simulation"));
            }
        };
        let live = &mut *live;
        let work = Work::new();
        let request = work.attach_to(self.request.clone(), progress.is_some());
        live.set_control(&request);
        let particles = arrays.as_particles();
        let surface = with_progress(py, progress, work, || live.frame(&particles))?;
        Mesh::new(py, surface, request)
    }

    /// Whether the calibration is fixed. Always True for files, because ``run`` measures the
    /// calibration first.
    #[getter]
    fn settled(&self) -> PyResult<bool> {
        match &self.kind {
            Kind::Live(live) => match live.try_lock() {
                Ok(live) => Ok(live.is_settled()),
                Err(TryLockError::Poisoned(poisoned)) => Ok(poisoned.into_inner().is_settled()),
                Err(TryLockError::WouldBlock) => {
                    Err(other("another thread is using this simulation"))
                }
            },
            Kind::Files(..) => Ok(true),
        }
    }

    /// Converts all frames from particle files to mesh files.
    ///
    /// If a frame fails, ``run`` still converts the other frames. ``Summary.complete`` says whether
    /// all frames were converted.
    ///
    /// Parameters
    /// ----------
    /// progress : callable, optional
    ///     A function that is called with each ``Event``, on the caller's thread. An exception in
    ///     this function cancels the work.
    ///
    /// Returns
    /// -------
    /// list of Summary
    ///     One summary for each simulation in the inputs.
    #[pyo3(signature = (*, progress=None))]
    fn run(&self, py: Python<'_>, progress: Option<&Bound<'_, PyAny>>) -> PyResult<Vec<Summary>> {
        let preview = matches!(self.kind, Kind::Files(_, true));
        let (ended, warning) = self.on_files(py, progress, |files, report| {
            let mut files = files.clone();
            let sheet = preview.then(|| files.sheet()).transpose()?;
            let ended = files.run(report)?;
            let drawn = sheet.map(|sheet| sheet.draw()).transpose()?;
            Ok((ended, drawn.and_then(|sheet| sheet.warning())))
        })?;
        warn(py, warning)?;
        Ok(ended.into_iter().map(Summary::from).collect())
    }

    /// Prepares a conversion by several jobs: measures the calibration that all frames share,
    /// stores it next to the outputs, and returns the frame numbers.
    ///
    /// Returns
    /// -------
    /// list of int
    #[pyo3(signature = (*, progress=None))]
    fn plan(&self, py: Python<'_>, progress: Option<&Bound<'_, PyAny>>) -> PyResult<Vec<i64>> {
        self.on_files(py, progress, |files, report| files.plan(report))
    }
}

impl Simulation {
    fn on_files<T: Send>(
        &self,
        py: Python<'_>,
        progress: Option<&Bound<'_, PyAny>>,
        act: impl FnOnce(&FileSimulation, &dyn Fn(meniscus::Event)) -> Result<T, meniscus::Error> + Send,
    ) -> PyResult<T> {
        let Kind::Files(files, _) = &self.kind else {
            return Err(InputError::new_err("this simulation has no files; use frame() instead"));
        };
        let work = Work::<(Event, Vec<String>)>::new();
        let files =
            files.as_ref().clone().reconstruction(self.request.clone().cancel(work.cancel.clone()));
        let sender = work.sender.clone();
        let on_event = |(event, warnings): (Event, Vec<String>)| {
            warn(py, warnings)?;
            progress.map_or(Ok(()), |callback| callback.call1((event,)).map(drop))
        };
        work.run(py, on_event, || {
            let act = || {
                act(&files, &|event| {
                    // Sending cannot fail, because the caller receives events until this work ends.
                    let _ = sender.send(Message::Event(Event::of(&event)));
                })
            };
            on_all_cores(act).flatten()
        })
    }
}

/// Returns an error if keywords of a simulation from memory apply only to files.
fn reject_file_keywords(keywords: Option<&Bound<'_, PyDict>>) -> PyResult<()> {
    for (name, value) in keywords.into_iter().flatten() {
        let name: String = name.extract()?;
        if !value.is_none() && (name == "format" || SIMULATION_KEYWORDS.contains(&name.as_str())) {
            return Err(InputError::new_err(format!(
                "{name}: works only if inputs and output are given"
            )));
        }
    }
    Ok(())
}

fn file_simulation(
    inputs: Vec<PathBuf>,
    output: PathBuf,
    keywords: Option<&Bound<'_, PyDict>>,
) -> PyResult<(FileSimulation, bool)> {
    let mut files = FileSimulation::of_files(inputs, output);
    let mut preview = false;
    for (name, value) in keywords.into_iter().flatten() {
        let name: String = name.extract()?;
        if value.is_none() {
            continue;
        }
        let keyword = Keyword { name: &name, value: &value };
        files = match name.as_str() {
            "start" => files.start(keyword.frame()?),
            "end" => files.end(keyword.frame()?),
            "step" => files.step(keyword.whole()?),
            "frames" => {
                let wrong =
                    |_| PyTypeError::new_err("frames: must be a pair of numbers: first and last");
                let (first, last): (i64, i64) = value.extract().map_err(wrong)?;
                if first > last {
                    return Err(InputError::new_err(format!("frames: {first} is after {last}")));
                }
                files.frames(first..=last)
            }
            "resume" if keyword.switch()? => files.resume(),
            "overwrite" if keyword.switch()? => files.overwrite(),
            "watch" => files.watch(keyword.number()?),
            "fps" => files.fps(keyword.number()?),
            "together" if keyword.switch()? => files.together(),
            "preview" => {
                preview = keyword.switch()?;
                files
            }
            _ => files,
        };
    }
    Ok((files, preview))
}

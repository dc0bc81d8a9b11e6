//! Reads particle files into NumPy arrays, and lists the frames of a simulation.

use std::path::PathBuf;

use meniscus::Particles;
use meniscus::files::{AttributeKind, ParticleFile, frames, open_particles, velocity_attribute};
use numpy::prelude::*;
use numpy::{PyArray1, PyArray2};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::errors::exception;
use crate::mesh::column;
use crate::options::{KeywordGroup, Keywords};
use crate::work::{Work, on_all_cores};

/// The particles of a file, as ``read_particles`` returns them.
///
/// Attributes
/// ----------
/// positions : float64 array of shape (N, 3)
///     In the file's unit of length.
/// velocity : float32 array of shape (N, 3) or None
///     The attribute with the name ``velocity``, or with another usual name such as ``v``.
/// attributes : dict from names to arrays of shape (N,) or (N, K)
///     All attributes, with their names in the file. Integers are int32 or uint32, or int64 if the
///     file stores 64-bit integers; other numbers are float32.
/// spacing : float or None
///     Distance between neighbouring particles, from the file or from a scene file near it.
/// time : float or None
///     The frame's time in the simulation, in seconds, from the file.
/// up : str
///     "y" or "z": the axis that usually points up in this format, for the keyword
///     ``particles_up``.
/// format : str
///     Name of the file format.
#[pyclass(frozen, get_all, name = "Particles", module = "meniscus")]
pub struct ParticleData {
    positions: Py<PyArray2<f64>>,
    velocity: Option<Py<PyAny>>,
    attributes: Py<PyDict>,
    spacing: Option<f64>,
    time: Option<f64>,
    up: String,
    format: &'static str,
}

#[pymethods]
impl ParticleData {
    fn __len__(&self, py: Python<'_>) -> usize {
        self.positions.bind(py).shape()[0]
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        format!("<meniscus.Particles: {} of {}>", self.__len__(py), self.format)
    }
}

/// All values of an attribute, in a type that can represent each of them.
enum Values {
    Floats(Vec<f32>),
    Signed(Vec<i32>),
    Unsigned(Vec<u32>),
    Wide(Vec<i64>),
}

impl Values {
    fn of(file: &ParticleFile, index: usize) -> Self {
        let particles = &file.particles;
        let info = &particles.attributes()[index];
        let count = info.components * particles.len();
        if !info.kind.is_whole() {
            let mut values = vec![0.0; count];
            particles.attribute(index, 0, &mut values);
            return Self::Floats(values);
        }
        let mut whole = vec![0; count];
        particles.integers(index, 0, &mut whole);
        match info.kind {
            AttributeKind::Signed => Self::Signed(whole.into_iter().map(|x| x as i32).collect()),
            AttributeKind::Unsigned => {
                Self::Unsigned(whole.into_iter().map(|x| x as u32).collect())
            }
            _ => Self::Wide(whole),
        }
    }

    fn into_array(self, py: Python<'_>, components: usize) -> PyResult<Bound<'_, PyAny>> {
        match self {
            Self::Floats(values) => column(py, values, components),
            Self::Signed(values) => column(py, values, components),
            Self::Unsigned(values) => column(py, values, components),
            Self::Wide(values) => column(py, values, components),
        }
    }
}

/// Reads the particles of a file, such as .bgeo, .bgeo.sc, .vtk, .vtu, .vtp, .pvtu, .pvtp, .vtm,
/// .ply, .npy, .npz, .csv, .txt, .dat, .xyz, .dump, .lammpstrj, .json, .bi4, or HDF5. The file may
/// be compressed.
///
/// Parameters
/// ----------
/// path : str or os.PathLike
///     The file; ``sim.h5part#12`` selects step 12 of a file with several steps.
/// format : str, optional
///     The format, such as "csv"; by default, the extension selects it.
/// where : str or list of str, optional
///     Use only particles whose attributes satisfy conditions, such as "Type=1" or "age<2.5";
///     ``type`` selects one of several types of particles in a file.
///
/// Returns
/// -------
/// Particles
///
/// Raises
/// ------
/// meniscus.FileError
///     If the file is missing or damaged. It is an OSError.
/// meniscus.InputError
///     If the extension is unknown. It is a ValueError.
#[pyfunction]
#[pyo3(signature = (path, *, **keywords), text_signature = "(path, *, format=None, where=None)")]
pub fn read_particles(
    py: Python<'_>,
    path: PathBuf,
    keywords: Option<&Bound<'_, PyDict>>,
) -> PyResult<ParticleData> {
    let keywords =
        Keywords::of("read_particles", keywords, &[KeywordGroup::Files, KeywordGroup::Where])?;
    let settings = keywords.request.settings();
    let read = || {
        let file = open_particles(&path, settings)?;
        let particles = &file.particles;
        let mut positions = vec![[0.0; 3]; particles.len()];
        particles.positions(0, &mut positions);
        let values: Vec<_> =
            (0..particles.attributes().len()).map(|index| Values::of(&file, index)).collect();
        particles.check().map_err(|fault| meniscus::Error::Frame {
            path: Some(path.clone()),
            fault: fault.into(),
        })?;
        Ok((file, positions, values))
    };
    let (file, positions, values) =
        Work::<()>::new().run(py, |()| Ok(()), || on_all_cores(read).flatten())?;
    let count = positions.len();
    let positions = PyArray1::from_vec(py, positions.into_flattened()).reshape([count, 3])?;
    let attributes = PyDict::new(py);
    let infos = file.particles.attributes();
    let velocity = velocity_attribute(infos);
    let mut found = None;
    for (index, (info, values)) in infos.iter().zip(values).enumerate() {
        let values = values.into_array(py, info.components)?;
        if velocity == Some(index) {
            found = Some(values.clone().unbind());
        }
        attributes.set_item(&info.name, values)?;
    }
    Ok(ParticleData {
        positions: positions.unbind(),
        velocity: found,
        attributes: attributes.unbind(),
        spacing: file.spacing,
        time: file.time,
        up: settings.usual_up(&path).to_string().to_lowercase(),
        format: file.format,
    })
}

/// Lists the frames of a simulation with their numbers and files, as ``Simulation`` finds them.
///
/// Parameters
/// ----------
/// inputs : path or list of paths
///     A name with ``{}`` for the frame number, a folder, a glob, a file with several steps, or a
///     list of files.
///
/// Returns
/// -------
/// list of pairs of int and pathlib.Path
///     The frames in ascending order of their numbers, which may be negative. The path
///     ``sim.h5part#12`` means step 12 of a file with several steps. If a frame is in several
///     files, the list contains the first of these files.
///
/// Raises
/// ------
/// meniscus.InputError, meniscus.FileError
///     If a file does not exist, if there are no frames, if the frames belong to several
///     simulations, or if the folder cannot be read.
#[pyfunction]
pub fn list_frames(py: Python<'_>, inputs: &Bound<'_, PyAny>) -> PyResult<Vec<(i64, PathBuf)>> {
    let inputs = paths("inputs", inputs)?;
    let found = py.detach(|| on_all_cores(|| frames(&inputs)).flatten()).map_err(exception)?;
    Ok(found.into_iter().map(|frame| (frame.number, frame.path)).collect())
}

/// Takes the value of the keyword `name`: a path, or a list of paths.
pub fn paths(name: &str, inputs: &Bound<'_, PyAny>) -> PyResult<Vec<PathBuf>> {
    if let Ok(path) = inputs.extract::<PathBuf>() {
        return Ok(vec![path]);
    }
    let several = inputs.try_iter().and_then(|paths| paths.map(|path| path?.extract()).collect());
    several.map_err(|_| PyTypeError::new_err(format!("{name}: must be a path or a list of paths")))
}

//! The Python class `Frame`: particles that are sampled once, for several surfaces or for a packed
//! frame.

use std::path::PathBuf;
use std::sync::Arc;

use meniscus::Reconstruction;
use meniscus::files::Replace;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::errors::{other, warn};
use crate::files::paths;
use crate::mesh::Mesh;
use crate::options::{KeywordGroup, Keywords};
use crate::particles::Arrays;
use crate::volume::Volume;
use crate::work::{Work, with_progress};

/// The groups of keywords that apply to a frame from a file.
const FRAME_KEYWORD_GROUPS: &[KeywordGroup] = &[
    KeywordGroup::Sampling,
    KeywordGroup::Where,
    KeywordGroup::Surface,
    KeywordGroup::Machine,
    KeywordGroup::Files,
    KeywordGroup::Attributes,
];

/// A sampled frame: the samples of its cells, and other data that surfaces need. The frame no
/// longer needs the particles.
///
/// ``Frame(positions, ...)`` samples the particles, and takes the keywords of ``reconstruct``.
/// ``surface()`` computes a surface with the same or other settings, and can be called repeatedly.
/// The frame has its own threads, and can be used only in the process that created it.
///
/// Raises
/// ------
/// The errors of ``reconstruct``.
#[pyclass(frozen, module = "meniscus")]
pub struct Frame {
    sampled: Arc<meniscus::Frame>,
    /// The keywords of the constructor.
    constructor_keywords: Py<PyDict>,
    attribute_names: Option<Vec<String>>,
    process: u32,
}

impl Frame {
    /// The request with the constructor's keywords, overridden by `keywords`.
    fn request(
        &self,
        function: &str,
        keywords: Option<&Bound<'_, PyDict>>,
        py: Python<'_>,
    ) -> PyResult<Reconstruction> {
        let all = self.constructor_keywords.bind(py).copy()?;
        if let Some(keywords) = keywords {
            // Reject keywords outside `KeywordGroup::Surface`.
            Keywords::of(function, Some(keywords), &[KeywordGroup::Surface])?;
            all.update(keywords.as_mapping())?;
        }
        let request = Keywords::of(function, Some(&all), FRAME_KEYWORD_GROUPS)?.request;
        Ok(match &self.attribute_names {
            Some(names) => request.attributes(names),
            None => request,
        })
    }

    fn check_process(&self) -> PyResult<()> {
        if self.process == std::process::id() {
            return Ok(());
        }
        Err(other("the frame was made in another process and cannot be used in this one"))
    }
}

#[pymethods]
impl Frame {
    #[new]
    #[pyo3(
        signature = (positions, *, velocity=None, attributes=None, progress=None, **keywords),
        text_signature = "(positions, *, velocity=None, attributes=None, where=None, spacing=None, radius=None, size=None, cell=None, cell_size=None, \
            origin=None, domain=None, periodic=None, periodic_mesh=None, indicator=None, mu0=None, method=None, \
            skip_invalid=None, smooth=None, sheets=None, solid=None, solid_offset=None, sigma=None, iso=None, detail=None, normals=None, simplify=None, smallest_component=None, \
            smallest_drop=None, compress=None, up=None, particles_up=None, backend=None, device=None, threads=None, \
            memory=None, scratch=None, progress=None)"
    )]
    fn new(
        py: Python<'_>,
        positions: &Bound<'_, PyAny>,
        velocity: Option<&Bound<'_, PyAny>>,
        attributes: Option<&Bound<'_, PyAny>>,
        progress: Option<&Bound<'_, PyAny>>,
        keywords: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let constructor_keywords =
            keywords.map_or_else(|| Ok(PyDict::new(py)), |keywords| keywords.copy())?;
        let keywords = Keywords::of(
            "Frame",
            keywords,
            &[
                KeywordGroup::Sampling,
                KeywordGroup::Where,
                KeywordGroup::Surface,
                KeywordGroup::Machine,
            ],
        )?;
        let arrays = Arrays::from_python(positions, velocity, attributes)?;
        let mut request = keywords.on_machine(Some(arrays.positions.bytes()))?;
        let attribute_names = arrays.attribute_names();
        if let Some(names) = &attribute_names {
            request = request.attributes(names);
        }
        let work = Work::new();
        let request = work.attach_to(request, progress.is_some());
        let particles = arrays.as_particles();
        let sampled = with_progress(py, progress, work, || request.sample(&particles))?;
        Ok(Self {
            sampled: Arc::new(sampled),
            constructor_keywords: constructor_keywords.unbind(),
            attribute_names,
            process: std::process::id(),
        })
    }

    /// Opens a packed frame that ``save`` or the program's ``pack`` wrote, or samples the particles
    /// of a file without making arrays of them.
    ///
    /// Parameters
    /// ----------
    /// path : str or os.PathLike, or list of them
    ///     A .mnf file or a particle file. The particles of several files, such as several fluids,
    ///     give one surface, with the attributes that all these files have.
    /// attributes : list of str, optional
    ///     Attributes for the vertices; by default, the velocity.
    /// format : str, optional
    ///     The format, such as "csv"; by default, the extension selects it.
    /// where : str or list of str, optional
    ///     Use only particles whose attributes satisfy conditions, such as "Type=1" or "age<2.5";
    ///     ``type`` selects one of several types of particles in a file.
    ///
    /// Other keywords are those of ``reconstruct``. For a packed frame, keywords that affect the
    /// sampling cause an error.
    #[staticmethod]
    #[pyo3(
        signature = (path, *, progress=None, **keywords),
        text_signature = "(path, *, attributes=None, format=None, where=None, spacing=None, radius=None, size=None, cell=None, cell_size=None, \
            origin=None, domain=None, periodic=None, periodic_mesh=None, indicator=None, mu0=None, method=None, \
            skip_invalid=None, smooth=None, sheets=None, solid=None, solid_offset=None, sigma=None, iso=None, detail=None, normals=None, simplify=None, smallest_component=None, \
            smallest_drop=None, compress=None, up=None, particles_up=None, backend=None, device=None, threads=None, \
            memory=None, scratch=None, progress=None)"
    )]
    fn load(
        py: Python<'_>,
        path: &Bound<'_, PyAny>,
        progress: Option<&Bound<'_, PyAny>>,
        keywords: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let files = paths("path", path)?;
        let constructor_keywords =
            keywords.map_or_else(|| Ok(PyDict::new(py)), |keywords| keywords.copy())?;
        let request = Keywords::of("load", keywords, FRAME_KEYWORD_GROUPS)?;
        let request = request.on_machine(None)?;
        let work = Work::new();
        let request = work.attach_to(request, progress.is_some());
        let sampled =
            with_progress(py, progress, work, || request.open_together(&files)?.sample())?;
        Ok(Self {
            sampled: Arc::new(sampled),
            constructor_keywords: constructor_keywords.unbind(),
            attribute_names: None,
            process: std::process::id(),
        })
    }

    /// Computes a surface with these keywords. All other settings keep the values from the
    /// constructor.
    ///
    /// The keywords of ``reconstruct`` that do not need the particles are allowed. The surface uses
    /// the threads and the memory limit of the frame.
    ///
    /// Returns
    /// -------
    /// Mesh
    #[pyo3(
        signature = (*, progress=None, **keywords),
        text_signature = "($self, *, periodic_mesh=None, smooth=None, sheets=None, solid=None, solid_offset=None, sigma=None, iso=None, detail=None, normals=None, \
            simplify=None, smallest_component=None, smallest_drop=None, compress=None, up=None, particles_up=None, progress=None)"
    )]
    fn surface(
        &self,
        py: Python<'_>,
        progress: Option<&Bound<'_, PyAny>>,
        keywords: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Mesh> {
        self.check_process()?;
        let work = Work::new();
        let request = work.attach_to(self.request("surface", keywords, py)?, progress.is_some());
        let surface = with_progress(py, progress, work, || self.sampled.surface_by(&request))?;
        Mesh::new(py, surface, request)
    }

    /// Computes the signed distance from the surface that ``surface`` would return for these
    /// keywords.
    ///
    /// Returns
    /// -------
    /// Volume
    #[pyo3(
        signature = (*, progress=None, **keywords),
        text_signature = "($self, *, periodic_mesh=None, smooth=None, sheets=None, solid=None, solid_offset=None, sigma=None, iso=None, detail=None, normals=None, \
            simplify=None, smallest_component=None, smallest_drop=None, compress=None, up=None, particles_up=None, progress=None)"
    )]
    fn volume(
        &self,
        py: Python<'_>,
        progress: Option<&Bound<'_, PyAny>>,
        keywords: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Volume> {
        self.check_process()?;
        let work = Work::new();
        let request = work.attach_to(self.request("volume", keywords, py)?, progress.is_some());
        let mut warnings = Vec::new();
        let volume = with_progress(py, progress, work, || {
            let surface = self.sampled.surface_by(&request)?;
            warnings.extend(surface.report().warnings.iter().map(ToString::to_string));
            surface.volume()
        })?;
        warn(py, warnings)?;
        Volume::new(py, volume)
    }

    /// The axis that points up in the particles: "y" or "z".
    #[getter]
    fn particles_up(&self) -> String {
        self.sampled.particles_up().to_string().to_lowercase()
    }

    /// Packs the frame into a file from which this module or the program can compute surfaces.
    /// Attributes are not included.
    ///
    /// Parameters
    /// ----------
    /// path : str or os.PathLike
    ///     The .mnf file.
    /// overwrite : bool
    ///     Whether an existing file may be replaced.
    ///
    /// Returns
    /// -------
    /// int
    ///     Size, in bytes, of the file.
    #[pyo3(signature = (path, *, overwrite=false))]
    fn save(&self, py: Python<'_>, path: PathBuf, overwrite: bool) -> PyResult<u64> {
        self.check_process()?;
        let work = Work::new();
        let request = work.attach_to(Reconstruction::new(), false);
        let replace = if overwrite { Replace::Allow } else { Replace::Refuse };
        let packed = with_progress(py, None, work, || {
            self.sampled.pack(request.packed_output(&path, replace)?)
        })?;
        Ok(packed.bytes)
    }
}

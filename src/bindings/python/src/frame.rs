//! A frame that is sampled once, to be drawn as often as one likes, or packed.

use std::path::PathBuf;
use std::sync::Arc;

use meniscus::files::Replace;
use meniscus::{Frame as Sampled, Reconstruction};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::errors::other;
use crate::files::paths;
use crate::mesh::Mesh;
use crate::options::{Keywords, Known};
use crate::particles::Arrays;
use crate::work::{Work, with_progress};

/// A frame that was sampled: its field, and whatever its surface has to know of the particles,
/// which are not needed any more.
///
/// ``Frame(positions, ...)`` takes what ``reconstruct`` takes, and samples; ``surface()`` draws, as
/// asked here or otherwise, as often as one likes. It keeps threads, and is of the process that
/// made it.
///
/// Raises
/// ------
/// Those of ``reconstruct``.
#[pyclass(frozen, module = "meniscus")]
pub struct Frame {
    sampled: Arc<Sampled>,
    /// The keywords by which it was made.
    asked: Py<PyDict>,
    named: Option<Vec<String>>,
    process: u32,
}

impl Frame {
    /// The request by keywords that go before those by which it was made.
    fn request(
        &self,
        function: &str,
        keywords: Option<&Bound<'_, PyDict>>,
        py: Python<'_>,
    ) -> PyResult<Reconstruction> {
        let all = self.asked.bind(py).copy()?;
        if let Some(keywords) = keywords {
            // By what may be said, and then with all that was.
            Keywords::of(function, Some(keywords), &[Known::Surface])?;
            all.update(keywords.as_mapping())?;
        }
        let request = Keywords::of(
            function,
            Some(&all),
            &[
                Known::Sampling,
                Known::Where,
                Known::Surface,
                Known::Machine,
                Known::Files,
                Known::Attributes,
            ],
        )?
        .request;
        Ok(match &self.named {
            Some(names) => request.attributes(names),
            None => request,
        })
    }

    fn refuse_other_process(&self) -> PyResult<()> {
        if self.process == std::process::id() {
            return Ok(());
        }
        Err(other("the frame was made in another process, whose threads are not there in this one"))
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
        let asked = keywords.map_or_else(|| Ok(PyDict::new(py)), |keywords| keywords.copy())?;
        let keywords = Keywords::of(
            "Frame",
            keywords,
            &[Known::Sampling, Known::Where, Known::Surface, Known::Machine],
        )?;
        let arrays = Arrays::take(positions, velocity, attributes)?;
        let mut request = keywords.on_machine(Some(arrays.positions.bytes()))?;
        let named = arrays.named();
        if let Some(names) = &named {
            request = request.attributes(names);
        }
        let work = Work::new();
        let request = work.holds(request, progress.is_some());
        let water = arrays.water();
        let sampled = with_progress(py, progress, work, || request.sample(&water))?;
        Ok(Self {
            sampled: Arc::new(sampled),
            asked: asked.unbind(),
            named,
            process: std::process::id(),
        })
    }

    /// Opens a frame that was saved, by this or by the program's ``pack``, or samples the particles
    /// of a file, which never become arrays.
    ///
    /// Parameters
    /// ----------
    /// path : str or os.PathLike, or list of them
    ///     The file: .mnf, or one of particles. Of several files, such as of several fluids, the particles make one surface, with the
    ///     attributes that all of them have.
    /// attributes : list of str, optional
    ///     The attributes of the particles that vertices carry; their velocity by default.
    /// format : str, optional
    ///     The format, whatever the extension says, such as "csv".
    /// where : str or list of str, optional
    ///     Conditions on attributes of the particles that are used, such as "Type=1" or "age<2.5";
    ///     ``type`` is the type of particles, of a file that holds several.
    ///
    /// Further keywords are those of ``reconstruct``. Of a frame that was saved, those that say how
    /// particles are sampled are refused.
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
        let asked = keywords.map_or_else(|| Ok(PyDict::new(py)), |keywords| keywords.copy())?;
        let request = Keywords::of(
            "load",
            keywords,
            &[
                Known::Sampling,
                Known::Where,
                Known::Surface,
                Known::Machine,
                Known::Files,
                Known::Attributes,
            ],
        )?;
        let request = request.on_machine(None)?;
        let work = Work::new();
        let request = work.holds(request, progress.is_some());
        let sampled =
            with_progress(py, progress, work, || request.open_together(&files)?.sample())?;
        Ok(Self {
            sampled: Arc::new(sampled),
            asked: asked.unbind(),
            named: None,
            process: std::process::id(),
        })
    }

    /// Draws the surface, by the keywords that are given here, and where none is as was said when
    /// it was sampled.
    ///
    /// Keywords are those of ``reconstruct`` that do not need the particles again; threads and
    /// memory stay the frame's.
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
        self.refuse_other_process()?;
        let work = Work::new();
        let request = work.holds(self.request("surface", keywords, py)?, progress.is_some());
        let surface = with_progress(py, progress, work, || self.sampled.surface_by(&request))?;
        Mesh::new(py, surface, request)
    }

    /// The axis that points up in the particles: "y" or "z".
    #[getter]
    fn particles_up(&self) -> String {
        self.sampled.particles_up().to_string().to_lowercase()
    }

    /// Packs it into a file, of which surfaces can be drawn later, by this or by the program.
    /// Attributes stay behind.
    ///
    /// Parameters
    /// ----------
    /// path : str or os.PathLike
    ///     The file: .mnf.
    /// overwrite : bool
    ///     Whether a file that is there may be replaced.
    ///
    /// Returns
    /// -------
    /// int
    ///     Its size in bytes.
    #[pyo3(signature = (path, *, overwrite=false))]
    fn save(&self, py: Python<'_>, path: PathBuf, overwrite: bool) -> PyResult<u64> {
        self.refuse_other_process()?;
        let work = Work::new();
        let request = work.holds(Reconstruction::new(), false);
        let replace = if overwrite { Replace::Allow } else { Replace::Refuse };
        let packed = with_progress(py, None, work, || {
            self.sampled.pack(request.packed_output(&path, replace)?)
        })?;
        Ok(packed.bytes)
    }
}

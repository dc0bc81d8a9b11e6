//! The Python class `Mesh`: a surface as NumPy arrays, and its files.

use std::path::PathBuf;
use std::sync::OnceLock;

use meniscus::files::{AttributeKind, Replace};
use meniscus::mesh::{Measures, VertexAttribute, check, measure};
use meniscus::picture::PictureFile;
use meniscus::{Cancel, Reconstruction, Surface};
use numpy::prelude::*;
use numpy::{Element, PyArray1, PyArray2};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyDict, PyList, PyTuple};

use crate::errors::{exception, warn};
use crate::memory::{ReturnMemory, return_memory};
use crate::report::{Check, Report};
use crate::work::{Work, on_threads, with_progress};

/// A closed, oriented, 2-manifold triangle mesh around the fluid. It is the result of
/// ``reconstruct`` and similar functions.
///
/// Each array is created on first access, and later accesses return the same array. The caller may
/// modify it. Modifications do not affect ``write``, which writes the original surface.
#[pyclass(frozen, module = "meniscus")]
pub struct Mesh {
    surface: Surface,
    request: Reconstruction,
    arrays: PyOnceLock<Arrays>,
    measures: OnceLock<Measures>,
    /// Must be the last field, because fields are dropped in order. When this field is dropped, it
    /// returns the memory of the other fields to the system.
    _return_memory: ReturnMemory,
}

/// A point as a Python tuple of x, y and z.
type Point = (f64, f64, f64);

struct Arrays {
    vertices: Py<PyArray2<f64>>,
    triangles: Py<PyArray2<u32>>,
    normals: Option<Py<PyArray2<f32>>>,
    attributes: Py<PyDict>,
}

impl Mesh {
    /// Creates a mesh from a surface and its request, and issues the surface's warnings as Python
    /// warnings.
    pub fn new(py: Python<'_>, surface: Surface, request: Reconstruction) -> PyResult<Self> {
        warn(py, surface.report().warnings.iter().map(ToString::to_string))?;
        Ok(Self {
            surface,
            request,
            arrays: PyOnceLock::new(),
            measures: OnceLock::new(),
            _return_memory: ReturnMemory,
        })
    }

    fn to_mesh(&self, py: Python<'_>) -> PyResult<meniscus::mesh::Mesh> {
        py.detach(|| self.surface.to_mesh()).map_err(exception)
    }

    fn arrays(&self, py: Python<'_>) -> PyResult<&Arrays> {
        self.arrays.get_or_try_init(py, || {
            let mesh = self.to_mesh(py)?;
            let attributes = PyDict::new(py);
            for VertexAttribute { name, components, values, kind, whole } in mesh.attributes {
                let array = match kind {
                    AttributeKind::Unsigned => {
                        let whole: Vec<_> = whole.into_iter().map(|x| x as u32).collect();
                        column(py, whole, components)
                    }
                    _ if kind.is_whole() => {
                        let whole: Vec<_> = whole.into_iter().map(|x| x as i32).collect();
                        column(py, whole, components)
                    }
                    _ => column(py, values, components),
                };
                attributes.set_item(name, array?)?;
            }
            Ok(Arrays {
                vertices: three_columns(py, mesh.positions)?,
                triangles: three_columns(py, mesh.triangles)?,
                normals: mesh.normals.map(|normals| three_columns(py, normals)).transpose()?,
                attributes: attributes.unbind(),
            })
        })
    }

    fn measures(&self, py: Python<'_>) -> PyResult<&Measures> {
        if let Some(measures) = self.measures.get() {
            return Ok(measures);
        }
        let mesh = self.to_mesh(py)?;
        let threads = self.surface.report().threads;
        let measures = py.detach(|| {
            let measures = on_threads(threads, || measure(&mesh));
            drop(mesh);
            return_memory();
            measures
        });
        let measures = measures.map_err(exception)?;
        Ok(self.measures.get_or_init(|| measures))
    }
}

/// Creates an array of shape (N,), or (N, K) for K components, that takes ownership of the numbers.
pub fn column<T: Element>(
    py: Python<'_>,
    values: Vec<T>,
    components: usize,
) -> PyResult<Bound<'_, PyAny>> {
    let rows = values.len() / components;
    let values = PyArray1::from_vec(py, values);
    Ok(match components {
        1 => values.into_any(),
        _ => values.reshape([rows, components])?.into_any(),
    })
}

/// Creates an array of shape (N, 3) that takes ownership of the numbers.
fn three_columns<T: Element>(py: Python<'_>, rows: Vec<[T; 3]>) -> PyResult<Py<PyArray2<T>>> {
    let count = rows.len();
    Ok(PyArray1::from_vec(py, rows.into_flattened()).reshape([count, 3])?.unbind())
}

#[pymethods]
impl Mesh {
    /// Vertex positions: float64 of shape (V, 3), in the unit of the particles' positions.
    #[getter]
    fn vertices(&self, py: Python<'_>) -> PyResult<Py<PyArray2<f64>>> {
        Ok(self.arrays(py)?.vertices.clone_ref(py))
    }

    /// Triangles as vertex indices: uint32 of shape (T, 3), counterclockwise when seen from
    /// outside.
    #[getter]
    fn triangles(&self, py: Python<'_>) -> PyResult<Py<PyArray2<u32>>> {
        Ok(self.arrays(py)?.triangles.clone_ref(py))
    }

    /// Triangles as uint64 of shape (T, 3), for programs that need this type. Each access creates a
    /// new array.
    #[getter]
    fn triangles_u64(&self, py: Python<'_>) -> PyResult<Py<PyArray2<u64>>> {
        Ok(self.arrays(py)?.triangles.bind(py).cast_array::<u64>(false)?.unbind())
    }

    /// Outward unit normals of the vertices: float32 of shape (V, 3), or None if the surface was
    /// reconstructed without ``normals=True``.
    #[getter]
    fn normals(&self, py: Python<'_>) -> PyResult<Option<Py<PyArray2<f32>>>> {
        Ok(self.arrays(py)?.normals.as_ref().map(|normals| normals.clone_ref(py)))
    }

    /// Vertex attributes by name: float32 of shape (V,), or (V, K) for K components. Integers, such
    /// as identifiers, are int32 or uint32, and each vertex has the value of the nearest particle.
    #[getter]
    fn attributes(&self, py: Python<'_>) -> PyResult<Py<PyDict>> {
        Ok(self.arrays(py)?.attributes.clone_ref(py))
    }

    /// The enclosed volume, in cubed units of length; 0 for an empty mesh, and NaN if the mesh is
    /// not closed and oriented.
    #[getter]
    fn volume(&self, py: Python<'_>) -> PyResult<f64> {
        Ok(self.measures(py)?.volume.unwrap_or(f64::NAN))
    }

    /// The total area of all triangles, in squared units of length.
    #[getter]
    fn area(&self, py: Python<'_>) -> PyResult<f64> {
        Ok(self.measures(py)?.area)
    }

    /// The lowest and highest corner of the bounding box, or None for an empty mesh.
    #[getter]
    fn bounds(&self, py: Python<'_>) -> PyResult<Option<(Point, Point)>> {
        Ok(self.measures(py)?.bounds.map(|[low, high]| (low.into(), high.into())))
    }

    /// The report on the reconstruction.
    #[getter]
    fn report(&self) -> Report {
        self.surface.report().into()
    }

    /// Checks that the mesh is closed, oriented and 2-manifold, and measures it, as the program's
    /// ``check`` does for a file.
    fn check(&self, py: Python<'_>) -> PyResult<Check> {
        let measures = self.measures(py)?;
        let mesh = self.to_mesh(py)?;
        let threads = self.surface.report().threads;
        let found = py.detach(|| {
            let found = on_threads(threads, || check(&mesh));
            drop(mesh);
            return_memory();
            found
        });
        Ok(Check::of(&found.map_err(exception)?, measures))
    }

    /// Writes the mesh to a file whose extension selects the format: .ply, .obj, .vtk, .vtp, .pvtp,
    /// .vtkhdf, .stl, .usdc, .glb, .bgeo.sc, .abc or .vdb.
    ///
    /// The file appears completely or not at all, and is byte for byte the file that the program
    /// writes for the same particles and options.
    ///
    /// Parameters
    /// ----------
    /// path : str or os.PathLike
    ///     The file.
    /// overwrite : bool
    ///     Whether an existing file may be replaced.
    /// preview : bool
    ///     Whether to also draw a picture next to the file, with the same name and the extension
    ///     .png.
    ///
    /// Returns
    /// -------
    /// int
    ///     Size, in bytes, of the file.
    ///
    /// Raises
    /// ------
    /// meniscus.FileError
    ///     If the file already exists, or cannot be written. It is an OSError.
    /// meniscus.InputError
    ///     If the extension is unknown, or the format cannot store the data. It is a ValueError.
    #[pyo3(signature = (path, *, overwrite=false, preview=false))]
    fn write(
        &self,
        py: Python<'_>,
        path: PathBuf,
        overwrite: bool,
        preview: bool,
    ) -> PyResult<u64> {
        let work = Work::new();
        let request = work.attach_to(self.request.clone(), false);
        let replace = if overwrite { Replace::Allow } else { Replace::Refuse };
        let (bytes, warnings) = with_progress(py, None, work, || {
            let output = request.output(&path, replace)?;
            let picture =
                preview.then(|| PictureFile::beside(&path, replace, &Cancel::new())).transpose()?;
            let warnings = self.surface.warnings_in(output.format())?;
            let bytes = self.surface.write_to(output)?;
            if let Some(file) = picture {
                file.write(&self.surface.preview()?)?;
            }
            Ok((bytes, warnings))
        })?;
        warn(py, warnings.iter().map(|warning| format!("{}: {warning}", path.display())))?;
        Ok(bytes)
    }

    /// Keyword arguments for ``trimesh.Trimesh``: ``trimesh.Trimesh(**mesh.for_trimesh())``.
    fn for_trimesh<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let arrays = self.arrays(py)?;
        let keywords = PyDict::new(py);
        keywords.set_item("vertices", &arrays.vertices)?;
        keywords.set_item("faces", &arrays.triangles)?;
        keywords.set_item("vertex_normals", &arrays.normals)?;
        keywords.set_item("vertex_attributes", &arrays.attributes)?;
        // Without this keyword, trimesh would merge vertices whose positions are almost equal, and
        // so change the connectivity of the mesh.
        keywords.set_item("process", false)?;
        Ok(keywords)
    }

    /// Keyword arguments for ``meshio.Mesh``: ``meshio.Mesh(**mesh.for_meshio())``.
    fn for_meshio<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let arrays = self.arrays(py)?;
        let cells = PyTuple::new(
            py,
            [
                "triangle".into_pyobject(py)?.into_any(),
                arrays.triangles.bind(py).clone().into_any(),
            ],
        )?;
        let point_data = arrays.attributes.bind(py).copy()?;
        if let Some(normals) = &arrays.normals {
            point_data.set_item("normals", normals)?;
        }
        let keywords = PyDict::new(py);
        keywords.set_item("points", &arrays.vertices)?;
        keywords.set_item("cells", PyList::new(py, [cells])?)?;
        keywords.set_item("point_data", point_data)?;
        Ok(keywords)
    }

    fn __repr__(&self) -> String {
        let mesh = self.surface.mesh();
        format!(
            "<meniscus.Mesh: {} vertices, {} triangles>",
            mesh.vertex_count(),
            mesh.triangle_count()
        )
    }
}

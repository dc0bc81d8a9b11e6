//! A level set as NumPy arrays.

use numpy::prelude::*;
use numpy::{PyArray1, PyArray2, PyArray4};
use pyo3::prelude::*;

/// Voxels along the edge of a brick.
const EDGE: usize = 8;

/// The signed distances of a grid's voxels from a surface, as ``Frame.volume`` returns them.
///
/// Voxels are stored in bricks of 8 x 8 x 8. Only bricks with a voxel less than three voxels from
/// the surface are stored. A .vdb file of the same surface contains the same values in its grid
/// ``surface``. To make an OpenVDB grid, copy each brick:
/// ``grid.copyFromArray(values[i], ijk=tuple(origins[i]))``.
#[pyclass(frozen, module = "meniscus")]
pub struct Volume {
    origins: Py<PyArray2<i32>>,
    values: Py<PyArray4<f32>>,
    transform: Py<PyArray2<f64>>,
    voxel_size: f64,
}

impl Volume {
    /// Moves a volume of the library into NumPy arrays.
    pub fn new(py: Python<'_>, volume: meniscus::Volume) -> PyResult<Self> {
        let meniscus::Volume { origin: [x, y, z], voxel_size: size, corners, distances } = volume;
        let count = corners.len();
        let transform =
            [[size, 0.0, 0.0, x], [0.0, size, 0.0, y], [0.0, 0.0, size, z], [0.0, 0.0, 0.0, 1.0]];
        Ok(Self {
            origins: PyArray1::from_vec(py, corners.into_flattened()).reshape([count, 3])?.unbind(),
            values: PyArray1::from_vec(py, distances).reshape([count, EDGE, EDGE, EDGE])?.unbind(),
            transform: PyArray1::from_vec(py, transform.as_flattened().to_vec())
                .reshape([4, 4])?
                .unbind(),
            voxel_size: size,
        })
    }
}

#[pymethods]
impl Volume {
    /// The voxel coordinates of the first voxel of each brick: int32 of shape (B, 3), multiples of
    /// 8 in ascending order.
    #[getter]
    fn origins(&self, py: Python<'_>) -> Py<PyArray2<i32>> {
        self.origins.clone_ref(py)
    }

    /// The distance of each brick's voxels from the surface, in the unit of the positions: float32
    /// of shape (B, 8, 8, 8), indexed by x, y and z, negative inside. Where the surface is more
    /// than three voxels away, the magnitude of the distance is three voxels.
    #[getter]
    fn values(&self, py: Python<'_>) -> Py<PyArray4<f32>> {
        self.values.clone_ref(py)
    }

    /// The distance between neighbouring voxels, in the unit of the positions.
    #[getter]
    fn voxel_size(&self) -> f64 {
        self.voxel_size
    }

    /// The matrix that converts voxel coordinates to positions, for column vectors: float64 of
    /// shape (4, 4).
    #[getter]
    fn transform(&self, py: Python<'_>) -> Py<PyArray2<f64>> {
        self.transform.clone_ref(py)
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        let bricks = self.origins.bind(py).len() / 3;
        format!("<meniscus.Volume: {bricks} bricks, voxel size {}>", self.voxel_size)
    }
}

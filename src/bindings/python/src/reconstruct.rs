//! `meniscus.reconstruct`: a frame from memory to a mesh, in one call.

use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::mesh::Mesh;
use crate::options::{Keywords, Known};
use crate::particles::Arrays;
use crate::work::{Work, with_progress};

/// Reconstructs the surface of particles: a closed, oriented, 2-manifold triangle mesh.
///
/// Keywords are the options of ``meniscus reconstruct``, whose ``--help`` says more of each. None
/// is needed: what is not said is estimated, or the default. Lengths are in the unit of the
/// positions.
///
/// Parameters
/// ----------
/// positions : array of shape (N, 3), float32 or float64
///     NumPy's, or any that shares its memory by DLPack, the array interface or the buffer protocol; with any strides, also read-only. It
///     is read where it is, and never copied.
/// velocity : array of shape (N, 3), optional
///     Velocities, which the vertices carry as ``attributes["velocity"]``.
/// attributes : mapping from names to arrays of shape (N,) or (N, K), optional
///     Further values, which the vertices carry. What is called ``v`` or the like is ``velocity`` there. Of integers, such as identifiers,
///     a vertex has those of the particle nearest to it; they have to fit 32 bits.
/// where : str or list of str, optional
///     Conditions on ``attributes`` of the particles that are used, such as "Type=1" or "age<2.5 and z>0".
/// spacing, radius : float, optional
///     Distance between neighbouring particles, or half of it. Estimated, if neither is given.
/// cell, cell_size : float, optional
///     Edge of a cell in spacings (0.5 by default, renders want 0.25), or as a length.
/// origin : three floats, optional
///     A corner of the grid's cells.
/// domain : six floats or None, or two corners, or "auto", optional
///     A tank, x0, y0, z0, x1, y1, z1, at whose walls the fluid ends exactly; None for a side without a wall. "auto" finds the walls.
/// periodic : six floats or None, or two corners, optional
///     A box that repeats itself; None for both ends of an axis that is open.
/// periodic_mesh : "cut" or "overlap", optional
///     Where the mesh ends at the faces of a periodic box.
/// indicator : "cloud", "counting" or "symmetry", optional
///     How a cell's share of fluid is told; "cloud" by default, the others are the paper's.
/// mu0 : float, optional
///     Mean number of particles in a full cell, for counting.
/// method : "dif", "mueller", "zhu-bridson" or "yu-turk", optional
///     Discrete indicator functions, or a kernel method to compare them with.
/// skip_invalid : bool, optional
///     Leave out particles that are not finite or too far away, which are an error otherwise.
/// smooth : float, optional
///     Width of smoothing in spacings, 1.6 by default: more is calmer, 2 for the noise of FLIP.
/// sigma : float, optional
///     Width of the Gaussian in cells, for the paper's indicators.
/// iso : float or "auto", optional
///     Isovalue between 0 and 1, for the paper's indicators and kernel methods.
/// detail : bool, optional
///     Recover details that smoothing loses, for the paper's indicators.
/// normals : bool, optional
///     Make vertex normals, from the field's gradient.
/// simplify : float, optional
///     Use fewer triangles, none farther off than so many cells.
/// smallest_component : float, optional
///     Leave out components of less volume than so many cells.
/// smallest_drop : int, optional
///     Leave out drops of fewer particles.
/// compress : bool, optional
///     Write .glb files quantized and compressed.
/// up, particles_up : "y" or "z", optional
///     The axis that points up in files, and in the particles.
/// backend : "auto", "cpu" or "vulkan", optional
///     Where it is computed: the same bytes everywhere.
/// device : str or int, optional
///     The Vulkan device, by number, UUID or a part of its name.
/// threads : int, optional
///     Threads to use; all cores by default.
/// memory : int in bytes or a str such as "512MiB", optional
///     Memory that may be used; the rest goes through scratch files. Three quarters of what is available by default.
/// scratch : str or os.PathLike, optional
///     Folder for scratch files; the system's for temporary files by default.
/// progress : callable, optional
///     Is called with the name of a stage and the share of it that is done, from 0 to 1, on the caller's thread. What it raises ends the
///     work.
///
/// Returns
/// -------
/// Mesh
///
/// Raises
/// ------
/// TypeError
///     For an array of another kind, or one on a device.
/// meniscus.InputError
///     For numbers out of range, arrays of another shape, particles that have no surface, or none at all; a ValueError, as all of another
///     shape are.
/// meniscus.FileError
///     For scratch files that fail; an OSError.
/// meniscus.DeviceError
///     For a device that was asked for, and cannot be used.
/// KeyboardInterrupt
///     On Ctrl-C, soon after.
#[pyfunction]
#[pyo3(
    signature = (positions, *, velocity=None, attributes=None, progress=None, **keywords),
    text_signature = "(positions, *, velocity=None, attributes=None, where=None, spacing=None, radius=None, cell=None, cell_size=None, \
        origin=None, domain=None, periodic=None, periodic_mesh=None, indicator=None, mu0=None, method=None, skip_invalid=None, \
        smooth=None, sheets=None, sigma=None, iso=None, detail=None, normals=None, simplify=None, smallest_component=None, smallest_drop=None, \
        compress=None, up=None, particles_up=None, backend=None, device=None, threads=None, memory=None, scratch=None, \
        progress=None)"
)]
pub fn reconstruct(
    py: Python<'_>,
    positions: &Bound<'_, PyAny>,
    velocity: Option<&Bound<'_, PyAny>>,
    attributes: Option<&Bound<'_, PyAny>>,
    progress: Option<&Bound<'_, PyAny>>,
    keywords: Option<&Bound<'_, PyDict>>,
) -> PyResult<Mesh> {
    let keywords = Keywords::of(
        "reconstruct",
        keywords,
        &[Known::Sampling, Known::Where, Known::Surface, Known::Machine],
    )?;
    let arrays = Arrays::take(positions, velocity, attributes)?;
    let mut request = keywords.on_machine(Some(arrays.positions.bytes()))?;
    if let Some(names) = arrays.named() {
        request = request.attributes(names);
    }
    let work = Work::new();
    let request = work.holds(request, progress.is_some());
    let water = arrays.water();
    let surface = with_progress(py, progress, work, || request.run(&water))?;
    Mesh::new(py, surface, request)
}

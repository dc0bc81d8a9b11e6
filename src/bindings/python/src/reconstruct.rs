//! `meniscus.reconstruct`: reconstructs a mesh from a frame in memory, in one call.

use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::mesh::Mesh;
use crate::options::{KeywordGroup, Keywords};
use crate::particles::Arrays;
use crate::work::{Work, with_progress};

/// Reconstructs the surface of particles: a closed, oriented, 2-manifold triangle mesh.
///
/// Keywords are the options of ``meniscus reconstruct``, whose ``--help`` describes them in detail.
/// All of them are optional. Lengths are in the unit of the positions.
///
/// Parameters
/// ----------
/// positions : array of shape (N, 3), float32 or float64
///     A NumPy array, or any object that shares its memory by DLPack, the array interface or the
///     buffer protocol. The array may have any strides and be read-only. It is read in place, and
///     never copied.
/// velocity : array of shape (N, 3), optional
///     Velocities of the particles; the mesh has them as ``attributes["velocity"]``.
/// attributes : mapping from names to arrays of shape (N,) or (N, K), optional
///     Further values to interpolate to the vertices. ``v`` and similar names become ``velocity``.
///     A vertex takes integers, such as identifiers, from the nearest particle; these integers must
///     fit into 32 bits.
/// where : str or list of str, optional
///     Use only particles whose ``attributes`` satisfy a condition, such as "Type=1" or
///     "age<2.5 and z>0".
/// spacing, radius : float, optional
///     Distance between neighbouring particles, or half this distance. If neither keyword is given,
///     the spacing is estimated.
/// size : str, optional
///     Attribute with the particles' sizes, if the sizes differ; "pscale", "radius" and "spacing"
///     are found without this keyword. The attribute's name determines whether its values are
///     radii, diameters, volumes, or masses, which need a density. With "none", all particles have
///     one size.
/// cell, cell_size : float, optional
///     Edge length of a cell, in spacings (0.5 by default; use 0.25 for renders) or as a length.
/// origin : three floats, optional
///     Origin of the grid: a point that is a corner of a cell.
/// domain : six floats or None, or two corners, or "auto", optional
///     Walls of a tank on which the surface ends exactly: x0, y0, z0, x1, y1, z1; None for an open
///     side. "auto" finds the walls.
/// periodic : six floats or None, or two corners, optional
///     A periodic box; None for both ends of an open axis. Particles at most one spacing outside
///     the box are moved into it by one period, and counted.
/// periodic_mesh : "cut" or "overlap", optional
///     How the mesh ends at the faces of a periodic box.
/// indicator : "cloud", "counting" or "symmetry", optional
///     Rule for computing the value of a cell from its particles: "cloud" by default. "counting"
///     and "symmetry" are the indicators of the paper that introduced the method.
/// mu0 : float, optional
///     Mean number of particles in non-empty cells, for counting.
/// method : "dif", "mueller", "zhu-bridson" or "yu-turk", optional
///     Discrete indicator functions, or a kernel method for comparison.
/// skip_invalid : bool, optional
///     Skip particles whose position is not finite, more than one spacing outside the periodic
///     box, or more than 4.19 million cells from the grid's origin along an axis, and report their
///     number; by default, such particles are an error.
/// smooth : float, optional
///     Smoothing width, in spacings, 1.6 by default; larger is smoother, and 2 is good for noisy
///     FLIP particles.
/// sheets : float, optional
///     In thin sheets and filaments, join particles that are at most this many spacings apart,
///     2.15 by default; 0 turns this off.
/// solid : list of paths, optional
///     Files of closed meshes where the fluid ends, such as obstacles.
/// solid_offset : float, optional
///     Distance, in spacings, between the fluid and solids, -0.1 by default.
/// sigma : float, optional
///     Standard deviation, in cells, of the Gaussian, for counting and symmetry.
/// iso : float or "auto", optional
///     Isovalue between 0 and 1, for counting, symmetry, mueller and yu-turk.
/// detail : bool, optional
///     Recover details, such as drops, that smoothing loses, for counting and symmetry.
/// normals : bool, optional
///     Add vertex normals, from the field's gradient.
/// simplify : float, optional
///     Merge triangles; no part of the surface moves by more than this many cells.
/// smallest_component : float, optional
///     Remove drops and bubbles with a volume of less than this many cells.
/// smallest_drop : int, optional
///     Remove drops with fewer than this many particles, estimated from the drop's volume.
/// compress : bool, optional
///     Compress the output: a .glb with quantization and EXT_meshopt_compression, a .vdb with zlib.
/// up, particles_up : "y" or "z", optional
///     Axis that points up in mesh files, and axis that points up in the particles.
/// backend : "auto", "cpu" or "vulkan", optional
///     Where to compute; the mesh has the same bytes on every backend.
/// device : str or int, optional
///     Vulkan device, by number, UUID or part of its name.
/// threads : int, optional
///     Number of threads; one per core by default.
/// memory : int in bytes or a str such as "512MiB", optional
///     Memory limit; larger frames use scratch files. The default is three quarters of the
///     available memory.
/// scratch : str or os.PathLike, optional
///     Folder for scratch files; by default the system's temporary folder.
/// progress : callable, optional
///     A function that is called on the caller's thread with the name of a stage and its progress
///     from 0 to 1. An exception in this function cancels the work.
///
/// Returns
/// -------
/// Mesh
///
/// Raises
/// ------
/// TypeError
///     If an array has the wrong type, or is on a device.
/// meniscus.InputError
///     If a number is out of range, an array has the wrong shape, or the particles have no surface.
///     It is a ValueError.
/// meniscus.FileError
///     If a scratch file cannot be written. It is an OSError.
/// meniscus.DeviceError
///     If the requested device cannot be used.
/// KeyboardInterrupt
///     On Ctrl-C.
#[pyfunction]
#[pyo3(
    signature = (positions, *, velocity=None, attributes=None, progress=None, **keywords),
    text_signature = "(positions, *, velocity=None, attributes=None, where=None, spacing=None, radius=None, size=None, cell=None, cell_size=None, \
        origin=None, domain=None, periodic=None, periodic_mesh=None, indicator=None, mu0=None, method=None, skip_invalid=None, \
        smooth=None, sheets=None, solid=None, solid_offset=None, sigma=None, iso=None, detail=None, normals=None, simplify=None, smallest_component=None, smallest_drop=None, \
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
        &[
            KeywordGroup::Sampling,
            KeywordGroup::Where,
            KeywordGroup::Surface,
            KeywordGroup::Machine,
        ],
    )?;
    let arrays = Arrays::from_python(positions, velocity, attributes)?;
    let mut request = keywords.on_machine(Some(arrays.positions.bytes()))?;
    if let Some(names) = arrays.attribute_names() {
        request = request.attributes(names);
    }
    let work = Work::new();
    let request = work.attach_to(request, progress.is_some());
    let particles = arrays.as_particles();
    let surface = with_progress(py, progress, work, || request.run(&particles))?;
    Mesh::new(py, surface, request)
}

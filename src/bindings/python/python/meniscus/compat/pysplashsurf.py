"""The interface of pysplashsurf 0.14, implemented by meniscus: import this module instead.

Keywords have the names that pysplashsurf gives them, and lengths are relative to the particle
radius. Each keyword has the same meaning as in pysplashsurf, has a similar meaning, or is ignored.
A table in the README describes every keyword. Some ignored keywords give one warning.
"""

from __future__ import annotations

import enum
import os
import warnings
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from .. import MeshWarning, Report, reconstruct

__all__ = [
    "Aabb3d",
    "MeshType",
    "MeshWithData",
    "SurfaceReconstruction",
    "TriMesh3d",
    "UniformGrid",
    "reconstruct_surface",
    "reconstruction_pipeline",
]

_Array: TypeAlias = npt.NDArray[Any]
_Corner: TypeAlias = Sequence[float] | npt.NDArray[Any] | None

# The smoothing width in spacings is 0.8 times splashsurf's smoothing length in particle radii,
# within limits. The 2 radii that splashsurf recommends give the library's default of 1.6 spacings.
_SPACINGS_PER_RADIUS = 0.8
_NARROWEST, _WIDEST = 0.8, 4.0


class MeshType(enum.Enum):
    """The type of mesh in a ``MeshWithData``: always triangles."""

    Tri3d = 0
    MixedTriQuad3d = 1


class Aabb3d:
    """An axis-aligned box, defined by its lowest and highest corner."""

    def __init__(self, low: _Array, high: _Array) -> None:
        self.min = np.asarray(low, dtype=np.float64)
        self.max = np.asarray(high, dtype=np.float64)

    @staticmethod
    def from_min_max(min: Sequence[float], max: Sequence[float]) -> Aabb3d:
        """Creates a box from its corners."""
        return Aabb3d(np.asarray(min), np.asarray(max))

    @staticmethod
    def from_points(points: _Array) -> Aabb3d:
        """Computes the bounding box of points."""
        return Aabb3d(points.min(axis=0), points.max(axis=0))

    def contains_point(self, point: Sequence[float]) -> bool:
        """Whether a point is inside; points on an upper face are not."""
        return bool(np.all(self.min <= point) and np.all(point < self.max))


class UniformGrid:
    """The grid of cells, restricted to the cells around the mesh."""

    def __init__(self, vertices: _Array, origin: Sequence[float], cell_size: float) -> None:
        self.cell_size = cell_size
        corner = np.asarray(origin, dtype=np.float64)
        low = high = np.zeros(3)
        if len(vertices):
            low = np.floor((vertices.min(axis=0) - corner) / cell_size) - 1
            high = np.ceil((vertices.max(axis=0) - corner) / cell_size) + 1
        self.aabb = Aabb3d(corner + low * cell_size, corner + high * cell_size)
        self.ncells_per_dim: list[int] = [int(cells) for cells in high - low]
        self.npoints_per_dim: list[int] = [cells + 1 for cells in self.ncells_per_dim]


class TriMesh3d:
    """A triangle mesh: vertices with the particles' number type, and triangles as uint64."""

    def __init__(self, vertices: _Array, triangles: npt.NDArray[np.uint64]) -> None:
        self.vertices = vertices
        self.triangles = triangles

    @property
    def dtype(self) -> np.dtype[Any]:
        """The number type of the vertices."""
        return self.vertices.dtype

    def copy(self) -> TriMesh3d:
        """Copies the mesh."""
        return TriMesh3d(self.vertices.copy(), self.triangles.copy())

    def vertex_normals_parallel(self) -> _Array:
        """Computes vertex normals: area-weighted means of the normals of the surrounding triangles."""
        a, b, c = (self.vertices[self.triangles[:, corner]] for corner in range(3))
        of_triangles = np.cross(b - a, c - a)
        normals = np.zeros_like(self.vertices)
        for corner in range(3):
            np.add.at(normals, self.triangles[:, corner], of_triangles)
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        np.divide(normals, lengths, out=normals, where=lengths > 0)
        return normals

    def write_to_file(self, path: str | os.PathLike[str], *, file_format: str | None = "vtk42") -> None:
        """Writes the mesh with meshio."""
        MeshWithData(self).write_to_file(path, file_format=file_format)


class MeshWithData:
    """A mesh with attributes of its vertices and triangles."""

    def __init__(self, mesh: TriMesh3d | MeshWithData) -> None:
        self.mesh: TriMesh3d = mesh.mesh if isinstance(mesh, MeshWithData) else mesh
        self.point_attributes: dict[str, _Array] = {}
        self.cell_attributes: dict[str, _Array] = {}

    @property
    def dtype(self) -> np.dtype[Any]:
        """The number type of the vertices."""
        return self.mesh.dtype

    @property
    def nvertices(self) -> int:
        """The number of vertices."""
        return len(self.mesh.vertices)

    @property
    def ncells(self) -> int:
        """The number of triangles."""
        return len(self.mesh.triangles)

    @property
    def mesh_type(self) -> MeshType:
        """The type of the mesh."""
        return MeshType.Tri3d

    def copy_mesh(self) -> TriMesh3d:
        """Copies the mesh without attributes."""
        return self.mesh.copy()

    def copy(self) -> MeshWithData:
        """Copies the mesh with its attributes."""
        copy = MeshWithData(self.mesh.copy())
        copy.point_attributes = {name: values.copy() for name, values in self.point_attributes.items()}
        copy.cell_attributes = {name: values.copy() for name, values in self.cell_attributes.items()}
        return copy

    def add_point_attribute(self, name: str, attribute: _Array) -> None:
        """Adds an attribute of the vertices."""
        self.point_attributes[name] = _one_each(name, attribute, self.nvertices)

    def add_cell_attribute(self, name: str, attribute: _Array) -> None:
        """Adds an attribute of the triangles."""
        self.cell_attributes[name] = _one_each(name, attribute, self.ncells)

    def write_to_file(self, path: str | os.PathLike[str], *, file_format: str | None = "vtk42") -> None:
        """Writes the mesh with meshio, as pysplashsurf does."""
        import meshio  # type: ignore[import-untyped, import-not-found, unused-ignore]

        meshio.write_points_cells(
            path,
            self.mesh.vertices,
            [("triangle", self.mesh.triangles)],
            point_data=self.point_attributes,
            cell_data={name: [values] for name, values in self.cell_attributes.items()},
            file_format=file_format,
        )


class SurfaceReconstruction:
    """The mesh before post-processing, with data of the reconstruction.

    ``particle_densities`` and ``particle_neighbors`` are always None, because the library computes
    neither.
    """

    particle_densities: None = None
    particle_neighbors: None = None

    def __init__(self, mesh: TriMesh3d, grid: UniformGrid, inside: npt.NDArray[np.bool_] | None) -> None:
        self.mesh = mesh
        self.grid = grid
        self.particle_inside_aabb = inside


def _one_each(name: str, attribute: _Array, count: int) -> _Array:
    if len(attribute) != count:
        raise ValueError(f"{name}: has {len(attribute)} values, expected {count}")
    return np.array(attribute)


_ignored: set[str] = set()


def _ignore(keywords: Mapping[str, bool]) -> None:
    """Warns about keywords that were given but have no effect, once for each keyword."""
    new = [name for name, given in keywords.items() if given and name not in _ignored]
    if new:
        _ignored.update(new)
        what = f"meniscus ignores these keywords of pysplashsurf: {', '.join(new)}"
        warnings.warn(what, MeshWarning, stacklevel=3)


def _within(points: _Array, low: _Corner, high: _Corner) -> npt.NDArray[np.bool_] | None:
    """Returns a mask of the points inside a box, or None if neither corner of the box is given."""
    if low is None and high is None:
        return None
    inside = np.ones(len(points), dtype=np.bool_)
    if low is not None:
        inside &= np.all(points >= np.asarray(low), axis=1)
    if high is not None:
        inside &= np.all(points <= np.asarray(high), axis=1)
    return inside


def _surface(
    particles: _Array,
    radius: float,
    smoothing_length: float,
    cube_size: float,
    corners: tuple[_Corner, _Corner],
    threads: int | None,
    normals: bool,
    attributes: Mapping[str, _Array],
) -> tuple[MeshWithData, SurfaceReconstruction]:
    """Converts the keywords, and reconstructs the surface with the library."""
    if not isinstance(particles, np.ndarray) or particles.dtype not in (np.float32, np.float64):
        raise TypeError("unsupported mesh scalar data type, only f32 and f64 are supported")
    inside = _within(particles, *corners)
    if inside is not None:
        particles = particles[inside]
        attributes = {name: values[inside] for name, values in attributes.items()}
    dtype = particles.dtype
    cell_size = cube_size * radius
    if not len(particles):
        no_mesh = TriMesh3d(np.empty((0, 3), dtype), np.empty((0, 3), np.uint64))
        empty = MeshWithData(no_mesh)
        if normals:
            empty.point_attributes["normals"] = np.empty((0, 3), dtype)
        for name, values in attributes.items():
            empty.point_attributes[name] = np.empty((0, *values.shape[1:]), dtype)
        return empty, SurfaceReconstruction(no_mesh, UniformGrid(particles, (0, 0, 0), cell_size), inside)
    # Use numbers as names of the attributes, because the library would rename some names, such as
    # "v", to "velocity".
    numbered = {str(number): _floats(values) for number, values in enumerate(attributes.values())}
    whole = reconstruct(
        particles,
        attributes=numbered,
        spacing=2.0 * radius,
        cell_size=cell_size,
        smooth=min(max(_SPACINGS_PER_RADIUS * smoothing_length, _NARROWEST), _WIDEST),
        normals=normals,
        threads=threads,
    )
    mesh = TriMesh3d(whole.vertices.astype(dtype, copy=False), whole.triangles_u64)
    data = MeshWithData(mesh)
    if whole.normals is not None:
        data.point_attributes["normals"] = whole.normals.astype(dtype, copy=False)
    for number, name in zip(numbered, attributes):
        data.point_attributes[name] = whole.attributes[number].astype(dtype, copy=False)
    report: Report = whole.report
    grid = UniformGrid(whole.vertices, report.origin, report.cell_size)
    return data, SurfaceReconstruction(mesh, grid, inside)


def _floats(values: _Array) -> _Array:
    """Returns float arrays unchanged, and converts arrays of other types, such as integers, to float64."""
    return values if values.dtype in (np.float32, np.float64) else values.astype(np.float64)


def _cut(data: MeshWithData, low: _Corner, high: _Corner, clamp: bool) -> MeshWithData:
    """Removes the triangles that have no vertex inside a box.

    If `clamp` is set, moves the remaining vertices that are outside the box to its nearest faces.
    """
    mesh = data.mesh
    inside = _within(mesh.vertices, low, high)
    if inside is None:
        return data
    triangles = mesh.triangles[inside[mesh.triangles].any(axis=1)]
    kept = np.zeros(len(mesh.vertices), dtype=np.bool_)
    kept[triangles] = True
    number = np.cumsum(kept, dtype=np.uint64) - np.uint64(1)
    vertices = mesh.vertices[kept]
    if clamp:
        vertices = np.clip(vertices, None if low is None else np.asarray(low), None if high is None else np.asarray(high))
    cut = MeshWithData(TriMesh3d(vertices.astype(mesh.dtype, copy=False), number[triangles]))
    cut.point_attributes = {name: values[kept] for name, values in data.point_attributes.items()}
    return cut


def reconstruct_surface(
    particles: _Array,
    *,
    particle_radius: float,
    rest_density: float = 1000.0,
    smoothing_length: float,
    cube_size: float,
    iso_surface_threshold: float = 0.6,
    aabb_min: _Corner = None,
    aabb_max: _Corner = None,
    multi_threading: bool = True,
    simd: bool = True,
    global_neighborhood_list: bool = False,
    subdomain_grid: bool = True,
    subdomain_grid_auto_disable: bool = True,
    subdomain_num_cubes_per_dim: int = 64,
) -> SurfaceReconstruction:
    """Reconstructs a surface, which is in ``.mesh.vertices`` and ``.mesh.triangles``.

    ``particles`` is an array of shape (N, 3), float32 or float64; smoothing length and cube size are relative to the particle radius.
    """
    _ignore(
        {
            "iso_surface_threshold": iso_surface_threshold != 0.6,
            "global_neighborhood_list": global_neighborhood_list,
        }
    )
    threads = None if multi_threading else 1
    corners = (aabb_min, aabb_max)
    return _surface(particles, particle_radius, smoothing_length, cube_size, corners, threads, False, {})[1]


def reconstruction_pipeline(
    particles: _Array,
    *,
    attributes_to_interpolate: Mapping[str, _Array] | None = None,
    particle_radius: float,
    rest_density: float = 1000.0,
    smoothing_length: float,
    cube_size: float,
    iso_surface_threshold: float = 0.6,
    aabb_min: _Corner = None,
    aabb_max: _Corner = None,
    multi_threading: bool = True,
    simd: bool = True,
    subdomain_grid: bool = True,
    subdomain_grid_auto_disable: bool = True,
    subdomain_num_cubes_per_dim: int = 64,
    check_mesh_closed: bool = False,
    check_mesh_manifold: bool = False,
    check_mesh_orientation: bool = False,
    check_mesh_debug: bool = False,
    mesh_cleanup: bool = False,
    mesh_cleanup_snap_dist: float | None = None,
    decimate_barnacles: bool = False,
    keep_vertices: bool = False,
    compute_normals: bool = False,
    sph_normals: bool = False,
    normals_smoothing_iters: int | None = None,
    mesh_smoothing_iters: int | None = None,
    mesh_smoothing_weights: bool = True,
    mesh_smoothing_weights_normalization: float = 13.0,
    generate_quads: bool = False,
    quad_max_edge_diag_ratio: float = 1.75,
    quad_max_normal_angle: float = 10.0,
    quad_max_interior_angle: float = 135.0,
    output_mesh_smoothing_weights: bool = False,
    output_raw_normals: bool = False,
    output_raw_mesh: bool = False,
    mesh_aabb_min: _Corner = None,
    mesh_aabb_max: _Corner = None,
    mesh_aabb_clamp_vertices: bool = True,
) -> tuple[MeshWithData, SurfaceReconstruction]:
    """Reconstructs a surface with values on its vertices.

    The surface is in ``.mesh.vertices``, ``.mesh.triangles`` and ``.point_attributes``.

    ``particles`` is an array of shape (N, 3), float32 or float64; smoothing length and cube size are relative to the particle radius. The
    mesh is closed and manifold, unless it is cut off at ``mesh_aabb_min`` and ``mesh_aabb_max``.
    """
    _ignore(
        {
            "iso_surface_threshold": iso_surface_threshold != 0.6,
            "mesh_cleanup_snap_dist": mesh_cleanup_snap_dist is not None,
            "generate_quads": generate_quads,
            "output_mesh_smoothing_weights": output_mesh_smoothing_weights,
        }
    )
    data, reconstruction = _surface(
        particles,
        particle_radius,
        smoothing_length,
        cube_size,
        (aabb_min, aabb_max),
        None if multi_threading else 1,
        compute_normals,
        attributes_to_interpolate or {},
    )
    data = _cut(data, mesh_aabb_min, mesh_aabb_max, mesh_aabb_clamp_vertices)
    if compute_normals and output_raw_normals:
        data.point_attributes["raw_normals"] = data.point_attributes["normals"].copy()
    if output_raw_mesh:
        reconstruction.mesh = reconstruction.mesh.copy()
    return data, reconstruction

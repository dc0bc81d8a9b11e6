import os
import pathlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Literal, Protocol, TypeAlias, TypedDict, final

import numpy as np
import numpy.typing as npt
from typing_extensions import Buffer, Unpack

__all__ = [
    "Check",
    "Event",
    "Frame",
    "Mesh",
    "Particles",
    "Report",
    "Simulation",
    "Summary",
    "Volume",
    "__version__",
    "list_frames",
    "program",
    "read_particles",
    "reconstruct",
]

__version__: str

class _DLPack(Protocol):
    def __dlpack_device__(self) -> tuple[Any, Any]: ...

_Array: TypeAlias = npt.NDArray[np.float32] | npt.NDArray[np.float64] | _DLPack | Buffer
_Column: TypeAlias = _Array | npt.NDArray[np.integer[Any]]
_Path: TypeAlias = str | os.PathLike[str]
_Point: TypeAlias = Sequence[float] | npt.NDArray[Any]
_Box: TypeAlias = Sequence[float | None] | Sequence[Sequence[float | None]] | npt.NDArray[Any]
_Format: TypeAlias = Literal["bgeo", "bi4", "csv", "hdf5", "json", "lammps", "npy", "npz", "ply", "pvtp", "tecplot", "vtk", "vtp", "xyz"]
_Progress: TypeAlias = Callable[[str, float], object]

# Keywords, which are the program's options. Each keyword is declared in only one of these classes.

class _Sampling(TypedDict, total=False):
    """Keywords for sampling the particles."""

    spacing: float | None
    radius: float | None
    size: str | None
    cell: float | None
    cell_size: float | None
    origin: _Point | None
    domain: _Box | Literal["auto"] | None
    periodic: _Box | None
    indicator: Literal["cloud", "counting", "symmetry"] | None
    mu0: float | None
    method: Literal["dif", "mueller", "zhu-bridson", "yu-turk"] | None
    skip_invalid: bool | None
    where: str | Iterable[str] | None

class _Surface(TypedDict, total=False):
    """Keywords for computing a surface from sampled particles."""

    periodic_mesh: Literal["cut", "overlap"] | None
    smooth: float | None
    sheets: float | None
    solid: Iterable[_Path] | None
    solid_offset: float | None
    sigma: float | None
    iso: float | Literal["auto"] | None
    detail: bool | None
    normals: bool | None
    simplify: float | None
    smallest_component: float | None
    smallest_drop: int | None
    compress: bool | None
    up: Literal["y", "z"] | None
    particles_up: Literal["y", "z"] | None

class _Machine(TypedDict, total=False):
    """Keywords for the backend, threads and memory."""

    backend: Literal["auto", "cpu", "vulkan"] | None
    device: str | int | None
    threads: int | None
    memory: int | str | None
    scratch: _Path | None

class _OfArrays(_Sampling, _Surface, _Machine, total=False):
    """Keywords of functions that take particles as arrays."""

class _OfFiles(_OfArrays, total=False):
    """Keywords of functions that read particle files."""

    attributes: Iterable[str] | None
    format: _Format | None

class _OfFrames(_OfFiles, total=False):
    """Keywords for the frames of a simulation."""

    start: int | None
    end: int | None
    step: int | None
    frames: tuple[int, int] | None
    resume: bool | None
    overwrite: bool | None
    watch: float | None
    fps: float | None
    together: bool | None
    preview: bool | None

def reconstruct(
    positions: _Array,
    *,
    velocity: _Array | None = None,
    attributes: Mapping[str, _Column] | None = None,
    progress: _Progress | None = None,
    **options: Unpack[_OfArrays],
) -> Mesh: ...
def list_frames(inputs: _Path | Sequence[_Path]) -> list[tuple[int, pathlib.Path]]: ...
def program(arguments: Sequence[str]) -> int: ...
def read_particles(path: _Path, *, format: _Format | None = None, where: str | Iterable[str] | None = None) -> Particles: ...

@final
class Mesh:
    @property
    def vertices(self) -> npt.NDArray[np.float64]: ...
    @property
    def triangles(self) -> npt.NDArray[np.uint32]: ...
    @property
    def triangles_u64(self) -> npt.NDArray[np.uint64]: ...
    @property
    def normals(self) -> npt.NDArray[np.float32] | None: ...
    @property
    def attributes(self) -> dict[str, npt.NDArray[Any]]: ...
    # NaN if the mesh is not closed and oriented.
    @property
    def volume(self) -> float: ...
    @property
    def area(self) -> float: ...
    @property
    def bounds(self) -> tuple[tuple[float, float, float], tuple[float, float, float]] | None: ...
    @property
    def report(self) -> Report: ...
    def check(self) -> Check: ...
    def write(self, path: _Path, *, overwrite: bool = False, preview: bool = False) -> int: ...
    def for_trimesh(self) -> dict[str, Any]: ...
    def for_meshio(self) -> dict[str, Any]: ...

@final
class Frame:
    def __new__(
        cls,
        positions: _Array,
        *,
        velocity: _Array | None = None,
        attributes: Mapping[str, _Column] | None = None,
        progress: _Progress | None = None,
        **options: Unpack[_OfArrays],
    ) -> Frame: ...
    @staticmethod
    def load(
        path: _Path | Sequence[_Path], *, progress: _Progress | None = None, **options: Unpack[_OfFiles]
    ) -> Frame: ...
    @property
    def particles_up(self) -> Literal["y", "z"]: ...
    def surface(
        self, *, progress: _Progress | None = None, **options: Unpack[_Surface]
    ) -> Mesh: ...
    def volume(
        self, *, progress: _Progress | None = None, **options: Unpack[_Surface]
    ) -> Volume: ...
    def save(self, path: _Path, *, overwrite: bool = False) -> int: ...

@final
class Volume:
    @property
    def origins(self) -> npt.NDArray[np.int32]: ...
    @property
    def values(self) -> npt.NDArray[np.float32]: ...
    @property
    def voxel_size(self) -> float: ...
    @property
    def transform(self) -> npt.NDArray[np.float64]: ...

@final
class Simulation:
    def __new__(
        cls,
        inputs: _Path | Sequence[_Path] | None = None,
        output: _Path | None = None,
        **options: Unpack[_OfFrames],
    ) -> Simulation: ...
    @property
    def settled(self) -> bool: ...
    def frame(
        self,
        positions: _Array,
        *,
        velocity: _Array | None = None,
        attributes: Mapping[str, _Column] | None = None,
        progress: _Progress | None = None,
    ) -> Mesh: ...
    def run(self, *, progress: Callable[[Event], object] | None = None) -> list[Summary]: ...
    def plan(self, *, progress: Callable[[Event], object] | None = None) -> list[int]: ...

@final
class Particles:
    @property
    def positions(self) -> npt.NDArray[np.float64]: ...
    @property
    def velocity(self) -> npt.NDArray[np.float32] | None: ...
    @property
    def attributes(self) -> dict[str, npt.NDArray[Any]]: ...
    @property
    def spacing(self) -> float | None: ...
    @property
    def time(self) -> float | None: ...
    @property
    def up(self) -> Literal["y", "z"]: ...
    @property
    def format(self) -> str: ...
    def __len__(self) -> int: ...

@final
class Report:
    @property
    def spacing(self) -> float | None: ...
    @property
    def spacing_source(self) -> str | None: ...
    @property
    def cell_size(self) -> float: ...
    @property
    def origin(self) -> tuple[float, float, float]: ...
    @property
    def indicator(self) -> str | None: ...
    @property
    def smooth(self) -> float | None: ...
    @property
    def sigma(self) -> float | None: ...
    @property
    def iso(self) -> float | None: ...
    @property
    def particles(self) -> int: ...
    @property
    def not_finite(self) -> int: ...
    @property
    def too_far(self) -> int: ...
    @property
    def outside(self) -> int: ...
    @property
    def wrapped(self) -> int: ...
    @property
    def lost(self) -> int: ...
    @property
    def too_small(self) -> int: ...
    @property
    def whole_triangles(self) -> int: ...
    @property
    def backend(self) -> str: ...
    @property
    def threads(self) -> int: ...
    @property
    def seconds(self) -> dict[str, float]: ...
    @property
    def warnings(self) -> list[str]: ...

@final
class Check:
    @property
    def closed(self) -> bool: ...
    @property
    def oriented(self) -> bool: ...
    @property
    def manifold(self) -> bool: ...
    @property
    def boundary_edges(self) -> int: ...
    @property
    def misoriented_edges(self) -> int: ...
    @property
    def crowded_edges(self) -> int: ...
    @property
    def pinched_vertices(self) -> int: ...
    @property
    def degenerate_triangles(self) -> int: ...
    @property
    def non_finite_positions(self) -> int: ...
    @property
    def vertices(self) -> int: ...
    @property
    def triangles(self) -> int: ...
    @property
    def components(self) -> int: ...
    @property
    def euler_characteristic(self) -> int: ...
    @property
    def genus(self) -> int | None: ...
    @property
    def area(self) -> float: ...
    @property
    def volume(self) -> float | None: ...
    def __bool__(self) -> bool: ...

@final
class Event:
    @property
    def kind(self) -> str: ...
    @property
    def message(self) -> str: ...
    @property
    def frame(self) -> int | None: ...
    @property
    def output(self) -> pathlib.Path | None: ...
    @property
    def stage(self) -> str | None: ...
    @property
    def share(self) -> float | None: ...
    @property
    def done(self) -> int | None: ...
    @property
    def total(self) -> int | None: ...
    @property
    def failed(self) -> int | None: ...

@final
class Summary:
    @property
    def folder(self) -> pathlib.Path: ...
    @property
    def made(self) -> int: ...
    @property
    def failed(self) -> int: ...
    @property
    def failures(self) -> dict[int, str]: ...
    @property
    def error(self) -> str | None: ...
    @property
    def missing(self) -> list[str]: ...
    @property
    def complete(self) -> bool: ...
    @property
    def lost(self) -> int: ...
    @property
    def seconds(self) -> float: ...


"""Solids as closed meshes in memory, and as files for the library."""

from __future__ import annotations

import hashlib
from collections.abc import Hashable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

_FACE = np.dtype([("corners", "u1"), ("vertices", "<i4", 3)])


@dataclass(frozen=True)
class SolidMesh:
    """A closed triangle mesh, in the particles' coordinates."""

    name: str
    vertices: npt.NDArray[np.float64]
    triangles: npt.NDArray[np.int32]
    digest: bytes = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "digest", hashlib.blake2b(self.to_ply(), digest_size=16).digest())

    def to_ply(self) -> bytes:
        """The mesh as a binary PLY file."""
        head = (
            "ply\nformat binary_little_endian 1.0\n"
            f"element vertex {len(self.vertices)}\nproperty double x\nproperty double y\nproperty double z\n"
            f"element face {len(self.triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
        )
        faces = np.empty(len(self.triangles), _FACE)
        faces["corners"], faces["vertices"] = 3, self.triangles
        return head.encode() + self.vertices.astype("<f8").tobytes() + faces.tobytes()

    def write(self, path: Path) -> None:
        """Writes the mesh, unless the file already contains the same bytes.

        A newer file would make the library convert finished frames again.
        """
        data = self.to_ply()
        if not path.is_file() or path.read_bytes() != data:
            path.write_bytes(data)


@dataclass(frozen=True)
class Solids:
    """The solids that the fluid touches.

    `offset` is the distance, in spacings, between the fluid and the solids; None stands for the
    library's default.
    """

    meshes: tuple[SolidMesh, ...] = ()
    offset: float | None = None

    @property
    def key(self) -> Hashable:
        """A key for the cache: solids with different surfaces have different keys."""
        return tuple(mesh.digest for mesh in self.meshes), self.offset if self.meshes else None

    def written(self, folder: Path) -> list[str]:
        """Writes the meshes into a folder, as files named after their objects, and returns the files."""
        files = [folder / f"{name}.ply" for name in unique(mesh.name for mesh in self.meshes)]
        for mesh, file in zip(self.meshes, files):
            mesh.write(file)
        return [str(file) for file in files]


def unique(names: Iterable[str]) -> list[str]:
    """Converts names to distinct file names that consist of letters, digits and dashes."""
    safe = ["".join(c if c.isascii() and c.isalnum() else "-" for c in name) for name in names]
    # Each name gets a number, because on some systems names that differ only in case refer to the
    # same file. The name must not end with digits, which would look like a frame number.
    return [f"{name}-{number}-solid" for number, name in enumerate(safe)]

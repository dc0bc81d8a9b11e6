"""A surface as the arrays that Blender takes: float32 and int32, in one piece."""

from __future__ import annotations

from dataclasses import dataclass, field

import meniscus
import numpy as np
import numpy.typing as npt


class OutOfRange(Exception):
    """A mesh that single precision cannot hold."""


@dataclass(frozen=True)
class Arrays:
    """A triangle mesh with what its vertices carry, and what is to be said of it."""

    vertices: npt.NDArray[np.float32]
    triangles: npt.NDArray[np.int32]
    attributes: dict[str, npt.NDArray[np.float32] | npt.NDArray[np.int32]] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    spacing: float | None = None

    @classmethod
    def of(cls, mesh: meniscus.Mesh) -> Arrays:
        """The arrays of a mesh of the library's, whose own are given back with it."""
        # Blender has float32 only: half the memory to keep.
        with np.errstate(over="ignore", invalid="ignore"):
            vertices = mesh.vertices.astype(np.float32)
            # Infinities stay in a sum, and one is faster told than each of all.
            is_finite = np.isfinite(vertices.sum(dtype=np.float64))
        if not is_finite:
            raise OutOfRange("The surface is larger than single precision holds, which is all that Blender has")
        return cls(
            vertices=vertices,
            # The same bits, for there are never 2^31 vertices in one of Blender's meshes.
            triangles=mesh.triangles.view(np.int32),
            # Whole numbers have a sign there: beyond 2^31 they are the same bits.
            attributes={
                name: values.view(np.int32) if values.dtype == np.uint32 else values for name, values in mesh.attributes.items()
            },
            warnings=tuple(mesh.report.warnings),
            spacing=mesh.report.spacing,
        )

    @classmethod
    def empty(cls) -> Arrays:
        """No triangle."""
        return cls(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32))

    @property
    def nbytes(self) -> int:
        """Memory that they take."""
        return self.vertices.nbytes + self.triangles.nbytes + sum(values.nbytes for values in self.attributes.values())

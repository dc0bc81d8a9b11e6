"""A surface as arrays for Blender: contiguous float32 and int32."""

from __future__ import annotations

from dataclasses import dataclass, field

import meniscus
import numpy as np
import numpy.typing as npt


class OutOfRange(Exception):
    """A mesh that single precision cannot represent."""


@dataclass(frozen=True)
class Arrays:
    """A triangle mesh with attributes of its vertices, and notes about it."""

    vertices: npt.NDArray[np.float32]
    triangles: npt.NDArray[np.int32]
    attributes: dict[str, npt.NDArray[np.float32] | npt.NDArray[np.int32]] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    spacing: float | None = None

    @classmethod
    def of(cls, mesh: meniscus.Mesh) -> Arrays:
        """The arrays of a mesh of the library, whose own arrays are freed with it."""
        # Blender has only float32, which halves the memory.
        with np.errstate(over="ignore", invalid="ignore"):
            vertices = mesh.vertices.astype(np.float32)
            # A sum keeps infinities, and is faster than a test of each number.
            is_finite = np.isfinite(vertices.sum(dtype=np.float64))
        if not is_finite:
            raise OutOfRange("The surface exceeds single precision, which Blender uses")
        return cls(
            vertices=vertices,
            # The bits are the same, because a Blender mesh has fewer than 2^31 vertices.
            triangles=mesh.triangles.view(np.int32),
            # Integers are signed there: from 2^31 on, only the bits are the same.
            attributes={
                name: values.view(np.int32) if values.dtype == np.uint32 else values for name, values in mesh.attributes.items()
            },
            warnings=tuple(mesh.report.warnings),
            spacing=mesh.report.spacing,
        )

    @classmethod
    def empty(cls) -> Arrays:
        """Arrays without triangles."""
        return cls(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32))

    @property
    def nbytes(self) -> int:
        """Bytes of memory."""
        return self.vertices.nbytes + self.triangles.nbytes + sum(values.nbytes for values in self.attributes.values())

"""A surface as arrays for Blender: contiguous float32 and int32."""

from __future__ import annotations

from dataclasses import dataclass, field

import meniscus
import numpy as np
import numpy.typing as npt


class OutOfRange(Exception):
    """A mesh with coordinates that single precision cannot represent."""


@dataclass(frozen=True)
class Arrays:
    """A triangle mesh with vertex attributes, and the library's warnings about it."""

    vertices: npt.NDArray[np.float32]
    triangles: npt.NDArray[np.int32]
    attributes: dict[str, npt.NDArray[np.float32] | npt.NDArray[np.int32]] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    spacing: float | None = None
    #: The axis that points up in the coordinates of the particles.
    particles_up: str | None = None

    @classmethod
    def of(cls, mesh: meniscus.Mesh, particles_up: str | None = None) -> Arrays:
        """Converts a mesh of the library to arrays that do not keep the mesh alive."""
        # Convert positions to float32, as Blender stores them, to halve their memory.
        with np.errstate(over="ignore", invalid="ignore"):
            vertices = mesh.vertices.astype(np.float32)
            # The sum is finite only if all numbers are finite, and is faster than a test of each
            # number.
            is_finite = np.isfinite(vertices.sum(dtype=np.float64))
        if not is_finite:
            raise OutOfRange("The surface has coordinates that are too large for Blender, which uses single precision")
        return cls(
            vertices=vertices,
            # All indices keep their values as int32, because a Blender mesh has fewer than 2^31
            # vertices.
            triangles=mesh.triangles.view(np.int32),
            # Blender's integers are signed, so values of 2^31 and above become negative numbers
            # with the same bits.
            attributes={
                name: values.view(np.int32) if values.dtype == np.uint32 else values for name, values in mesh.attributes.items()
            },
            warnings=tuple(mesh.report.warnings),
            spacing=mesh.report.spacing,
            particles_up=particles_up,
        )

    @classmethod
    def empty(cls) -> Arrays:
        """Arrays without triangles."""
        return cls(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32))

    @property
    def nbytes(self) -> int:
        """The total size, in bytes, of all arrays."""
        return self.vertices.nbytes + self.triangles.nbytes + sum(values.nbytes for values in self.attributes.values())

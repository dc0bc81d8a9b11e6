"""Replaces the contents of a Blender mesh with arrays."""

from __future__ import annotations

import bpy
import numpy as np

from .surfaces.arrays import Arrays

#: Blender numbers the corners of a mesh with signed 32-bit integers.
MOST_CORNERS = 2**31 - 1
#: For each number of components, Blender's attribute type and the name of its values.
_TYPES = {1: ("FLOAT", "value"), 2: ("FLOAT2", "vector"), 3: ("FLOAT_VECTOR", "vector"), 4: ("FLOAT_COLOR", "color")}
#: For integers such as identifiers, Blender's attribute type and the name of its values.
_WHOLE = ("INT", "value")
#: The attribute from which Cycles computes motion blur.
VELOCITY = "velocity"


class TooLarge(Exception):
    """A mesh with more corners than Blender can number."""


def fill(mesh: bpy.types.Mesh, arrays: Arrays, velocity_scale: float) -> None:
    """Replaces the geometry of a mesh with a surface, and keeps the mesh's materials.

    `velocity_scale` is the number of simulated seconds per second of the scene. Velocities are
    multiplied by it, because Cycles computes motion blur from velocities per second of the scene.
    """
    corners = arrays.triangles.size
    if corners > MOST_CORNERS:
        raise TooLarge(f"The surface has {corners // 3} triangles, but a mesh in Blender can have at most {MOST_CORNERS // 3}: use larger cells")
    mesh.clear_geometry()
    mesh.vertices.add(len(arrays.vertices))
    mesh.vertices.foreach_set("co", arrays.vertices.reshape(-1))
    mesh.loops.add(corners)
    mesh.loops.foreach_set("vertex_index", arrays.triangles.reshape(-1))
    mesh.polygons.add(corners // 3)
    mesh.polygons.foreach_set("loop_start", np.arange(0, corners, 3, dtype=np.int32))
    for name, values in arrays.attributes.items():
        kind = _TYPES.get(1 if values.ndim == 1 else values.shape[1])
        # Skip attributes for which Blender has no type, and names that Blender itself uses.
        if kind is None or name in mesh.attributes:
            continue
        if values.dtype == np.int32:
            if values.ndim == 1:
                kind = _WHOLE
            else:
                values = values.astype(np.float32)
        if name == VELOCITY and velocity_scale != 1.0:
            values = values * np.float32(velocity_scale)
        mesh.attributes.new(name, kind[0], "POINT").data.foreach_set(kind[1], values.reshape(-1))
    mesh.update(calc_edges=True)

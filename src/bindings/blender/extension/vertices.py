"""Particles of an object: its vertices, or the points of its point cloud, after modifiers, in world space."""

from __future__ import annotations

import bpy
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float32]


def _read(data: bpy.types.Mesh | bpy.types.PointCloud, count: int) -> tuple[Floats, Floats | None]:
    positions = np.empty(3 * count, np.float32)
    velocity = None
    if count:
        data.attributes["position"].data.foreach_get("vector", positions)
        found = data.attributes.get("velocity")
        if found is not None and found.domain == "POINT" and found.data_type == "FLOAT_VECTOR":
            velocity = np.empty(3 * count, np.float32)
            found.data.foreach_get("vector", velocity)
            velocity = velocity.reshape(-1, 3)
    return positions.reshape(-1, 3), velocity


class Hidden(Exception):
    """An object whose shape is unknown because Blender does not evaluate hidden objects."""


def particles_of(source: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> tuple[Floats, Floats | None]:
    """Returns an object's positions, and its velocities if it has an attribute "velocity".

    Raises `Hidden` if Blender does not evaluate the object because it is hidden.
    """
    evaluated = source.evaluated_get(depsgraph)
    try:
        # Evaluate the geometry, because geometry nodes can turn any object into a point cloud.
        geometry = evaluated.evaluated_geometry()
    except TypeError:
        # Do not fall back on the dependency graph of the other mode (viewport or render): during a
        # render, Blender does not update it to the rendered frame.
        where = "in renders" if depsgraph.mode == "RENDER" else "in the viewport"
        what = f"{source.name} is hidden {where}, so Blender does not compute its vertices: show it (vertices without faces stay invisible)"
        raise Hidden(what) from None
    points = geometry.pointcloud
    if points is not None and len(points.points):
        positions, velocity = _read(points, len(points.points))
    else:
        mesh = evaluated.to_mesh(depsgraph=depsgraph)
        if mesh is None:
            return np.zeros((0, 3), np.float32), None
        positions, velocity = _read(mesh, len(mesh.vertices))
        evaluated.to_mesh_clear()
    world = np.array(evaluated.matrix_world, np.float32)
    turned = np.ascontiguousarray(positions @ world[:3, :3].T + world[:3, 3])
    if velocity is not None:
        velocity = np.ascontiguousarray(velocity @ world[:3, :3].T)
    return turned, velocity

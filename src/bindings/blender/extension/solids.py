"""Solids of a surface: a collection's objects, after modifiers, as closed meshes in particle coordinates."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np

from .surfaces.solids import SolidMesh, Solids, unique
from .vertices import Hidden


def objects_of(collection: bpy.types.Collection) -> list[bpy.types.Object]:
    """The objects of a collection that can have faces, sorted by name."""
    kinds = {"MESH", "CURVE", "SURFACE", "META", "FONT"}
    return sorted((each for each in collection.all_objects if each.type in kinds), key=lambda each: each.name)


def solids_of(settings: bpy.types.PropertyGroup, offset: float, depsgraph: bpy.types.Depsgraph) -> Solids:
    """Returns the solids that a surface's settings name, as `depsgraph` evaluates them.

    Raises `Hidden` if an object is hidden, because Blender then does not evaluate its shape.
    """
    if settings.solids is None:
        return Solids()
    shown = next((each for each in depsgraph.scene.objects if each.data == settings.id_data), None)
    # Particles from files are in the local space of the surface's object; particles from an object
    # are in world space.
    to_world = np.array(shown.matrix_world) if shown is not None and settings.source == "FILES" else np.eye(4)
    to_particles = np.linalg.inv(to_world)
    objects = [each for each in objects_of(settings.solids) if each.data != settings.id_data]
    meshes = tuple(_mesh_of(each, to_particles, depsgraph) for each in objects)
    return Solids(tuple(mesh for mesh in meshes if len(mesh.triangles)), offset)


def _mesh_of(source: bpy.types.Object, to_particles: np.ndarray, depsgraph: bpy.types.Depsgraph) -> SolidMesh:
    evaluated = source.evaluated_get(depsgraph)
    try:
        evaluated.evaluated_geometry()
    except TypeError:
        where = "in renders" if depsgraph.mode == "RENDER" else "in the viewport"
        what = f"The solid {source.name} is hidden {where}, so Blender does not compute its shape: show it, or hide it only from the camera"
        raise Hidden(what) from None
    mesh = evaluated.to_mesh(depsgraph=depsgraph)
    if mesh is None:
        return SolidMesh(source.name, np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    mesh.calc_loop_triangles()
    positions = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.attributes["position"].data.foreach_get("vector", positions)
    triangles = np.empty(3 * len(mesh.loop_triangles), np.int32)
    mesh.loop_triangles.foreach_get("vertices", triangles)
    evaluated.to_mesh_clear()
    placed = to_particles @ np.array(evaluated.matrix_world)
    triangles = triangles.reshape(-1, 3)
    if np.linalg.det(placed[:3, :3]) < 0.0:
        # The triangles of a mirrored object face inwards, so reverse them.
        triangles = triangles[:, ::-1]
    vertices = positions.reshape(-1, 3).astype(np.float64) @ placed[:3, :3].T + placed[:3, 3]
    return SolidMesh(source.name, vertices, np.ascontiguousarray(triangles))


def exported(settings: bpy.types.PropertyGroup, offset: float, scene: bpy.types.Scene, numbers: Iterator[int], folder: Path) -> list[str]:
    """Writes the solids of each file number into a folder, for a conversion.

    Returns the files' names, with {} for the number. Raises `Hidden` as `solids_of` does.
    """
    folder.mkdir(parents=True, exist_ok=True)
    shown_frame, shown_subframe, was_live = scene.frame_current, scene.frame_subframe, settings.live
    # Do not update the live surface at the frames that are evaluated here.
    settings.live = False
    names: list[str] = []
    try:
        for number in numbers:
            at = settings.start + ((number - settings.first) / settings.step if settings.step else 0.0)
            scene.frame_set(int(np.floor(at)), subframe=float(at - np.floor(at)))
            solids = solids_of(settings, offset, bpy.context.evaluated_depsgraph_get())
            names = [str(folder / f"{name}_{{}}.ply") for name in unique(mesh.name for mesh in solids.meshes)]
            for name, mesh in zip(names, solids.meshes):
                mesh.write(Path(name.replace("{}", str(number))))
    finally:
        scene.frame_set(shown_frame, subframe=shown_subframe)
        settings.live = was_live
    return names

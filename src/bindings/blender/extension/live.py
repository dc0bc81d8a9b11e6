"""Surfaces that follow the scene: they are recomputed only if their frame, a setting or their input has changed.

A mesh stores the name of the request whose surface it shows. If it should show the surface of
another request, the extension updates it. This also works after undo and in a reopened file,
because Blender restores the name with the mesh.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import bpy
import meniscus
from bpy.app.handlers import persistent

from . import meshes, solids, vertices
from .surfaces.arrays import Arrays, OutOfRange
from .surfaces.cache import Cache
from .surfaces.request import Filters, FromFile, FromPoints, Maker, Request, Sampling
from .surfaces.sequence import Listings, Timing, shown_at
from .surfaces.solids import Solids

#: The mesh's custom property that stores the name of the request whose surface the mesh shows.
MADE = "meniscus_made"
MIB = 1 << 20


@dataclass
class Status:
    """Facts about a surface that its panel shows."""

    error: str = ""
    #: Notes about the current frame, such as a missing file.
    notes: tuple[str, ...] = ()
    #: The warnings that the library gave when it computed the surface.
    warnings: tuple[str, ...] = ()
    file: str = ""
    seconds: float = 0.0
    #: Whether an update waits until the user leaves Edit Mode.
    update_pending: bool = False


class _State:
    """State that the .blend file does not store. Dictionary keys are the meshes' `session_uid`."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        self.cache: Cache[Arrays] = Cache(1024 * MIB)
        self.listings = Listings()
        self.makers: dict[int, Maker] = {}
        self.statuses: dict[int, Status] = {}
        #: For each surface that the opened .blend file contains: its frame and its request's name.
        self.saved: dict[int, tuple[int, str]] = {}
        self.renders = False

    def forget(self, gone: set[int]) -> None:
        for uid in gone:
            self.makers.pop(uid, None)
            self.statuses.pop(uid, None)
            self.saved.pop(uid, None)


_state = _State()


class InvalidSettings(Exception):
    """The settings do not define a surface. The panel shows the message, which says why."""


#: The exceptions that the panel shows as messages.
FAULTS = (InvalidSettings, OutOfRange, vertices.Hidden, meshes.TooLarge, meniscus.Error, OSError, MemoryError)


def set_cache_limit(mebibytes: int) -> None:
    """Sets the memory limit of the cache of surfaces, in MiB."""
    _state.cache.bound = mebibytes * MIB


def cached() -> tuple[int, int]:
    """The number of cached surfaces, and their size in bytes."""
    return len(_state.cache), _state.cache.nbytes


def status_of(mesh: bpy.types.Mesh) -> Status:
    """The facts that a surface's panel shows."""
    return _state.statuses.get(mesh.session_uid, Status())


def surfaces() -> Iterator[bpy.types.Mesh]:
    """All meshes that show a surface, except linked ones, which cannot be modified."""
    return (mesh for mesh in bpy.data.meshes if mesh.meniscus.source != "NONE" and mesh.library is None)


def rounded_as_typed(value: float) -> float:
    """Rounds a number to 7 significant digits, to restore the number that the user typed.

    Blender stores numbers in single precision, where 0.05 is 0.0500000007.
    """
    return float(f"{value:.7g}")


def sampling_of(settings: bpy.types.PropertyGroup, cell: float) -> Sampling:
    """Converts a surface's settings to the settings of the sampling."""
    names = tuple(name.strip() for name in settings.attributes.split(",") if name.strip())
    return Sampling(
        spacing=rounded_as_typed(settings.spacing) or None,
        cell=rounded_as_typed(cell),
        attributes=names or None,
        where=settings.where.strip() or None,
        domain=tuple(rounded_as_typed(value) for value in (*settings.tank_low, *settings.tank_high)) if settings.tank else None,
    )


def filters_of(settings: bpy.types.PropertyGroup) -> Filters:
    """Converts a surface's settings to the settings of the filters."""
    return Filters(
        smooth=rounded_as_typed(settings.smooth),
        smallest_drop=settings.smallest_drop or None,
        simplify=rounded_as_typed(settings.simplify) or None,
    )


def solids_of(settings: bpy.types.PropertyGroup, depsgraph: bpy.types.Depsgraph) -> Solids:
    """Returns the solids that a surface's settings name, as `depsgraph` evaluates them."""
    return solids.solids_of(settings, rounded_as_typed(settings.solid_offset), depsgraph)


def timing_of(settings: bpy.types.PropertyGroup) -> Timing:
    """Converts a surface's settings to the timing of its files."""
    return Timing(settings.start, settings.first, rounded_as_typed(settings.step))


def _request(
    settings: bpy.types.PropertyGroup, frame: int, depsgraph: bpy.types.Depsgraph | None, status: Status
) -> Request | None:
    """Returns the request for the surface that a mesh should show.

    Returns None if the request depends on objects but there is no `depsgraph` to evaluate them.
    """
    cell = settings.cell_render if _state.renders else settings.cell_viewport
    sampling, filters = sampling_of(settings, cell), filters_of(settings)
    if settings.source == "OBJECT" and settings.object is None:
        raise InvalidSettings("Choose the object whose vertices are the particles")
    if depsgraph is None and _is_of_objects(settings.id_data):
        return None
    touched = solids_of(settings, depsgraph) if depsgraph is not None else Solids()
    if settings.source == "OBJECT":
        positions, velocity = vertices.particles_of(settings.object, depsgraph)
        if not len(positions):
            raise InvalidSettings(f"{settings.object.name} has no vertices and no points at frame {frame}")
        status.file = f"{len(positions)} vertices of {settings.object.name}"
        return Request(FromPoints(positions, velocity, sampling), filters, touched)
    if not settings.path.strip():
        raise InvalidSettings("Choose the particle files")
    path = bpy.path.abspath(settings.path)
    frames = _state.listings.frames(path)
    shown = shown_at(frames, timing_of(settings), frame)
    status.file = shown.path
    if shown.is_gap:
        status.notes += (f"Frame {shown.wanted} is missing: showing frame {shown.number}",)
    return Request(FromFile(shown.path, sampling), filters, touched)


def _arrays(request: Request, maker: Maker) -> Arrays:
    """Returns the requested surface from the cache, or computes it."""
    found = _state.cache.get(request.key)
    if found is None:
        found = maker.make(request)
        _state.cache.put(request.key, found)
    return found


def _maker_of(mesh: bpy.types.Mesh) -> Maker:
    return _state.makers.setdefault(mesh.session_uid, Maker())


def _velocity_scale(settings: bpy.types.PropertyGroup, scene: bpy.types.Scene) -> float:
    """The number of simulated seconds per second of the scene."""
    scene_fps = scene.render.fps / scene.render.fps_base
    return settings.step * (scene_fps / settings.fps if settings.fps else 1.0)


def update(mesh: bpy.types.Mesh, scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """Recomputes a mesh's surface if its settings, its input or the scene's frame has changed."""
    settings = mesh.meniscus
    if settings.source == "NONE" or not settings.live:
        return
    began, status = time.perf_counter(), Status()
    try:
        if mesh.is_editmode:
            status.update_pending = True
            raise InvalidSettings("Leave Edit Mode to update the surface")
        request = _request(settings, scene.frame_current, depsgraph, status)
        if request is None:
            return
        scale = _velocity_scale(settings, scene)
        name = f"{request.name} {scale:g}"
        if mesh.get(MADE) == name:
            known = status_of(mesh)
            status.warnings, status.seconds = known.warnings, known.seconds
            _state.statuses[mesh.session_uid] = status
            return
        arrays = _arrays(request, _maker_of(mesh))
        status.warnings = arrays.warnings
        meshes.fill(mesh, arrays, scale)
        mesh[MADE] = name
    except FAULTS as error:
        status.error = str(error) or "Out of memory"
        if not mesh.is_editmode and _state.saved.get(mesh.session_uid) == (scene.frame_current, mesh.get(MADE)):
            # If the mesh were cleared, saving the .blend file again would lose the saved surface.
            status.notes += ("Showing the surface that was saved in the .blend file",)
        else:
            if mesh.vertices and not mesh.is_editmode:
                mesh.clear_geometry()
                mesh.update()
            mesh[MADE] = ""
        if bpy.app.background or _state.renders:
            # There is no panel in background mode and during renders, so print the error.
            print(f"{mesh.name}: {status.error}", flush=True)
    status.seconds = time.perf_counter() - began
    _state.statuses[mesh.session_uid] = status


def update_all(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None, which: Callable[[bpy.types.Mesh], bool]) -> None:
    """Updates the surfaces that `which` selects, and removes the state of deleted meshes."""
    known = list(surfaces())
    _state.forget(set(_state.statuses) - {mesh.session_uid for mesh in known})
    for mesh in known:
        if which(mesh):
            update(mesh, scene, depsgraph)


def refresh(mesh: bpy.types.Mesh) -> None:
    """Updates a mesh whose settings have changed."""
    _state.saved.pop(mesh.session_uid, None)
    context = bpy.context
    update(mesh, context.scene, context.evaluated_depsgraph_get() if _is_of_objects(mesh) else None)


def reread(mesh: bpy.types.Mesh) -> None:
    """Reads a surface's files again, ignoring the cache."""
    _state.listings.clear()
    _state.makers.pop(mesh.session_uid, None)
    _state.cache.clear()
    mesh[MADE] = ""
    refresh(mesh)


def _arrays_of(mesh: bpy.types.Mesh) -> Arrays | None:
    """The surface that a mesh should show; None if it cannot be computed."""
    scene, depsgraph = bpy.context.scene, bpy.context.evaluated_depsgraph_get()
    try:
        request = _request(mesh.meniscus, scene.frame_current, depsgraph, Status())
        return _arrays(request, _maker_of(mesh)) if request else None
    except FAULTS:
        return None


def particles_up(mesh: bpy.types.Mesh) -> str | None:
    """The axis that points up in the particle file of a surface; None if the file cannot be read."""
    arrays = _arrays_of(mesh)
    if arrays is not None:
        return arrays.particles_up
    try:
        # The first file of a sequence often contains no particles, so it has no surface.
        return meniscus.read_particles(status_of(mesh).file).up
    except FAULTS:
        return None


def spacing_used(mesh: bpy.types.Mesh) -> float | None:
    """The spacing of the surface that a mesh should show; None if it is unknown or the surface cannot be computed."""
    arrays = _arrays_of(mesh)
    return arrays.spacing if arrays else None


def _is_of_objects(mesh: bpy.types.Mesh) -> bool:
    """Whether a surface depends on other objects, because of its particles or its solids."""
    return mesh.meniscus.source == "OBJECT" or mesh.meniscus.solids is not None


def _depends_on(mesh: bpy.types.Mesh, changed: set[bpy.types.Object]) -> bool:
    """Whether a surface depends on one of the changed objects."""
    settings = mesh.meniscus
    source = {settings.object} if settings.source == "OBJECT" else set()
    touched = set(solids.objects_of(settings.solids)) if settings.solids is not None else set()
    return bool(changed & (source | touched))


def _left_edit_mode(mesh: bpy.types.Mesh) -> bool:
    """Whether an update of the surface was pending in Edit Mode, and the user has left Edit Mode."""
    return status_of(mesh).update_pending and not mesh.is_editmode


@persistent
def _before_frame(scene: bpy.types.Scene, _depsgraph: object = None) -> None:
    # Cycles evaluates subframes for motion blur. The mesh must not change at subframes, because
    # Cycles computes the blur from its velocities.
    if scene.frame_subframe == 0.0:
        update_all(scene, None, lambda mesh: not _is_of_objects(mesh))


@persistent
def _after_frame(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    # The positions of objects at a frame are available only after Blender has evaluated the frame.
    if scene.frame_subframe == 0.0:
        update_all(scene, depsgraph, _is_of_objects)


@persistent
def _after_change(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    if _state.renders:
        return
    changed = {each.id.original for each in depsgraph.updates if isinstance(each.id, bpy.types.Object)}
    if changed:
        update_all(scene, depsgraph, lambda mesh: _depends_on(mesh, changed) or _left_edit_mode(mesh))


@persistent
def _after_undo(scene: bpy.types.Scene, _depsgraph: object = None) -> None:
    _update_everything(scene)


@persistent
def _after_load(_path: object, _other: object = None) -> None:
    _state.makers.clear()
    _state.statuses.clear()
    _state.renders = False
    scene = bpy.context.scene
    # If a mesh shows no surface, its property `MADE` is empty or missing.
    _state.saved = {mesh.session_uid: (scene.frame_current, mesh[MADE]) for mesh in surfaces() if mesh.get(MADE)}
    _update_everything(scene)


def _update_everything(scene: bpy.types.Scene) -> None:
    if any(True for _ in surfaces()):
        update_all(scene, bpy.context.evaluated_depsgraph_get(), lambda _mesh: True)


@persistent
def _before_render(_scene: bpy.types.Scene, _other: object = None) -> None:
    _state.renders = True


@persistent
def _after_render(_scene: bpy.types.Scene, _other: object = None) -> None:
    _state.renders = False

    def back_to_the_viewport() -> None:
        _update_everything(bpy.context.scene)

    if bpy.app.background:
        back_to_the_viewport()
    else:
        # A render ends on a separate thread, but only the main thread may change meshes.
        bpy.app.timers.register(back_to_the_viewport, first_interval=0.0)


def _handlers() -> list[tuple[list[Callable[..., None]], Callable[..., None]]]:
    known = bpy.app.handlers
    return [
        (known.frame_change_pre, _before_frame),
        (known.frame_change_post, _after_frame),
        (known.depsgraph_update_post, _after_change),
        (known.undo_post, _after_undo),
        (known.redo_post, _after_undo),
        (known.load_post, _after_load),
        (known.render_init, _before_render),
        (known.render_complete, _after_render),
        (known.render_cancel, _after_render),
    ]


def register() -> None:
    for handlers, ours in _handlers():
        handlers.append(ours)


def unregister() -> None:
    for handlers, ours in _handlers():
        handlers.remove(ours)
    _state.reset()

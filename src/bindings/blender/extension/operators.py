"""Operators for buttons and menus: they add surfaces, reload files, measure the spacing and convert."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Set
from pathlib import Path

import bpy
import meniscus
from bpy.props import StringProperty
from bpy_extras.io_utils import ImportHelper

from . import live, solids, volumes
from .conversion import Conversion, Order
from .placing import place
from .surfaces.playing import read_time_mapping
from .surfaces.request import FromFile
from .surfaces.sequence import EXTENSIONS, number_of, sequence_of
from .vertices import Hidden

Done = Set[str]

#: The last conversion of each mesh, by the mesh's `session_uid`.
_conversions: dict[int, Conversion] = {}


def conversion_of(mesh: bpy.types.Mesh) -> Conversion | None:
    """The last conversion of a surface."""
    return _conversions.get(mesh.session_uid)


def _active(context: bpy.types.Context) -> bpy.types.Mesh | None:
    active = context.object
    return active.data if active is not None and active.type == "MESH" else None


def _is_surface(context: bpy.types.Context) -> bool:
    mesh = _active(context)
    return mesh is not None and mesh.meniscus.source != "NONE"


def _add(context: bpy.types.Context, name: str) -> bpy.types.Object:
    added = bpy.data.objects.new(name, bpy.data.meshes.new(name))
    context.collection.objects.link(added)
    for other in context.selected_objects:
        other.select_set(False)
    added.select_set(True)
    context.view_layer.objects.active = added
    # Lock the windows during renders, because the windows would read meshes while the extension
    # changes them for the render.
    context.scene.render.use_lock_interface = True
    return added


def add_files(context: bpy.types.Context, path: str) -> bpy.types.Object:
    """Adds the surface of a sequence, given as a file, a folder or a name with {}.

    The scene's first frame shows the first file. If y points up in the particles, the object is
    turned upright.
    """
    inputs = sequence_of(path)
    name = re.sub(r"[ _.-]*\{.*?\}", "", Path(inputs).name).split(".")[0] or "Surface"
    added = _add(context, name)
    settings = added.data.meniscus
    # Compute no surface until all settings are set.
    settings.live = False
    settings.source, settings.path = "FILES", inputs
    settings.start = context.scene.frame_start
    try:
        settings.first = meniscus.list_frames(bpy.path.abspath(inputs))[0][0]
    except (meniscus.Error, OSError):
        # The surface's panel will show the error.
        settings.first = number_of(path) or 0
    settings.live = True
    if live.particles_up(added.data) == "y":
        added.rotation_euler.x = math.pi / 2
    # Use one spacing for all frames, because different spacings would give different cells.
    settings.spacing = live.spacing_used(added.data) or 0.0
    return added


def add_object(context: bpy.types.Context, source: bpy.types.Object) -> bpy.types.Object:
    """Adds the surface of an object's vertices."""
    added = _add(context, f"{source.name} Surface")
    settings = added.data.meniscus
    settings.object, settings.source = source, "OBJECT"
    settings.spacing = live.spacing_used(added.data) or 0.0
    return added


def _done(operator: bpy.types.Operator, added: bpy.types.Object) -> Done:
    """Ends an operator that has added a surface, and reports an error if the surface could not be computed."""
    error = live.status_of(added.data).error
    if error:
        operator.report({"WARNING"}, error)
    return {"FINISHED"}


class AddFiles(bpy.types.Operator, ImportHelper):
    """Add a live surface of a sequence of particle files or packed frames"""

    bl_idname = "meniscus.add_files"
    bl_label = "Fluid Surface from Files"
    bl_options = {"REGISTER", "UNDO"}

    # Blender truncates the filter after 255 characters, which are enough for all extensions.
    filter_glob: StringProperty(
        default=";".join(f"*{extension}" for extension in EXTENSIONS),
        options={"HIDDEN"},
    )

    def execute(self, context: bpy.types.Context) -> Done:
        return _done(self, add_files(context, self.filepath))


class AddObject(bpy.types.Operator):
    """Add a live surface of the vertices or the point cloud of the active object"""

    bl_idname = "meniscus.add_object"
    bl_label = "Fluid Surface from Vertices"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.object is not None and context.mode == "OBJECT"

    def execute(self, context: bpy.types.Context) -> Done:
        return _done(self, add_object(context, context.object))


class Reread(bpy.types.Operator):
    """Read the files again, ignoring cached surfaces"""

    bl_idname = "meniscus.reread"
    bl_label = "Reload Files"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return _is_surface(context)

    def execute(self, context: bpy.types.Context) -> Done:
        live.reread(_active(context))
        return {"FINISHED"}


class Measure(bpy.types.Operator):
    """Read the spacing from the file of this frame, or estimate it from the particles, and use it for all frames"""

    bl_idname = "meniscus.measure"
    bl_label = "Measure the Spacing"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return _is_surface(context)

    def execute(self, context: bpy.types.Context) -> Done:
        mesh = _active(context)
        mesh.meniscus.spacing = 0.0
        found = live.spacing_used(mesh)
        if found is None:
            self.report({"WARNING"}, live.status_of(mesh).error or "The spacing of this frame cannot be estimated")
            return {"CANCELLED"}
        mesh.meniscus.spacing = found
        return {"FINISHED"}


def order_of(mesh: bpy.types.Mesh, scene: bpy.types.Scene) -> Order:
    """Returns the order for a conversion with a surface's settings, and writes the solids of all frames.

    Raises `Hidden`, `OSError`, and the library's errors about file names.
    """
    settings = mesh.meniscus
    folder = bpy.path.abspath(settings.output)
    name = bpy.path.clean_name(mesh.name).replace(".", "_").rstrip("_-")
    inputs, offset, files = bpy.path.abspath(settings.path), live.rounded_as_typed(settings.solid_offset), []
    frames = meniscus.list_frames(inputs)
    if settings.solids is not None:
        numbers = (number for number, _ in frames)
        files = solids.exported(settings, offset, scene, numbers, Path(folder, f"{name}_solids"))
    # The library names the USD stage after the meshes, without the frame number.
    are_volumes = settings.converted == "VOLUMES"
    return Order(
        inputs=inputs,
        output=os.path.join(folder, f"{name}_{{:04}}.vdb" if are_volumes else f"{name}_{{}}.usdc"),
        stage=None if are_volumes else os.path.join(folder, f"{name}.usda"),
        fps=scene.render.fps / scene.render.fps_base,
        sampling=FromFile(str(frames[0][1]), live.sampling_of(settings, settings.cell_render)).used_sampling,
        filters=live.filters_of(settings),
        solids=tuple(files),
        solid_offset=offset,
    )


def _replace(context: bpy.types.Context, mesh: bpy.types.Mesh, played: bpy.types.Object) -> list[bpy.types.Object]:
    """Replaces each object that shows a live surface with the object `played` or a copy of it.

    Hides the live surface and stops its updates.
    """
    surfaces = [shown for shown in bpy.data.objects if shown.data == mesh and shown.users_collection]
    all_played = [played, *(played.copy() for _ in surfaces[1:])]
    for shown, added in zip(surfaces, all_played):
        place(context, added, shown)
    for shown in surfaces:
        shown.hide_render = True
        shown.hide_viewport = True
    mesh.meniscus.live = False
    return all_played


def play_volumes(context: bpy.types.Context, mesh: bpy.types.Mesh, output: str) -> bpy.types.Object:
    """Replaces the live surface with a Volume object that plays a conversion's volumes."""
    files = volumes.files_of(output)
    if not files:
        raise OSError(f"{output}: the conversion wrote no files")
    added = volumes.add(context, f"{mesh.name} Volume", files, live.timing_of(mesh.meniscus))
    _replace(context, mesh, added)
    return added


def play(context: bpy.types.Context, mesh: bpy.types.Mesh, stage: str) -> list[bpy.types.Object]:
    """Replaces the live surface with objects that play a conversion's meshes.

    The objects have Mesh Sequence Cache modifiers.
    """
    before = set(bpy.data.objects)
    window = context.window or (context.window_manager.windows[0] if context.window_manager.windows else None)
    with context.temp_override(window=window) if window else context.temp_override():
        bpy.ops.wm.usd_import(filepath=stage, set_frame_range=False, relative_path=False)
    played = next((added for added in bpy.data.objects if added not in before and added.type == "MESH"), None)
    if played is None:
        raise OSError(f"{stage}: Blender imported no mesh")
    for material in mesh.materials:
        played.data.materials.append(material)
    for modifier in played.modifiers:
        if modifier.type == "MESH_SEQUENCE_CACHE":
            _match_live_timing(modifier.cache_file, mesh, stage)
    return _replace(context, mesh, played)


def _match_live_timing(cache: bpy.types.CacheFile, mesh: bpy.types.Mesh, stage: str) -> None:
    """Shows the frames of a stage at the same times as the live surface."""
    read = read_time_mapping(Path(stage).with_suffix(".usdc.json"), live.timing_of(mesh.meniscus))
    if read.offset is not None:
        cache.frame_offset = read.offset
        return
    cache.override_frame = True
    cache.driver_add("frame").driver.expression = read.expression


def _poll(uid: int) -> float | None:
    """Redraws the panels while a conversion runs, and plays the files once it is complete."""
    conversion = _conversions.get(uid)
    mesh = next((mesh for mesh in bpy.data.meshes if mesh.session_uid == uid), None)
    if conversion is None or mesh is None:
        if conversion is not None:
            conversion.cancel()
        return None
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "PROPERTIES":
                area.tag_redraw()
    if conversion.runs:
        return 0.2
    if conversion.is_complete:
        try:
            order = conversion.order
            if order.stage is None:
                play_volumes(bpy.context, mesh, order.output)
            else:
                play(bpy.context, mesh, order.stage)
            conversion.message = f"Playing {order.stage or order.output}"
        except (RuntimeError, OSError, ValueError) as error:
            conversion.error = str(error).strip()
    return None


class Convert(bpy.types.Operator):
    """Convert the sequence to files in the background, and play them as a mesh sequence cache or a volume"""

    bl_idname = "meniscus.convert"
    bl_label = "Convert"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        mesh = _active(context)
        if mesh is None or mesh.meniscus.source != "FILES":
            return False
        running = conversion_of(mesh)
        return running is None or not running.runs

    def execute(self, context: bpy.types.Context) -> Done:
        mesh = _active(context)
        if mesh.meniscus.converted == "MESHES" and not bpy.app.build_options.usd:
            self.report({"ERROR"}, "This build of Blender lacks USD, which is needed to play the meshes")
            return {"CANCELLED"}
        if mesh.meniscus.output.startswith("//") and not bpy.data.filepath:
            self.report({"ERROR"}, "Save the .blend file first, or choose an output folder without //, which means the folder of the .blend file")
            return {"CANCELLED"}
        try:
            conversion = Conversion(order_of(mesh, context.scene))
        except (Hidden, meniscus.Error, OSError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        uid = mesh.session_uid
        _conversions[uid] = conversion
        conversion.start()
        bpy.app.timers.register(lambda: _poll(uid), first_interval=0.2)
        return {"FINISHED"}


class Cancel(bpy.types.Operator):
    """Cancel the conversion after the frames in progress; finished frames are kept"""

    bl_idname = "meniscus.cancel"
    bl_label = "Cancel"

    def execute(self, context: bpy.types.Context) -> Done:
        mesh = _active(context)
        conversion = conversion_of(mesh) if mesh else None
        if conversion is not None:
            conversion.cancel()
        return {"FINISHED"}


_CLASSES = (AddFiles, AddObject, Reread, Measure, Convert, Cancel)


def register() -> None:
    for each in _CLASSES:
        bpy.utils.register_class(each)


def unregister() -> None:
    for conversion in _conversions.values():
        conversion.cancel()
    _conversions.clear()
    for each in reversed(_CLASSES):
        bpy.utils.unregister_class(each)

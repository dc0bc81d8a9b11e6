"""Panels for a surface's settings in the properties of its mesh, and menus that add a surface."""

from __future__ import annotations

import textwrap

import bpy

from . import live
from .operators import AddFiles, AddObject, Cancel, Convert, Measure, Reread, conversion_of


def _sentence(layout: bpy.types.UILayout, context: bpy.types.Context, text: str, icon: str) -> None:
    """Shows a text in a panel, broken into lines that fit the panel's width."""
    width = max(int(context.region.width / (7 * context.preferences.system.ui_scale)) - 6, 20)
    column = layout.column(align=True)
    for number, line in enumerate(textwrap.wrap(text, width)):
        column.label(text=line, icon=icon if number == 0 else "BLANK1")


class _Panel:
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "data"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.mesh is not None and context.mesh.meniscus.source != "NONE"


class MENISCUS_PT_surface(_Panel, bpy.types.Panel):
    bl_label = "Fluid Surface"

    def draw_header(self, context: bpy.types.Context) -> None:
        self.layout.prop(context.mesh.meniscus, "live", text="")

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings, status = self.layout, context.mesh.meniscus, live.status_of(context.mesh)
        layout.use_property_split = True
        if status.error:
            _sentence(layout.box(), context, status.error, "ERROR")
        for note in (*status.notes, *status.warnings):
            _sentence(layout, context, note, "INFO")
        if not context.scene.render.use_lock_interface:
            _sentence(layout, context, "Lock Interface is off in the Render menu, so rendering the surface may crash Blender", "ERROR")
        layout.prop(settings, "source")
        if settings.source == "OBJECT":
            layout.prop(settings, "object")
        else:
            layout.prop(settings, "path")
            layout.prop(settings, "where")
        if status.file and not status.error:
            made = f"{len(context.mesh.polygons):,} triangles in {status.seconds:.2f} s"
            _sentence(layout, context, f"{bpy.path.basename(status.file)}: {made}", "FILE_TICK")
        layout.operator(Reread.bl_idname)


class MENISCUS_PT_frames(_Panel, bpy.types.Panel):
    bl_label = "Frames"
    bl_parent_id = "MENISCUS_PT_surface"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return super().poll(context) and context.mesh.meniscus.source == "FILES"

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = self.layout, context.mesh.meniscus
        layout.use_property_split = True
        for name in ("start", "first", "step", "fps"):
            layout.prop(settings, name)


class MENISCUS_PT_shape(_Panel, bpy.types.Panel):
    bl_label = "Shape"
    bl_parent_id = "MENISCUS_PT_surface"

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = self.layout, context.mesh.meniscus
        layout.use_property_split = True
        sampled = layout.column()
        packed = live.status_of(context.mesh).file.lower().endswith(".mnf")
        sampled.enabled = not packed
        row = sampled.row(align=True)
        row.prop(settings, "spacing")
        row.operator(Measure.bl_idname, text="", icon="DRIVER_DISTANCE")
        column = sampled.column(align=True)
        column.prop(settings, "cell_viewport")
        column.prop(settings, "cell_render")
        sampled.prop(settings, "tank")
        if settings.tank:
            sampled.prop(settings, "tank_low")
            sampled.prop(settings, "tank_high")
        layout.prop(settings, "solids")
        if settings.solids is not None:
            layout.prop(settings, "solid_offset")
        if packed:
            _sentence(layout, context, "Packed frames keep the spacing and the cells with which they were packed, and have no velocities", "INFO")
        layout.prop(settings, "smooth")
        layout.prop(settings, "smallest_drop")
        layout.prop(settings, "simplify")


class MENISCUS_PT_attributes(_Panel, bpy.types.Panel):
    bl_label = "Attributes"
    bl_parent_id = "MENISCUS_PT_surface"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout, mesh = self.layout, context.mesh
        layout.use_property_split = True
        if mesh.meniscus.source == "FILES":
            layout.prop(mesh.meniscus, "attributes")
        moves = "velocity" in mesh.attributes
        text = "Motion blur uses the attribute velocity" if moves else "No motion blur, because the surface has no velocities"
        _sentence(layout, context, text, "CHECKMARK" if moves else "INFO")


class MENISCUS_PT_conversion(_Panel, bpy.types.Panel):
    bl_label = "Conversion"
    bl_parent_id = "MENISCUS_PT_surface"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return super().poll(context) and context.mesh.meniscus.source == "FILES"

    def draw(self, context: bpy.types.Context) -> None:
        layout, mesh = self.layout, context.mesh
        layout.use_property_split = True
        layout.prop(mesh.meniscus, "converted")
        layout.prop(mesh.meniscus, "output")
        conversion = conversion_of(mesh)
        layout.operator(Convert.bl_idname)
        if conversion is None:
            return
        if conversion.runs:
            row = layout.row()
            total = max(conversion.total, 1)
            row.progress(factor=conversion.done / total, text=f"{conversion.done} of {conversion.total} frames")
            row.operator(Cancel.bl_idname, text="", icon="X")
        for problem in [conversion.error] * bool(conversion.error) + conversion.problems[:5]:
            _sentence(layout, context, problem, "ERROR")
        _sentence(layout, context, conversion.message, "INFO")


def _add_menu(self: bpy.types.Menu, _context: bpy.types.Context) -> None:
    self.layout.separator()
    self.layout.operator(AddFiles.bl_idname, icon="MOD_FLUIDSIM")
    self.layout.operator(AddObject.bl_idname, icon="MOD_FLUIDSIM")


def _import_menu(self: bpy.types.Menu, _context: bpy.types.Context) -> None:
    self.layout.operator(AddFiles.bl_idname, text="Particles as a Fluid Surface (meniscus)")


_CLASSES = (MENISCUS_PT_surface, MENISCUS_PT_frames, MENISCUS_PT_shape, MENISCUS_PT_attributes, MENISCUS_PT_conversion)


def register() -> None:
    for each in _CLASSES:
        bpy.utils.register_class(each)
    bpy.types.VIEW3D_MT_add.append(_add_menu)
    bpy.types.TOPBAR_MT_file_import.append(_import_menu)


def unregister() -> None:
    bpy.types.TOPBAR_MT_file_import.remove(_import_menu)
    bpy.types.VIEW3D_MT_add.remove(_add_menu)
    for each in reversed(_CLASSES):
        bpy.utils.unregister_class(each)

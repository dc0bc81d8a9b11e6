"""The settings of a surface: properties of its mesh, so that all users of the mesh share them."""

from __future__ import annotations

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, FloatVectorProperty, IntProperty, PointerProperty, StringProperty

from . import live

#: The library's default cell size, smoothing width and solid offset, all in spacings.
CELL, SMOOTHING, SOLID_OFFSET = 0.5, 1.6, -0.1


def _changed(settings: MeniscusSurface, _context: bpy.types.Context) -> None:
    live.refresh(settings.id_data)


class MeniscusSurface(bpy.types.PropertyGroup):
    """The settings of the surface that a mesh shows."""

    source: EnumProperty(
        name="Particles",
        description="Source of the particles",
        items=[
            ("NONE", "None", "An ordinary mesh"),
            ("FILES", "Files", "A sequence of particle files, or of packed frames"),
            ("OBJECT", "Object", "The vertices of an object, or its point cloud"),
        ],
        default="NONE",
        update=_changed,
    )
    live: BoolProperty(
        name="Live",
        description="Update the surface when the frame or a setting changes",
        default=True,
        update=_changed,
    )
    path: StringProperty(
        name="Files",
        description="A file, a folder, or a name with {} for the frame number",
        subtype="FILE_PATH",
        update=_changed,
    )
    object: PointerProperty(
        name="Object",
        description="Object whose vertices or points are the particles, after modifiers and in world space",
        type=bpy.types.Object,
        update=_changed,
    )
    where: StringProperty(
        name="Where",
        description="Use only particles whose attributes satisfy a condition, such as Type=1, age<2.5 or mk=0,2 (either value); type=PartType1 selects a type in a file",
        update=_changed,
    )
    start: IntProperty(name="Start", description="Frame of the scene at which the sequence starts", default=1, update=_changed)
    first: IntProperty(name="First", description="Number of the file that is shown when the sequence starts", default=0, update=_changed)
    step: FloatProperty(
        name="Step",
        description="Frames of the sequence per frame of the scene; a value below 1 gives slow motion and repeats frames",
        default=1.0,
        min=0.0,
        update=_changed,
    )
    fps: FloatProperty(
        name="Files per Second",
        description="Frame rate of the simulation, for motion blur; 0 uses the frame rate of the scene",
        default=0.0,
        min=0.0,
        update=_changed,
    )
    spacing: FloatProperty(
        name="Spacing",
        description="Distance between neighbouring particles, in the unit of the particles; if 0, it is read from the file of each frame, or estimated",
        default=0.0,
        precision=5,
        step=0.1,
        update=_changed,
    )
    cell_viewport: FloatProperty(
        name="Cells, Viewport",
        description="Size of a cell as a multiple of the particle spacing, in the viewport; smaller is finer",
        default=1.0,
        min=0.05,
        soft_max=2.0,
        update=_changed,
    )
    cell_render: FloatProperty(
        name="Render",
        description="Size of a cell as a multiple of the particle spacing, in renders and conversions; smaller is finer",
        default=CELL,
        min=0.05,
        soft_max=2.0,
        update=_changed,
    )
    tank: BoolProperty(
        name="Tank",
        description="End the fluid exactly at the walls of a tank; particles outside are left out",
        default=False,
        update=_changed,
    )
    tank_low: FloatVectorProperty(
        name="Lowest",
        description="The tank's lowest corner, in the particles' coordinates",
        precision=5,
        default=(-1.0, -1.0, -1.0),
        update=_changed,
    )
    tank_high: FloatVectorProperty(
        name="Highest",
        description="The tank's highest corner, in the particles' coordinates",
        precision=5,
        default=(1.0, 1.0, 1.0),
        update=_changed,
    )
    solids: PointerProperty(
        name="Solids",
        description="End the fluid at the objects of this collection, which must be closed meshes: obstacles, vessels, ships",
        type=bpy.types.Collection,
        update=_changed,
    )
    solid_offset: FloatProperty(
        name="Offset",
        description="Distance between the fluid and the solids, in particle spacings: a positive offset leaves a gap; with a negative offset, the fluid "
        "reaches into the solids, so that no gap is visible",
        default=SOLID_OFFSET,
        min=-0.5,
        max=2.0,
        step=10,
        update=_changed,
    )
    smooth: FloatProperty(
        name="Smoothing",
        description="Smoothing width in particle spacings, from 0.8 to 4; larger is smoother, and 2 suits noisy FLIP particles",
        default=SMOOTHING,
        min=0.0,
        soft_min=1.0,
        soft_max=3.2,
        step=10,
        update=_changed,
    )
    smallest_drop: IntProperty(
        name="Smallest Drop",
        description="Remove drops with fewer than this many particles; the number of particles is estimated from the drop's volume",
        default=0,
        min=0,
        soft_max=100,
        update=_changed,
    )
    simplify: FloatProperty(
        name="Simplify",
        description="Merge triangles; the surface moves by at most this many cells. 0 keeps all triangles",
        default=0.0,
        min=0.0,
        soft_max=0.5,
        precision=3,
        update=_changed,
    )
    attributes: StringProperty(
        name="Attributes",
        description="Names of the particle attributes to transfer to the mesh, separated by commas; by default, only the velocity",
        update=_changed,
    )
    converted: EnumProperty(
        name="Files",
        description="The files of a conversion",
        items=[
            ("MESHES", "Meshes", "A mesh of each frame (.usdc), played as a mesh sequence cache"),
            ("VOLUMES", "Volumes", "A level set of each frame (.vdb), with velocities, played by a Volume object"),
        ],
        default="MESHES",
    )
    output: StringProperty(
        name="Output",
        description="Folder for the files of a conversion",
        subtype="DIR_PATH",
        default="//surfaces/",
    )


class MeniscusPreferences(bpy.types.AddonPreferences):
    """Preferences that apply to all surfaces."""

    bl_idname = __package__

    cache: IntProperty(
        name="Cache (MiB)",
        description="Memory limit for cached surfaces, in addition to the surface that is shown",
        default=1024,
        min=0,
        update=lambda self, _context: live.set_cache_limit(self.cache),
    )

    def draw(self, _context: bpy.types.Context) -> None:
        self.layout.prop(self, "cache")


def register() -> None:
    bpy.utils.register_class(MeniscusSurface)
    bpy.utils.register_class(MeniscusPreferences)
    bpy.types.Mesh.meniscus = PointerProperty(type=MeniscusSurface)
    known = bpy.context.preferences.addons.get(__package__)
    if known is not None and known.preferences is not None:
        live.set_cache_limit(known.preferences.cache)


def unregister() -> None:
    del bpy.types.Mesh.meniscus
    bpy.utils.unregister_class(MeniscusPreferences)
    bpy.utils.unregister_class(MeniscusSurface)

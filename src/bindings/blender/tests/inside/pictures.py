"""Renders pictures of frames with Cycles, on the CPU. Run by tools/bindings/blender pictures.

usage: pictures.py ZIP FOLDER PARTICLES...
"""

from __future__ import annotations

import math
import sys
import time
from pathlib import Path

import bpy
import numpy as np
from common import emptied, installed, positions
from mathutils import Vector

zipped, folder, *inputs = map(Path, sys.argv[1:])
extension = installed(zipped)
live = extension.live
SAMPLES = 12


def material(name: str, **values: object) -> bpy.types.Material:
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    shader = next(node for node in made.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    for key, value in values.items():
        shader.inputs[key.replace("_", " ")].default_value = value
    return made


def water() -> bpy.types.Material:
    made = material("water", Base_Color=(0.75, 0.92, 0.97, 1), Roughness=0.02, IOR=1.33, Transmission_Weight=1.0)
    return made


def stage(shown: bpy.types.Object) -> None:
    """Adds a camera, light and ground."""
    scene = bpy.context.scene
    points = positions(shown.data) @ np.array(shown.matrix_world)[:3, :3].T
    low, high = points.min(axis=0), points.max(axis=0)
    size, centre = float(np.linalg.norm(high - low)), (low + high) / 2
    bpy.ops.mesh.primitive_plane_add(size=40 * size, location=(centre[0], centre[1], low[2] - 0.002 * size))
    bpy.context.object.data.materials.append(material("ground", Base_Color=(0.45, 0.42, 0.38, 1), Roughness=0.7))
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    sun.data.energy, sun.data.angle = 3.0, math.radians(3)
    sun.rotation_euler = (math.radians(50), 0, math.radians(40))
    scene.collection.objects.link(sun)
    world = bpy.data.worlds.new("sky")
    world.use_nodes = True
    world.node_tree.nodes["Background"].inputs[0].default_value = (0.55, 0.7, 0.95, 1)
    scene.world = world
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(camera)
    camera.data.lens, scene.camera = 50, camera
    direction = Vector((0.35, -1.0, 0.55)).normalized()
    camera.location = Vector(centre) + direction * size * 2.0
    camera.rotation_euler = (-direction).to_track_quat("-Z", "Y").to_euler()
    camera.data.clip_end = 100 * size


def prepare(samples: int) -> None:
    scene = bpy.context.scene
    render = scene.render
    render.engine, render.resolution_x, render.resolution_y, render.resolution_percentage = "CYCLES", 1920, 1080, 100
    render.use_motion_blur = False
    scene.cycles.device, scene.cycles.samples, scene.cycles.use_denoising = "CPU", samples, True
    scene.cycles.max_bounces, scene.cycles.transmission_bounces = 6, 5


for given in inputs:
    emptied()
    live._state.reset()
    bpy.ops.meniscus.add_files(filepath=str(given))
    shown = bpy.context.object
    shown.data.materials.append(water())
    settings = shown.data.meniscus
    scene = bpy.context.scene
    bpy.context.scene.frame_set(extension.surfaces.sequence.number_of(str(given)) - settings.first + settings.start)
    stage(shown)
    prepare(SAMPLES)
    coarse = len(shown.data.polygons)
    drawn: list[int] = []
    bpy.app.handlers.render_post.append(lambda *_: drawn.append(len(shown.data.polygons)))
    scene.render.filepath = str(folder / f"{given.parent.name}.png")
    began = time.perf_counter()
    bpy.ops.render.render(write_still=True)
    bpy.app.handlers.render_post.clear()
    assert len(shown.data.polygons) == coarse, "after the render, the viewport must show coarse cells again"
    assert drawn[0] > 2 * coarse or str(given).endswith(".mnf"), (drawn, coarse)
    print(f"{given.name}: {coarse} triangles in the viewport, {drawn[0]} in the render, {time.perf_counter() - began:.0f} s", flush=True)

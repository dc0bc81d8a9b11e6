"""Renders an animation of a particle simulation with Cycles and the extension, which must be installed in this Blender.

blender --background --python animation.py -- PARTICLES FOLDER [FRAMES] [PERCENT]

PARTICLES is any file of the sequence. The script renders the first FRAMES frames of the scene, at
PERCENT of 1920 x 1080 pixels, and writes the pictures and the scene (scene.blend) into FOLDER.
"""

import math
import os
import sys

import bpy
import numpy as np
from mathutils import Vector

given = sys.argv[sys.argv.index("--") + 1 :]
particles, folder = map(os.path.abspath, given[:2])
frames, percent = (int(given[2]) if len(given) > 2 else 250), (int(given[3]) if len(given) > 3 else 50)

bpy.ops.wm.read_homefile(use_empty=True)
scene = bpy.context.scene
scene.render.fps = 25
scene.frame_start, scene.frame_end = 1, frames

# Add the live surface. Its motion blur assumes that the simulation has 25 frames per second.
bpy.ops.meniscus.add_files(filepath=particles)
water = bpy.context.object
settings = water.data.meniscus
settings.fps = 25
settings.cell_render = 0.5

glass = bpy.data.materials.new("water")
glass.use_nodes = True
shader = next(node for node in glass.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
for name, value in {"Base Color": (0.75, 0.92, 0.97, 1), "Roughness": 0.02, "IOR": 1.33, "Transmission Weight": 1.0}.items():
    shader.inputs[name].default_value = value
water.data.materials.append(glass)

# The camera must see the water in all frames. The water has spread farthest in the last frame.
scene.frame_set(frames)
corners = np.array([water.matrix_world @ Vector(corner) for corner in water.bound_box])
low, high = corners.min(axis=0), corners.max(axis=0)
size, centre = float(np.linalg.norm(high - low)), Vector((low + high) / 2)
bpy.ops.mesh.primitive_plane_add(size=40 * size, location=(centre.x, centre.y, low[2] - 0.002 * size))
sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
sun.data.energy, sun.rotation_euler = 3.0, (math.radians(50), 0, math.radians(40))
sky = bpy.data.worlds.new("sky")
sky.use_nodes = True
sky.node_tree.nodes["Background"].inputs[0].default_value = (0.55, 0.7, 0.95, 1)
camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
towards = Vector((0.35, -1.0, 0.55)).normalized()
camera.location = centre + towards * size * 1.8
camera.rotation_euler = (-towards).to_track_quat("-Z", "Y").to_euler()
for added in (sun, camera):
    scene.collection.objects.link(added)
scene.world, scene.camera = sky, camera

render = scene.render
render.engine, render.use_motion_blur = "CYCLES", True
render.resolution_x, render.resolution_y, render.resolution_percentage = 1920, 1080, percent
scene.cycles.samples, scene.cycles.use_denoising = 16, True
scene.cycles.max_bounces, scene.cycles.transmission_bounces = 6, 5
os.makedirs(folder, exist_ok=True)
render.filepath = os.path.join(folder, "frame_")
bpy.ops.wm.save_as_mainfile(filepath=os.path.join(folder, "scene.blend"))
bpy.ops.render.render(animation=True)

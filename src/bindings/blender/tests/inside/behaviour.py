"""Tests of surfaces in Blender: frames, settings, undo, files, errors, conversions. Run by tools/bindings/blender check."""

from __future__ import annotations

import os
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from common import DAM, arguments, block, emptied, installed, positions, sizes

options = arguments()
extension = installed(options.zip)
live, operators = extension.live, extension.operators
import meniscus  # noqa: E402  (of the extension)

FLUID = str(DAM / "ParticleData_Fluid_1.bgeo")
made: list[str] = []
checks: list[Callable[[], None]] = []


def check(sentence: Callable[[], None]) -> Callable[[], None]:
    """Registers a test, whose name is a sentence that must be true."""
    checks.append(sentence)
    return sentence


def record_computed_surfaces() -> None:
    """Replaces `Maker.make`, so that it appends the source of every computed surface to `made`."""
    make = extension.surfaces.request.Maker.make

    def counted(self: Any, request: Any) -> Any:
        made.append(request.source.path if hasattr(request.source, "path") else "points")
        return make(self, request)

    extension.surfaces.request.Maker.make = counted


def dam(path: str = FLUID) -> bpy.types.Object:
    emptied()
    live._state.reset()
    bpy.ops.meniscus.add_files(filepath=path)
    made.clear()
    return bpy.context.object


def expected(number: int, **keywords: Any) -> Any:
    keywords = {"spacing": 0.05, "cell": 1.0, "smooth": 1.6} | keywords
    return meniscus.Frame.load(DAM / f"ParticleData_Fluid_{number}.bgeo", **keywords).surface()


def shows(mesh: bpy.types.Mesh, library: Any) -> bool:
    return np.array_equal(positions(mesh), library.vertices.astype(np.float32)) and len(mesh.polygons) == len(library.triangles)


@check
def a_new_surface_equals_the_librarys_and_is_upright() -> None:
    shown = dam()
    settings = shown.data.meniscus
    assert shows(shown.data, expected(1)) and abs(settings.spacing - 0.05) < 1e-7 and settings.first == 1
    assert abs(shown.rotation_euler.x - np.pi / 2) < 1e-6, "y is the up axis of .bgeo files"
    assert bpy.context.scene.render.use_lock_interface
    velocity = np.empty(3 * len(shown.data.vertices), np.float32)
    shown.data.attributes["velocity"].data.foreach_get("vector", velocity)
    assert np.array_equal(velocity.reshape(-1, 3), expected(1).attributes["velocity"])


@check
def a_second_surface_of_the_same_files_is_also_upright() -> None:
    first = dam()
    bpy.ops.meniscus.add_files(filepath=FLUID)
    second = bpy.context.object
    assert made == [] and second != first, "the surface comes from the cache"
    assert second.rotation_euler == first.rotation_euler and second.data.meniscus.spacing == first.data.meniscus.spacing


@check
def a_sequence_that_starts_without_particles_is_upright() -> None:
    folder = options.folder / "inflow"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    np.save(folder / "pool_1.npy", np.zeros((0, 3), np.float32))
    np.save(folder / "pool_2.npy", block(1000))
    shown = dam(str(folder / "pool_1.npy"))
    assert "no particles" in live.status_of(shown.data).error
    assert abs(shown.rotation_euler.x - np.pi / 2) < 1e-6
    bpy.context.scene.frame_set(2)
    assert sizes(shown.data) != (0, 0)


@check
def the_spacing_of_an_opened_file_is_measured() -> None:
    shown = dam()
    shown.data.meniscus.spacing = 0.0
    name, blend = shown.name, str(options.folder / "unmeasured.blend")
    bpy.ops.wm.save_as_mainfile(filepath=blend)
    live._state.reset()
    bpy.ops.wm.open_mainfile(filepath=blend)
    shown = bpy.data.objects[name]
    bpy.context.view_layer.objects.active = shown
    assert bpy.ops.meniscus.measure() == {"FINISHED"} and abs(shown.data.meniscus.spacing - 0.05) < 1e-7


@check
def frames_are_computed_once_and_shown_by_their_numbers() -> None:
    shown, scene = dam(), bpy.context.scene
    for frame, number in [(10, 10), (20, 20), (15, 10), (25, 20), (1, 1), (10, 10), (20, 20)]:
        scene.frame_set(frame)
        assert shows(shown.data, expected(number)), frame
        gap = live.status_of(shown.data).notes
        assert (gap == ("Frame 15 is missing: showing frame 10",)) == (frame == 15), gap
    assert [Path(path).stem.rsplit("_", 1)[1] for path in made] == ["10", "20"], made


@check
def a_frame_is_recomputed_if_its_file_has_changed() -> None:
    folder = options.folder / "changing"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for number in (1, 2):
        np.save(folder / f"pool_{number}.npy", block(1000 * number))
    shown, scene = dam(str(folder / "pool_1.npy")), bpy.context.scene
    scene.frame_set(2)
    scene.frame_set(1)
    assert len(made) == 1, made
    np.save(folder / "pool_1.npy", block(3000))
    scene.frame_set(2)
    scene.frame_set(1)
    assert len(made) == 2 and made[1].endswith("pool_1.npy"), made
    before = sizes(shown.data)
    assert before[0] > 0
    (folder / "pool_2.npy").unlink()
    scene.frame_set(2)
    # Without a second file, the sequence ends with the first file, whose surface stays visible.
    assert sizes(shown.data) == before and not live.status_of(shown.data).error


@check
def changed_settings_give_a_new_surface_and_equal_ones_a_cached_one() -> None:
    shown = dam()
    bpy.context.scene.frame_set(20)
    settings = shown.data.meniscus
    made.clear()
    settings.smooth = 2.5
    assert shows(shown.data, expected(20, smooth=2.5))
    settings.smallest_drop = 50
    assert shows(shown.data, expected(20, smooth=2.5, smallest_drop=50))
    settings.simplify = 0.2
    assert shows(shown.data, expected(20, smooth=2.5, smallest_drop=50, simplify=0.2))
    settings.smooth, settings.smallest_drop, settings.simplify = 1.6, 0, 0.0
    assert shows(shown.data, expected(20))
    count = len(made)
    settings.smooth = 2.5
    settings.cell_render = 0.3
    settings.smooth = 1.6
    assert len(made) == count, made[count:]
    settings.tank, settings.tank_low, settings.tank_high = True, (-1.95, 0.03, -0.7), (1.65, 2.8, 0.7)
    assert shows(shown.data, expected(20, domain=(-1.95, 0.03, -0.7, 1.65, 2.8, 0.7))) and abs(positions(shown.data)[:, 1].min() - 0.03) < 1e-6
    settings.tank_high = (-3.0, 0.0, 0.0)
    assert live.status_of(shown.data).error and sizes(shown.data) == (0, 0)
    print(f"    a tank inside out: {live.status_of(shown.data).error}")
    settings.tank = False
    assert shows(shown.data, expected(20))
    settings.attributes = "density"
    assert "density" in shown.data.attributes and "velocity" not in shown.data.attributes
    settings.attributes = "heat"
    assert 'no attribute "heat"; available attributes: id, velocity, density' in live.status_of(shown.data).error
    assert sizes(shown.data) == (0, 0)


@check
def undo_restores_the_surface() -> None:
    shown, scene = dam(), bpy.context.scene
    scene.frame_set(20)
    name = shown.name
    bpy.ops.ed.undo_push(message="calm")
    shown.data.meniscus.smooth = 3.0
    bpy.ops.ed.undo_push(message="calmer")
    assert shows(shown.data, expected(20, smooth=3.0))
    made.clear()
    bpy.ops.ed.undo()
    shown = bpy.data.objects[name]
    assert abs(shown.data.meniscus.smooth - 1.6) < 1e-6 and shows(shown.data, expected(20))
    bpy.ops.ed.redo()
    shown = bpy.data.objects[name]
    assert shows(shown.data, expected(20, smooth=3.0))
    assert made == [], made


@check
def a_reopened_file_shows_and_updates_its_surface() -> None:
    shown, scene = dam(), bpy.context.scene
    scene.frame_set(20)
    shown.data.meniscus.smooth = 2.0
    name, blend = shown.name, str(options.folder / "dam.blend")
    bpy.ops.wm.save_as_mainfile(filepath=blend)
    bpy.ops.wm.read_homefile(use_empty=True)
    live._state.reset()
    made.clear()
    bpy.ops.wm.open_mainfile(filepath=blend)
    shown = bpy.data.objects[name]
    assert shows(shown.data, expected(20, smooth=2.0))
    assert made == [], "an unchanged surface must not be recomputed"
    bpy.context.scene.frame_set(10)
    assert shows(shown.data, expected(10, smooth=2.0))


@check
def a_saved_surface_stays_while_its_files_are_missing() -> None:
    folder, away = options.folder / "moved", options.folder / "away"
    for each in (folder, away):
        shutil.rmtree(each, ignore_errors=True)
    folder.mkdir()
    np.save(folder / "pool_1.npy", block(1000))
    np.save(folder / "pool_2.npy", block(2000))
    shown, blend = dam(str(folder / "pool_1.npy")), str(options.folder / "moved.blend")
    name, before = shown.name, positions(shown.data)
    assert len(before) > 0
    bpy.ops.wm.save_as_mainfile(filepath=blend)

    def opened() -> bpy.types.Object:
        bpy.ops.wm.read_homefile(use_empty=True)
        live._state.reset()
        made.clear()
        bpy.ops.wm.open_mainfile(filepath=blend)
        return bpy.data.objects[name]

    folder.rename(away)
    shown = opened()
    for _ in range(2):
        status = live.status_of(shown.data)
        assert "moved" in status.error and "saved" in status.notes[0], status
        assert np.array_equal(positions(shown.data), before)
        bpy.context.scene.frame_set(bpy.context.scene.frame_current)
    # The saved surface must not be shown for another frame or for other settings.
    bpy.context.scene.frame_set(2)
    assert live.status_of(shown.data).error and sizes(shown.data) == (0, 0)
    shown = opened()
    shown.data.meniscus.smooth = 2.5
    assert live.status_of(shown.data).error and sizes(shown.data) == (0, 0)
    away.rename(folder)
    shown = opened()
    assert not live.status_of(shown.data).error and np.array_equal(positions(shown.data), before)
    assert made == [], "an unchanged surface must not be recomputed"


@check
def packed_frames_can_be_filtered_and_converted() -> None:
    folder = options.folder / "packed"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for number in (1, 10, 20):
        meniscus.Frame.load(DAM / f"ParticleData_Fluid_{number}.bgeo", cell=0.5).save(folder / f"dam_{number}.mnf")
    shown = dam(str(folder / "dam_1.mnf"))
    bpy.context.scene.frame_set(20)
    settings = shown.data.meniscus
    assert shows(shown.data, expected(20, cell=0.5))
    settings.smooth, settings.smallest_drop = 2.2, 20
    assert shows(shown.data, expected(20, cell=0.5, smooth=2.2, smallest_drop=20))
    count = len(made)
    settings.cell_viewport = 2.0
    assert len(made) == count and not live.status_of(shown.data).error
    output = options.folder / "unpacked"
    shutil.rmtree(output, ignore_errors=True)
    settings.output = str(output) + os.sep
    conversion = converted(shown)
    assert conversion.done == 3 and len(list(output.glob("*.usdc"))) == 3


def converted(shown: bpy.types.Object) -> Any:
    """Converts a surface's frames, and replaces the live surface with the result."""
    bpy.context.view_layer.objects.active = shown
    assert bpy.ops.meniscus.convert() == {"FINISHED"}
    conversion = operators.conversion_of(shown.data)
    conversion.join()
    assert (conversion.error, conversion.problems) == ("", []), vars(conversion)
    # Call the timer's function directly, because timers do not run in background mode.
    assert operators._poll(shown.data.session_uid) is None and not conversion.error, conversion.error
    return conversion


def object_of(points: np.ndarray, scene: bpy.types.Scene) -> bpy.types.Object:
    """Adds an object with only these vertices."""
    mesh = bpy.data.meshes.new("points")
    mesh.vertices.add(len(points))
    mesh.vertices.foreach_set("co", points.reshape(-1))
    added = bpy.data.objects.new("points", mesh)
    scene.collection.objects.link(added)
    return added


@check
def vertices_of_an_object_are_particles() -> None:
    scene = emptied()
    live._state.reset()
    points = block(1000)
    source = object_of(points, scene)
    bpy.context.view_layer.objects.active = source
    bpy.ops.meniscus.add_object()
    shown = bpy.context.object
    assert shown != source and shown.data.meniscus.object == source
    settings = shown.data.meniscus
    assert 0.08 < settings.spacing < 0.12, settings.spacing
    settings.spacing = 0.1
    library = meniscus.reconstruct(points, spacing=0.1, cell=1.0)
    assert shows(shown.data, library)
    made.clear()
    source.location.x = 3.0
    bpy.context.view_layer.update()
    assert len(made) == 1 and abs(positions(shown.data)[:, 0].min() - library.vertices[:, 0].min() - 3.0) < 0.05
    source.keyframe_insert("location", frame=1)
    source.location.x = 5.0
    source.keyframe_insert("location", frame=11)
    scene.frame_set(11)
    assert abs(positions(shown.data)[:, 0].min() - library.vertices[:, 0].min() - 5.0) < 0.05
    made.clear()
    scene.frame_set(1)
    scene.frame_set(11)
    assert len(made) <= 1, made
    bpy.data.objects.remove(source)
    scene.frame_set(2)
    assert "Choose the object" in live.status_of(shown.data).error and sizes(shown.data) == (0, 0)


@check
def a_point_cloud_of_geometry_nodes_is_particles() -> None:
    scene = emptied()
    live._state.reset()
    points = block(1000)
    source = object_of(points, scene)
    tree = bpy.data.node_groups.new("to points", "GeometryNodeTree")
    for where in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=where, socket_type="NodeSocketGeometry")
    ends = tree.nodes.new("NodeGroupInput"), tree.nodes.new("GeometryNodeMeshToPoints"), tree.nodes.new("NodeGroupOutput")
    tree.links.new(ends[0].outputs[0], ends[1].inputs[0])
    tree.links.new(ends[1].outputs[0], ends[2].inputs[0])
    source.modifiers.new("to points", "NODES").node_group = tree
    bpy.context.view_layer.update()
    bpy.context.view_layer.objects.active = source
    bpy.ops.meniscus.add_object()
    shown = bpy.context.object
    shown.data.meniscus.spacing = 0.1
    assert shows(shown.data, meniscus.reconstruct(points, spacing=0.1, cell=1.0)), live.status_of(shown.data)


def cube_in(collection: bpy.types.Collection, size: float, place: tuple[float, float, float]) -> bpy.types.Object:
    """Adds a cube to a collection."""
    bpy.ops.mesh.primitive_cube_add(size=size, location=place)
    added = bpy.context.object
    collection.objects.link(added)
    return added


def touches(shown: bpy.types.Object, cube: bpy.types.Object, half: float) -> bool:
    """Whether more than 50 vertices are on a cube's sides, and no vertex is more than 0.05 inside the cube."""
    world = positions(shown.data) @ np.array(shown.matrix_world)[:3, :3].T + np.array(shown.matrix_world)[:3, 3]
    outside = np.abs(world - np.array(cube.matrix_world)[:3, 3]).max(axis=1) - half
    return int((np.abs(outside) < 0.01).sum()) > 50 and bool((outside > -0.05).all())


@check
def the_fluid_ends_at_the_objects_of_a_collection() -> None:
    shown, scene = dam(), bpy.context.scene
    scene.frame_set(20)
    collection = bpy.data.collections.new("obstacles")
    scene.collection.children.link(collection)
    # Place the cube in deep fluid. The file's y axis points up.
    cube = cube_in(collection, 0.4, (-1.5, 0.0, 0.2))
    bpy.context.view_layer.update()
    assert not touches(shown, cube, 0.2)
    made.clear()
    shown.data.meniscus.solid_offset = 0.0
    shown.data.meniscus.solids = collection
    assert not live.status_of(shown.data).error, live.status_of(shown.data)
    assert len(made) == 1 and touches(shown, cube, 0.2), made
    # The surface follows a solid that is moved, and a solid that is animated.
    cube.location.x += 0.3
    bpy.context.view_layer.update()
    assert len(made) == 2 and touches(shown, cube, 0.2), made
    cube.keyframe_insert("location", frame=20)
    cube.location.x -= 0.4
    cube.keyframe_insert("location", frame=10)
    for frame in (10, 20, 10):
        scene.frame_set(frame)
        assert touches(shown, cube, 0.2), (frame, live.status_of(shown.data))
    output = options.folder / "solids"
    shutil.rmtree(output, ignore_errors=True)
    shown.data.meniscus.output = str(output) + os.sep
    order = operators.order_of(shown.data, scene)
    assert scene.frame_current == 10 and shown.data.meniscus.live
    files = [Path(order.solids[0].replace("{}", str(number))) for number in (1, 10, 20)]
    assert len(order.solids) == 1 and len({file.read_bytes() for file in files}) == 2, order
    conversion = operators.Conversion(order)
    conversion.start()
    conversion.join()
    assert (conversion.done, conversion.error, conversion.problems) == (3, "", []), vars(conversion)
    # A hidden solid still shapes the fluid, even in renders. A mesh with a hole gives an error.
    cube.hide_viewport = cube.hide_render = True
    scene.frame_set(20)
    assert touches(shown, cube, 0.2), live.status_of(shown.data)
    prepare_for_rendering(shown)
    scene.render.filepath = str(options.folder / "touching.png")
    drawn: list[bool] = []
    bpy.app.handlers.render_post.append(lambda *_: drawn.append(touches(shown, cube, 0.2)))
    bpy.ops.render.render(write_still=True)
    bpy.app.handlers.render_post.clear()
    assert drawn == [True], drawn
    hole = bpy.data.meshes.new("hole")
    hole.from_pydata([v.co[:] for v in cube.data.vertices], [], [p.vertices[:] for p in cube.data.polygons][:5])
    cube.data = hole
    bpy.context.view_layer.update()
    assert "edges" in live.status_of(shown.data).error and sizes(shown.data) == (0, 0), live.status_of(shown.data)
    shown.data.meniscus.solids = None
    assert shows(shown.data, expected(20))


@check
def errors_are_one_line_messages() -> None:
    def check_error(shown: bpy.types.Object, *words: str) -> None:
        error = live.status_of(shown.data).error
        assert all(word in error for word in words) and "\n" not in error and "Traceback" not in error, error
        assert sizes(shown.data) == (0, 0)

    shown = dam(str(options.folder / "nowhere" / "frame_1.bgeo"))
    check_error(shown, "nowhere")
    shown = dam()
    shown.data.meniscus.path = ""
    check_error(shown, "Choose the particle files")
    shown.data.meniscus.path = str(DAM)
    check_error(shown, "several simulations")
    shown.data.meniscus.path = str(DAM / "ParticleData_Fluid_{}.bgeo")
    assert not live.status_of(shown.data).error and sizes(shown.data) != (0, 0)
    for spacing in (-1.0, 1e-12, 1e12, float("nan"), float("inf")):
        shown.data.meniscus.spacing = spacing
        print(f"    spacing {spacing}: {live.status_of(shown.data).error or live.status_of(shown.data).warnings}")
        assert live.status_of(shown.data).error or live.status_of(shown.data).warnings, spacing
    shown.data.meniscus.spacing = 0.05
    assert shows(shown.data, expected(1))
    folder = options.folder / "wrong"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    np.save(folder / "pool_1.npy", block(1000))
    np.save(folder / "pool_2.npy", np.zeros((0, 3), np.float32))
    (folder / "pool_3.npy").write_bytes((folder / "pool_1.npy").read_bytes()[:500])
    bad = block(1000)
    bad[5] = np.nan
    np.save(folder / "pool_4.npy", bad)
    shown, scene = dam(str(folder / "pool_1.npy")), bpy.context.scene
    for frame, words in [(2, ("no particles",)), (3, ("pool_3.npy",)), (4, ("pool_4.npy", "5"))]:
        scene.frame_set(frame)
        check_error(shown, *words)
    scene.frame_set(1)
    assert not live.status_of(shown.data).error and sizes(shown.data) != (0, 0)
    folder.joinpath("pool_1.npy").unlink()
    extension.live.reread(shown.data)
    check_error(shown)


@check
def a_mesh_in_edit_mode_is_not_changed() -> None:
    shown = dam()
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.context.scene.frame_set(20)
    assert "Edit Mode" in live.status_of(shown.data).error
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.context.view_layer.update()
    assert shows(shown.data, expected(20)) and not live.status_of(shown.data).error


def prepare_for_rendering(shown: bpy.types.Object) -> bpy.types.Scene:
    scene = bpy.context.scene
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.location, camera.rotation_euler = (-1.2, -9.0, 0.8), (np.pi / 2, 0.0, 0.0)
    scene.collection.objects.link(camera)
    scene.camera = camera
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    sun.data.energy, sun.rotation_euler = 5.0, (0.8, 0.3, 0.0)
    scene.collection.objects.link(sun)
    render = scene.render
    render.engine, render.resolution_x, render.resolution_y = "CYCLES", 160, 90
    render.image_settings.file_format = "PNG"
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.seed = 4, False, 1
    return scene


def picture_of(path: Path) -> Any:
    image = bpy.data.images.load(str(path), check_existing=False)
    values = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(values)
    bpy.data.images.remove(image)
    return values


@check
def renders_use_fine_cells_and_motion_blur() -> None:
    shown = dam()
    scene = prepare_for_rendering(shown)
    settings = shown.data.meniscus
    drawn: list[int] = []
    bpy.app.handlers.render_post.append(lambda *_: drawn.append(len(shown.data.polygons)))
    pictures = []
    for blurred in (False, True):
        scene.render.use_motion_blur = blurred
        scene.frame_set(10)
        made.clear()
        scene.render.filepath = str(options.folder / f"blurred_{blurred}.png")
        bpy.ops.render.render(write_still=True)
        # The first render computes one surface. The second render and the viewport use the cache.
        assert len(made) == (0 if blurred else 1), made
        assert drawn.pop() == len(expected(10, cell=0.5).triangles) and shows(shown.data, expected(10))
        pictures.append(picture_of(options.folder / f"blurred_{blurred}.png"))
    moved = np.abs(pictures[0] - pictures[1]).mean()
    print(f"    motion blur changes a pixel by {moved:.5f}")
    assert moved > 1e-3, "motion blur must change the picture"
    # Without velocities there is no motion blur, so the picture equals the sharp one.
    settings.attributes = "density"
    scene.render.filepath = str(options.folder / "still.png")
    bpy.ops.render.render(write_still=True)
    drawn.clear()
    assert np.abs(pictures[0] - picture_of(options.folder / "still.png")).mean() < 1e-4
    settings.attributes = ""
    scene.frame_start, scene.frame_end, scene.frame_step = 1, 19, 9
    made.clear()
    scene.render.filepath = str(options.folder / "animation_")
    bpy.ops.render.render(animation=True)
    assert drawn == [len(expected(number, cell=0.5).triangles) for number in (1, 10, 10)], drawn
    assert len({len(picture_of(options.folder / f"animation_{frame:04}.png")) for frame in (1, 10, 19)}) == 1
    bpy.app.handlers.render_post.clear()


@check
def renders_of_vertices_use_fine_cells() -> None:
    scene = emptied()
    live._state.reset()
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=5, radius=1.0)
    source = bpy.context.object
    bpy.ops.meniscus.add_object()
    shown = bpy.context.object
    shown.data.meniscus.spacing = 0.08
    prepare_for_rendering(shown)
    coarse = sizes(shown.data)
    drawn: list[int] = []
    bpy.app.handlers.render_post.append(lambda *_: drawn.append(len(shown.data.polygons)))
    scene = bpy.context.scene
    scene.render.filepath = str(options.folder / "vertices.png")
    bpy.ops.render.render(write_still=True)
    bpy.app.handlers.render_post.clear()
    assert drawn[0] > 2 * coarse[1] and sizes(shown.data) == coarse, (drawn, coarse)
    # Rendering an animation also uses the fine cells of renders in every frame.
    source.keyframe_insert("location", frame=1)
    source.location.x = 4.0
    source.keyframe_insert("location", frame=11)
    leftmost: list[float] = []
    bpy.app.handlers.render_post.append(lambda *_: leftmost.append(positions(shown.data)[:, 0].min()))
    scene.frame_start, scene.frame_end, scene.frame_step = 1, 11, 10
    scene.render.filepath = str(options.folder / "moving_")
    bpy.ops.render.render(animation=True)
    bpy.app.handlers.render_post.clear()
    assert abs(leftmost[1] - leftmost[0] - 4.0) < 0.01, leftmost
    source.hide_render = True
    bpy.ops.render.render(write_still=True)
    assert sizes(shown.data)[1] > 0 and not live.status_of(shown.data).error
    source.hide_viewport = True
    scene.frame_set(5)
    assert "is hidden in the viewport" in live.status_of(shown.data).error, live.status_of(shown.data)


@check
def a_conversion_replaces_the_live_surface() -> None:
    for kind in ("MESHES", "VOLUMES"):
        shown, scene = dam(), bpy.context.scene
        settings, output = shown.data.meniscus, options.folder / "placed"
        shutil.rmtree(output, ignore_errors=True)
        settings.converted, settings.output, settings.cell_viewport = kind, str(output) + os.sep, settings.cell_render
        holder = bpy.data.objects.new("holder", None)
        holder.rotation_euler.z = 0.5
        scene.collection.objects.link(holder)
        shown.parent, shown.matrix_parent_inverse = holder, ((1, 0, 0, 3), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))
        shown.scale, shown.rotation_euler.x = (2.0, 1.0, 0.5), 0.3
        shown.keyframe_insert("location", frame=1)
        shown.location.z = 4.0
        shown.keyframe_insert("location", frame=20)
        shown.driver_add("delta_scale", 0).driver.expression = "frame"
        shown.constraints.new("LIMIT_LOCATION").use_max_x = True
        other, collection = shown.copy(), bpy.data.collections.new("others")
        other.animation_data_clear()
        other.location.y = -7.0
        scene.collection.children.link(collection)
        collection.objects.link(other)
        # Blender computes no transforms of hidden objects, so compare with the transforms that the
        # objects have before the conversion.
        frames, places = (1, 10, 20), []
        for frame in frames:
            scene.frame_set(frame)
            places.append([np.array(each.matrix_world) for each in (shown, other)])
        before = set(bpy.data.objects)
        converted(shown)
        first, second = sorted(set(bpy.data.objects) - before, key=lambda each: each.users_collection[0] == collection)
        assert second.users_collection[0] == collection and shown.hide_viewport and other.hide_render
        for frame, place in zip(frames, places):
            scene.frame_set(frame)
            assert np.allclose([first.matrix_world, second.matrix_world], place), (kind, frame)
        assert not np.allclose(places[0], places[2]) and first.matrix_world != second.matrix_world
        if kind == "MESHES":
            evaluated = first.evaluated_get(bpy.context.evaluated_depsgraph_get())
            assert np.allclose(positions(evaluated.data), expected(20, cell=0.5).vertices, atol=1e-5), "the files must keep the axes of the particles"


@check
def a_conversion_to_volumes_is_played_by_a_volume() -> None:
    shown, scene = dam(), bpy.context.scene
    output = options.folder / "vdb"
    shutil.rmtree(output, ignore_errors=True)
    settings = shown.data.meniscus
    settings.converted, settings.output = "VOLUMES", str(output) + os.sep
    conversion = converted(shown)
    assert (conversion.done, conversion.total) == (3, 3), vars(conversion)
    (played,) = (each for each in bpy.data.objects if each.type == "VOLUME")
    assert shown.hide_render and not settings.live
    for number, file in zip((1, 10, 20), sorted(output.glob("*.vdb")), strict=True):
        frame = settings.start + number - settings.first
        scene.frame_set(frame)
        evaluated = played.evaluated_get(bpy.context.evaluated_depsgraph_get())
        grids = evaluated.data.grids
        assert grids.load() and [grid.name for grid in grids] == ["surface", "v"], grids.error_message
        assert os.path.samefile(bpy.path.abspath(grids.frame_filepath), file), (frame, grids.frame_filepath)
    bpy.data.objects.remove(played)


@check
def a_conversion_is_played_as_a_sequence_cache() -> None:
    shown, scene = dam(), bpy.context.scene
    scene.render.fps = 25
    output = options.folder / "usd"
    shutil.rmtree(output, ignore_errors=True)
    settings = shown.data.meniscus
    settings.output = str(output) + os.sep
    conversion = converted(shown)
    assert (conversion.done, conversion.total) == (3, 3), vars(conversion)
    played = [each for each in bpy.data.objects if each.modifiers.get("MeshSequenceCache") or any(m.type == "MESH_SEQUENCE_CACHE" for m in each.modifiers)]
    assert len(played) == 1 and shown.hide_render, list(bpy.data.objects)
    from json import loads

    listing = loads((output / f"{shown.data.name}.usdc.json").read_text())
    for frame in listing["frames"]:
        scene.frame_set(round(frame["time"] * 25))
        evaluated = played[0].evaluated_get(bpy.context.evaluated_depsgraph_get())
        assert sizes(evaluated.data) == (frame["vertices"], frame["triangles"]), (frame, sizes(evaluated.data))
        assert "velocity" in evaluated.data.attributes or "velocities" in evaluated.data.attributes, list(evaluated.data.attributes.keys())
    scene.frame_set(1)
    evaluated = played[0].evaluated_get(bpy.context.evaluated_depsgraph_get())
    lowest = np.min([np.array(evaluated.matrix_world) @ [*corner, 1.0] for corner in evaluated.bound_box], axis=0)
    upright = np.min([np.array(shown.matrix_world) @ [*corner, 1.0] for corner in positions(shown.data)], axis=0)
    assert abs(lowest[:3] - upright[:3]).max() < 0.1, (lowest, upright)
    # With another start frame and step, the sequence cache shows the same times as the live
    # surface.
    settings.start, settings.step = 5, 9.5
    bpy.data.objects.remove(played[0])
    (replayed,) = operators.play(bpy.context, shown.data, conversion.order.stage)
    for frame, number in [(5, 0), (6, 1), (7, 2)]:
        scene.frame_set(frame)
        evaluated = replayed.evaluated_get(bpy.context.evaluated_depsgraph_get())
        assert sizes(evaluated.data)[1] == listing["frames"][number]["triangles"], (frame, sizes(evaluated.data))
    again = operators.Conversion(operators.order_of(shown.data, scene))
    began = time.perf_counter()
    again.start()
    again.join()
    assert not again.error and time.perf_counter() - began < 5.0
    settings.smooth = 2.0
    ended = operators.Conversion(operators.order_of(shown.data, scene))
    ended.cancel()
    ended.start()
    ended.join()
    assert not ended.error and not ended.is_complete and ended.done == 0, vars(ended)
    settings.path = str(options.folder / "nowhere_{}.bgeo")
    try:
        operators.order_of(shown.data, scene)
        raise AssertionError("order_of accepted files that do not exist")
    except meniscus.Error as error:
        assert "nowhere_" in str(error), error


@check
def unregistering_removes_handlers_and_properties() -> None:
    dam()
    before = sum(map(len, (getattr(bpy.app.handlers, name) for name in ("frame_change_pre", "frame_change_post", "undo_post", "render_init"))))
    extension.unregister()
    assert not hasattr(bpy.types.Mesh, "meniscus")
    after = sum(map(len, (getattr(bpy.app.handlers, name) for name in ("frame_change_pre", "frame_change_post", "undo_post", "render_init"))))
    assert after == before - 4
    bpy.context.scene.frame_set(10)
    extension.register()
    bpy.context.scene.frame_set(20)
    assert shows(bpy.context.object.data, expected(20))


record_computed_surfaces()
failed = 0
for sentence in checks:
    try:
        sentence()
        print(f"ok: {sentence.__name__.replace('_', ' ')}", flush=True)
    except Exception:
        failed += 1
        import traceback

        traceback.print_exc()
        print(f"FAILED: {sentence.__name__.replace('_', ' ')}", flush=True)
print(f"{len(checks) - failed} passed, {failed} failed")
sys.exit(failed > 0)

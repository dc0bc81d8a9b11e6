import json, sys
import bpy
import numpy as np

folder = sys.argv[sys.argv.index("--") + 1]
listing = json.load(open(f"{folder}/dam.ply.json"))


# Debian's Blender 3.4 cannot import USD.
has_usd = "usd_import" in dir(bpy.ops.wm)
kinds = ["ply", "usdc"] if has_usd else ["ply"]


def imported(call, path):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    if call == "ply":
        has_new = "ply_import" in dir(bpy.ops.wm)
        (bpy.ops.wm.ply_import if has_new else bpy.ops.import_mesh.ply)(filepath=path)
    else:
        bpy.ops.wm.usd_import(filepath=path)
    return next(o for o in bpy.data.objects if o.type == "MESH")


def counts(mesh):
    return len(mesh.vertices), len(mesh.polygons)


for frame in listing["frames"]:
    expected = (frame["vertices"], frame["triangles"])
    stem = f"{folder}/{frame['file']}".rsplit(".", 1)[0]
    for kind in kinds:
        path = f"{stem}.{kind}"
        mesh = imported(kind, path).data
        assert counts(mesh) == expected, (path, counts(mesh), expected)
        print(f"{path.rsplit('/', 1)[1]}: {counts(mesh)}, attributes {[a.name for a in mesh.attributes]}")


def columns(path):
    """Reads a .ply of meniscus, and returns its vertices' numbers by property name, with z up."""
    header, body = open(path, "rb").read().split(b"end_header\n", 1)
    lines = header.decode().splitlines()
    count = next(int(line.split()[2]) for line in lines if line.startswith("element vertex"))
    names = [line.split()[2] for line in lines if line.startswith("property float")]
    rows = np.frombuffer(body, "<f4", len(names) * count).reshape(count, -1).astype(float)
    named = {name: rows[:, index] for index, name in enumerate(names)}
    return lambda *axes: np.stack([named[axes[0]], -named[axes[2]], named[axes[1]]], 1)


def numbers(values, name, width):
    found = np.empty(width * len(values), np.int32 if name.startswith("vert") else np.float32)
    values.foreach_get(name, found)
    return found.reshape(-1, width)


bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.fps = round(listing["fps"])
bpy.ops.wm.alembic_import(filepath=f"{folder}/dam.abc")
shown = next(o for o in bpy.data.objects if o.type == "MESH")
assert (scene.frame_start, scene.frame_end) == (listing["frames"][0]["frame"], listing["frames"][-1]["frame"])
for frame in listing["frames"]:
    scene.frame_set(frame["frame"])
    mesh = shown.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    assert counts(mesh) == (frame["vertices"], frame["triangles"]), (frame, counts(mesh))
    expected = columns(f"{folder}/{frame['file']}")
    points = numbers(mesh.vertices, "co", 3)
    assert np.array_equal(points, expected("x", "y", "z"))
    velocity = mesh.attributes.get("velocity")
    # In Blender 3.4, Python cannot access this attribute.
    if velocity is not None:
        assert np.array_equal(numbers(velocity.data, "vector", 3), expected("vx", "vy", "vz"))
    mesh.calc_loop_triangles()
    a, b, c = (points[corner].astype(float) for corner in numbers(mesh.loop_triangles, "vertices", 3).T)
    outwards = np.cross(b - a, c - a)
    volume = np.einsum("ij,ij->", a, outwards) / 6
    assert volume > 0
    if hasattr(mesh, "corner_normals"):
        normals = numbers(mesh.corner_normals, "vector", 3)
        corners = np.empty(len(mesh.loops), np.int32)
        mesh.loops.foreach_get("vertex_index", corners)
        assert (normals * expected("nx", "ny", "nz")[corners]).sum(1).min() > 0.999
    print(f"dam.abc at frame {frame['frame']}: {counts(mesh)}, volume {volume:.3f}")
# A Volume object must show the file of each frame.
bpy.ops.wm.read_factory_settings(use_empty=True)
numbers_of_files = [frame["frame"] for frame in listing["frames"]]
volume = bpy.data.volumes.new("dam")
volume.filepath = f"{folder}/dam_{numbers_of_files[0]}.vdb"
volume.is_sequence = True
volume.frame_start = numbers_of_files[0]
volume.frame_offset = numbers_of_files[0] - 1
volume.frame_duration = numbers_of_files[-1] - numbers_of_files[0] + 1
shown = bpy.data.objects.new("dam", volume)
bpy.context.collection.objects.link(shown)
for frame in listing["frames"]:
    bpy.context.scene.frame_set(frame["frame"])
    evaluated = shown.evaluated_get(bpy.context.evaluated_depsgraph_get())
    grids = evaluated.data.grids
    assert grids.load(), grids.error_message
    assert [(grid.name, grid.data_type) for grid in grids] == [("surface", "FLOAT"), ("v", "VECTOR_FLOAT")]
    assert grids.frame_filepath.endswith(f"/dam_{frame['frame']}.vdb"), grids.frame_filepath
    # The bounding box is larger than the surface, because it consists of leaves of 8 voxels.
    points = columns(f"{folder}/{frame['file']}")("x", "y", "z")
    corners = np.array([tuple(corner) for corner in evaluated.bound_box])
    leaf = 8 * grids[0].matrix_object[0][0]
    beyond = [points.min(0) - corners.min(0), corners.max(0) - points.max(0)]
    assert np.min(beyond) >= 0 and np.max(beyond) < 2 * leaf, (beyond, leaf)
    print(f"dam_{frame['frame']}.vdb: {len(grids)} grids, box {corners.min(0)} to {corners.max(0)}")
if not has_usd:
    print("this Blender is built without USD")
    sys.exit(0)
blob = imported("usd", f"{folder}/dam.usda")
for frame in listing["frames"]:
    bpy.context.scene.frame_set(round(frame["time"] * listing["fps"]))
    mesh = blob.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    assert counts(mesh) == (frame["vertices"], frame["triangles"]), (frame, counts(mesh))
    print(f"dam.usda at {frame['time']} s: {counts(mesh)}, attributes {[a.name for a in mesh.attributes]}")

import json, sys
import bpy

folder = sys.argv[sys.argv.index("--") + 1]
listing = json.load(open(f"{folder}/dam.ply.json"))


# Debian's Blender 3.4 is built without USD.
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
if not has_usd:
    print("this Blender is built without USD")
    sys.exit(0)
blob = imported("usd", f"{folder}/dam.usda")
for frame in listing["frames"]:
    bpy.context.scene.frame_set(round(frame["time"] * listing["fps"]))
    mesh = blob.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    assert counts(mesh) == (frame["vertices"], frame["triangles"]), (frame, counts(mesh))
    print(f"dam.usda at {frame['time']} s: {counts(mesh)}, attributes {[a.name for a in mesh.attributes]}")

import json, sys
from pxr import Usd, UsdGeom

folder = sys.argv[1]
listing = json.load(open(f"{folder}/dam.usdc.json"))
rate, frames = listing["fps"], listing["frames"]


def mesh_of(path):
    stage = Usd.Stage.Open(path)
    prim = stage.GetDefaultPrim()
    assert prim.GetPath() == "/fluid" and prim.IsA(UsdGeom.Mesh)
    return stage, UsdGeom.Mesh(prim)


for frame in frames:
    stage, mesh = mesh_of(f"{folder}/{frame['file']}")
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1 and UsdGeom.GetStageUpAxis(stage) == "Y"
    assert mesh.GetSubdivisionSchemeAttr().Get() == "none"
    for time in [Usd.TimeCode.Default(), 0, 7]:
        points, counts = mesh.GetPointsAttr().Get(time), mesh.GetFaceVertexCountsAttr().Get(time)
        corners = mesh.GetFaceVertexIndicesAttr().Get(time)
        assert len(points) == len(mesh.GetVelocitiesAttr().Get(time)) == frame["vertices"]
        assert len(mesh.GetNormalsAttr().Get(time)) == frame["vertices"]
        assert len(counts) == frame["triangles"] and set(counts) == {3}
        assert UsdGeom.Mesh.ValidateTopology(corners, counts, len(points))[0]
        extent = UsdGeom.PointBased.ComputeExtent(points)
        assert list(extent) == list(mesh.GetExtentAttr().Get(time)), (extent, mesh.GetExtentAttr().Get(time))
    density = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("density")
    assert density.GetInterpolation() == "vertex" and len(density.Get()) == frame["vertices"]
    assert mesh.GetNormalsInterpolation() == "vertex"
print(f"{len(frames)} layers: counts, topology, extent, normals, velocities, primvars")

_, mesh = mesh_of(f"{folder}/empty_1.usdc")
counts, corners = mesh.GetFaceVertexCountsAttr().Get(0), mesh.GetFaceVertexIndicesAttr().Get(0)
assert len(mesh.GetPointsAttr().Get(0)) == len(mesh.GetNormalsAttr().Get()) == len(counts) == len(corners) == 0
assert UsdGeom.Mesh.ValidateTopology(corners, counts, 0)[0]
assert list(UsdGeom.PointBased.ComputeExtent([])) == list(mesh.GetExtentAttr().Get(0))
print("an empty layer")

# The layers must have the same numbers as the .ply files.
def ply(path):
    import struct
    data = open(path, "rb").read()
    header, body = data.split(b"end_header\n", 1)
    lines = header.decode().splitlines()
    vertices = next(int(l.split()[2]) for l in lines if l.startswith("element vertex"))
    names = [l.split()[2] for l in lines if l.startswith("property float")]
    rows = struct.iter_unpack(f"<{len(names)}f", body[: 4 * len(names) * vertices])
    rows = [dict(zip(names, row)) for row in rows]
    return [tuple(r[k] for k in "xyz") for r in rows], [tuple(r[k] for k in ("vx", "vy", "vz")) for r in rows]


stage, mesh = mesh_of(f"{folder}/dam.usda")
codes = [frame["time"] * rate for frame in frames]
assert UsdGeom.GetStageUpAxis(stage) == "Y" and stage.GetTimeCodesPerSecond() == rate
assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (codes[0], codes[-1])
assert mesh.GetSubdivisionSchemeAttr().Get() == "none"
ends = codes[1:] + [codes[-1] + 2]
for frame, code, end in zip(frames, codes, ends):
    points, velocities = ply(f"{folder}/dam_{round(code)}.ply")
    for time in [code, (code + end) / 2, end - 0.25]:
        assert [tuple(p) for p in mesh.GetPointsAttr().Get(time)] == points, (code, time)
        assert len(mesh.GetFaceVertexCountsAttr().Get(time)) == frame["triangles"]
        density = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("density")
        assert density.GetInterpolation() == "vertex" and len(density.Get(time)) == frame["vertices"]
        assert len(mesh.GetNormalsAttr().Get(time)) == frame["vertices"]
        moved = mesh.ComputePointsAtTime(time, time)
        seconds = (time - code) / rate
        worst = max(abs(m[a] - (p[a] + v[a] * seconds)) for m, p, v in zip(moved, points, velocities) for a in range(3))
        assert worst < 1e-5, (code, time, worst)
print(f"stage: time codes {codes}, points follow the velocities between them")

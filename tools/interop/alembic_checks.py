import json, sys
import numpy as np
from alembic3d import Abc, AbcGeom

folder = sys.argv[1]
listing = json.load(open(f"{folder}/dam.ply.json"))


def columns(path):
    """Reads a .ply of meniscus, and returns its vertices' numbers by property name."""
    header, body = open(path, "rb").read().split(b"end_header\n", 1)
    lines = header.decode().splitlines()
    count = next(int(line.split()[2]) for line in lines if line.startswith("element vertex"))
    names = [line.split()[2] for line in lines if line.startswith("property float")]
    rows = np.frombuffer(body, "<f4", len(names) * count).reshape(count, -1)
    return lambda *axes: np.stack([rows[:, names.index(axis)] for axis in axes], 1)


def threes(values):
    return np.array([tuple(value) for value in values], np.float32).reshape(-1, 3)


archive = Abc.IArchive(f"{folder}/dam.abc")
fluid = archive.getTop().getChild(0)
schema = AbcGeom.IPolyMesh(fluid, fluid.getChild(0).getName()).getSchema()
assert schema.getNumSamples() == len(listing["frames"]), schema.getNumSamples()
assert str(schema.getTopologyVariance()).endswith("kHeterogenousTopology"), schema.getTopologyVariance()
times = schema.getTimeSampling()
for index, frame in enumerate(listing["frames"]):
    time = times.getSampleTime(index)
    assert abs(time - frame["frame"] / listing["fps"]) < 1e-9, (time, frame)
    selector = Abc.ISampleSelector(time)
    sample = schema.getValue(selector)
    expected = columns(f"{folder}/{frame['file']}")
    positions = threes(sample.getPositions())
    assert np.array_equal(positions, expected("x", "y", "z"))
    assert np.array_equal(threes(sample.getVelocities()), expected("vx", "vy", "vz"))
    normals = threes(schema.getNormalsParam().getExpandedValue(selector).getVals())
    assert np.array_equal(normals, expected("nx", "ny", "nz"))
    assert set(sample.getFaceCounts()) <= {3}
    corners = np.array(list(sample.getFaceIndices())).reshape(-1, 3)
    assert len(corners) == frame["triangles"]
    box = sample.getSelfBounds()
    assert np.allclose([tuple(box.min()), tuple(box.max())], [positions.min(0), positions.max(0)])
    # Alembic lists the corners of a face clockwise, seen from outside.
    a, b, c = (positions[corner].astype(float) for corner in corners.T)
    volume = -np.einsum("ij,ij->", a, np.cross(b - a, c - a)) / 6
    assert volume > 0
    print(f"dam.abc at {time:.2f} s: {len(positions)} vertices, {len(corners)} triangles, volume {volume:.3f}")

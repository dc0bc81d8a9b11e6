"""usage: simulations_checks.py FOLDER COUNT MENISCUS, after simulation_files.py FOLDER COUNT"""

import json
import subprocess
import sys

import h5py
import numpy as np
import vtk
from vtk.util.numpy_support import vtk_to_numpy

from simulation_files import EDGE, TIME, points

folder, count, meniscus = sys.argv[1], int(sys.argv[2]), sys.argv[3]
values = points(count)


def info(name, *options):
    return json.loads(subprocess.check_output([meniscus, "info", "--json", f"{folder}/{name}", *options]))[0]


def check(name, expected, ghosts=0, velocity="velocity", tolerance=0.0, options=(), **fields):
    found = info(name, *options)
    assert (found["particles"], found["ghosts"]) == (len(expected), ghosts), found
    box = [expected.min(0), expected.max(0)]
    assert np.allclose(found["bounds"], box, rtol=tolerance, atol=0), (name, found["bounds"], box)
    names = {a["name"]: a["components"] for a in found["attributes"]}
    assert names[velocity] == 3, (name, names)
    for key, value in fields.items():
        assert found[key] is not None and np.allclose(found[key], value, rtol=1e-6), (name, key, found[key])
    print(f"{name}: {found['format']}, {found['particles']} particles, {ghosts} ghosts")


unflagged = np.delete(values, [1, 5], axis=0)
check("poly_0007.pvtp", values, 8)
check("grid_0007.pvtu", values, 8)
check("poly.vtkhdf", unflagged, 2)
check("grid.vtkhdf", unflagged, 2)
check("cells.vtkhdf", unflagged, 2)
for name in ["cells_poly_42", "cells_poly_51", "cells_grid_42", "cells_grid_51"]:
    check(f"{name}.vtk", unflagged, 2, tolerance=1e-9)
for name, rows in [
    ("flags_poly.vtkhdf#0", [0, 2, 5]),
    ("flags_grid.vtkhdf#1", [6, 7, 8, 10, 12]),
    ("flags_poly.vtkhdf#2", [1, 2, 3, 4]),
]:
    assert np.allclose(info(name)["bounds"], [values[rows].min(0), values[rows].max(0)]), name
    print(f"{name}: {len(rows)} particles that are not ghosts")
for step, rows in [(0, count), (1, 8), (2, count)]:
    check(f"steps.vtkhdf#{step}", values[:rows] + 10 * step, tolerance=1e-6)
check("swift_0003.hdf5", values, velocity="Velocities", box_size=[EDGE] * 3, unit_metres=3.0856776e22)
check("swift_0003.hdf5", values[:5] / 2, velocity="Velocities", options=["--where", "type=PartType1"])
for piece in range(3):
    name = f"gadget_005.{piece}.hdf5"
    check(name, values, velocity="Velocities", tolerance=1e-6, box_size=[EDGE] * 3, unit_metres=1)
check("gadget_005.hdf5", values, velocity="Velocities", tolerance=1e-6, box_size=[EDGE] * 3)
check("openpmd.h5#100", values, tolerance=1e-12)
check("openpmd.h5#200", values + 10, tolerance=1e-12)
check("pysph_40.hdf5", values, 2)
check("pysph_40.hdf5", values[:3], options=["--where", "type=wall"])

# VTK and h5py read the meshes, whose values must equal the values of the .vtp in the same folder.
for ending in ["vtp", "pvtp", "vtkhdf"]:
    arguments = ["reconstruct", f"{folder}/grid_0007.pvtu", "-o", f"{folder}/mesh.{ending}", "-q", "--spacing", "0.2"]
    subprocess.check_call([meniscus, *arguments, "--normals", "--attributes", "velocity,id"])
readers = dict(vtp=vtk.vtkXMLPolyDataReader, pvtp=vtk.vtkXMLPPolyDataReader, vtkhdf=vtk.vtkHDFReader)


def read(name):
    reader = readers[name.rsplit(".", 1)[1]]()
    reader.SetFileName(f"{folder}/{name}")
    reader.Update()
    return reader.GetOutput()


def arrays(data):
    """Returns the positions and attributes of the corners of every triangle."""
    corners = vtk_to_numpy(data.GetPolys().GetConnectivityArray())
    found = {"points": vtk_to_numpy(data.GetPoints().GetData())}
    for index in range(data.GetPointData().GetNumberOfArrays()):
        found[data.GetPointData().GetArrayName(index)] = vtk_to_numpy(data.GetPointData().GetArray(index))
    found.pop("GlobalPointIds", None)
    return {name: array[corners] for name, array in found.items()}


mesh = arrays(read("mesh.vtp"))
assert sorted(mesh) == ["Normals", "id", "points", "velocity"], sorted(mesh)
for name in ["mesh.pvtp", "mesh.vtkhdf"]:
    found = arrays(read(name))
    assert sorted(found) == sorted(mesh), (name, sorted(found))
    assert all(np.array_equal(found[key], mesh[key]) for key in mesh), name
    subprocess.check_call([meniscus, "check", f"{folder}/{name}"], stdout=subprocess.DEVNULL)
    distance = json.loads(subprocess.check_output([meniscus, "compare", "--json", f"{folder}/mesh.vtp", f"{folder}/{name}"]))
    assert distance["hausdorff"] < 1e-12, (name, distance)
    print(f"{name}: {len(mesh['points']) // 3} triangles as VTK reads them")
with h5py.File(f"{folder}/mesh.vtkhdf") as file:
    assert file["VTKHDF"].attrs["Type"] == b"PolyData" and list(file["VTKHDF"].attrs["Version"]) == [2, 0]
    assert file["VTKHDF/Points"].chunks is None and file["VTKHDF/Points"].dtype == "<f4"

# Check that meniscus reads a mesh that VTK wrote.
sphere = vtk.vtkSphereSource()
sphere.SetThetaResolution(40)
sphere.SetPhiResolution(20)
sphere.Update()
hdf = vtk.vtkHDFWriter()
hdf.SetFileName(f"{folder}/sphere.vtkhdf")
hdf.SetInputConnection(sphere.GetOutputPort())
assert hdf.Write()
cells = sphere.GetOutput().GetNumberOfPolys()
found = info("sphere.vtkhdf")
assert (found["kind"], found["triangles"]) == ("mesh", cells), found
subprocess.check_call([meniscus, "check", f"{folder}/sphere.vtkhdf"], stdout=subprocess.DEVNULL)
print(f"sphere.vtkhdf: {cells} triangles that VTK wrote")

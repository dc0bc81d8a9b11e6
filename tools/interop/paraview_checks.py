import json, pathlib, subprocess, sys
from paraview.simple import OpenDataFile, PVDReader
from vtkmodules.vtkCommonCore import vtkFloatArray, vtkPoints
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData, vtkUnstructuredGrid
from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter, vtkXMLUnstructuredGridWriter

folder, meniscus = sys.argv[1:]
frames = json.load(open(f"{folder}/dam.ply.json"))["frames"]
times = [frame["time"] for frame in frames]

for name in ["dam.pvd", "dam.vtp.series", "dam.vtk.series", "dam.ply.series", "dam.pvtp.series"]:
    path = f"{folder}/{name}"
    reader = PVDReader(FileName=path) if name.endswith(".pvd") else OpenDataFile(path)
    reader.UpdatePipelineInformation()
    assert list(reader.TimestepValues) == times, (name, list(reader.TimestepValues))
    for frame in frames:
        reader.UpdatePipeline(frame["time"])
        info = reader.GetDataInformation()
        assert info.GetNumberOfPoints() == frame["vertices"], (name, info.GetNumberOfPoints(), frame)
        assert info.GetNumberOfCells() == frame["triangles"], (name, info.GetNumberOfCells(), frame)
    arrays = sorted(reader.PointData.keys())
    if "vt" in name or "pvd" in name:
        assert {"Normals", "velocity", "density"} <= set(arrays), (name, arrays)
        lo, hi = reader.PointData["velocity"].GetRange(1)
        assert lo < -0.5, (name, lo, hi)
    print(f"{name}: times {times}, arrays {arrays}")

reader = PVDReader(FileName=f"{folder}/empty.pvd")
reader.UpdatePipeline(times[0])
info = reader.GetDataInformation()
assert (info.GetNumberOfPoints(), info.GetNumberOfCells()) == (0, 0)
print("an empty simulation")

# ParaView must read a mesh in several pieces as one mesh.
path = f"{folder}/fine.pvtp"
checked = json.loads(subprocess.run([meniscus, "check", "--json", path], check=True, capture_output=True).stdout)[0]
reader = OpenDataFile(path)
reader.UpdatePipeline()
info = reader.GetDataInformation()
report = checked["report"]
assert info.GetNumberOfCells() == report["triangles"] and checked["closed_oriented_manifold"], (info.GetNumberOfCells(), checked)
# Each piece contains all vertices of its triangles. A vertex in two pieces therefore occurs twice,
# with the same identifier.
identifiers = [array for array in reader.PointData.keys() if reader.PointData[array].GetRange() == (0, report["vertices"] - 1)]
assert len(identifiers) == 1, list(reader.PointData.keys())
assert info.GetNumberOfPoints() > report["vertices"], info.GetNumberOfPoints()
lo, hi = reader.PointData["velocity"].GetRange(1)
assert lo < -0.5, (lo, hi)
pieces = len(list(pathlib.Path(f"{folder}/fine").glob("*.vtp")))
assert pieces > 1, pieces
print(f"fine.pvtp: {pieces} pieces, {report['vertices']} vertices in {identifiers[0]}, {report['triangles']} triangles")

# Write particles with VTK's own writers, for meniscus to read.
count = 5000
points, velocity, cells = vtkPoints(), vtkFloatArray(), vtkCellArray()
velocity.SetName("velocity")
velocity.SetNumberOfComponents(3)
for i in range(count):
    point = (i % 10 * 0.5, i // 10 % 10 * 0.25, i // 100 * 0.125)
    points.InsertNextPoint(*point)
    velocity.InsertNextTuple3(*(2 * x for x in point))
    cells.InsertNextCell(1, [i])
poly, grid = vtkPolyData(), vtkUnstructuredGrid()
poly.SetVerts(cells)
grid.SetCells(1, cells)
for data in [poly, grid]:
    data.SetPoints(points)
    data.GetPointData().AddArray(velocity)
read = 0
for data, writer_of, extension in [(poly, vtkXMLPolyDataWriter, "vtp"), (grid, vtkXMLUnstructuredGridWriter, "vtu")]:
    for mode in ["Ascii", "Binary", "Appended"]:
        for encode in [False, True]:
            for compressor in ["None", "ZLib"]:
                for header in ["32", "64"]:
                    for order in ["BigEndian", "LittleEndian"]:
                        writer = writer_of()
                        path = f"{folder}/particles.{extension}"
                        writer.SetFileName(path)
                        writer.SetInputData(data)
                        getattr(writer, f"SetDataModeTo{mode}")()
                        writer.SetEncodeAppendedData(encode)
                        getattr(writer, f"SetCompressorTypeTo{compressor}")()
                        getattr(writer, f"SetHeaderTypeToUInt{header}")()
                        getattr(writer, f"SetByteOrderTo{order}")()
                        assert writer.Write() == 1
                        info = json.loads(subprocess.check_output([meniscus, "info", "--json", path]))[0]
                        assert info["kind"] == "particles" and info["particles"] == count, (path, info)
                        assert info["bounds"] == [[0, 0, 0], [4.5, 2.25, 6.125]], info
                        assert info["attributes"] == [{"name": "velocity", "components": 3}], info
                        read += 1
print(f"particles: read {read} .vtp and .vtu files of VTK's own writers")

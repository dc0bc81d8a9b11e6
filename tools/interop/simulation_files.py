"""Writes particles in the formats of large simulation codes, each with the library of that code.

usage: simulation_files.py FOLDER [COUNT]

Needs numpy, h5py, vtk, openpmd-api, swiftsimio and pysph. With COUNT 24, these are the files of
tests/data/simulations. Every file has the points of points.csv. Each velocity is twice the
position.
"""

import os
import sys

import h5py
import numpy as np

TIME = 0.75
EDGE = 4.0


def points(count):
    return EDGE * np.random.default_rng(7).random((count, 3))


def vtk_set(kind, values, ghosts=(), ids=None, ghost_cells=None):
    """Builds PolyData or an UnstructuredGrid of points.

    The points numbered `ghosts`, or the vertices numbered `ghost_cells`, are flagged as ghosts.
    """
    from vtk.util.numpy_support import numpy_to_vtk
    import vtk

    data = vtk.vtkPolyData() if kind == "poly" else vtk.vtkUnstructuredGrid()
    where = vtk.vtkPoints()
    where.SetData(numpy_to_vtk(np.ascontiguousarray(values), deep=1))
    data.SetPoints(where)
    if kind == "poly":
        cells = vtk.vtkCellArray()
        for i in range(len(values)):
            cells.InsertNextCell(1, [i])
        data.SetVerts(cells)
    else:
        data.Allocate(len(values))
        for i in range(len(values)):
            data.InsertNextCell(vtk.VTK_VERTEX, 1, [i])
    ids = np.arange(len(values)) if ids is None else ids
    for name, array in [("velocity", 2 * np.asarray(values)), ("id", ids.astype("i8"))]:
        array = numpy_to_vtk(np.ascontiguousarray(array), deep=1)
        array.SetName(name)
        data.GetPointData().AddArray(array)
    flagged = [
        (data.GetPointData(), ghosts, vtk.vtkDataSetAttributes.DUPLICATEPOINT),
        (data.GetCellData(), ghost_cells, vtk.vtkDataSetAttributes.DUPLICATECELL),
    ]
    for attributes, numbers, copy in flagged:
        if numbers is not None:
            flags = np.zeros(len(values), "u1")
            flags[list(numbers)] = copy
            array = numpy_to_vtk(flags, deep=1)
            array.SetName(vtk.vtkDataSetAttributes.GhostArrayName())
            attributes.AddArray(array)
    time = vtk.vtkDoubleArray()
    time.SetName("TimeValue")
    time.InsertNextValue(TIME)
    data.GetFieldData().AddArray(time)
    return data


def overlapping(values):
    """Divides the points into two pieces. Each piece also has four points of the other piece, as ghosts."""
    half = len(values) // 2
    ids = np.arange(len(values))
    first, second = np.r_[0 : half + 4], np.r_[half - 4 : len(values)]
    return [(values[first], range(half, half + 4), ids[first]), (values[second], range(4), ids[second])]


def vtk_pieces(folder, values):
    """Writes a .pvtp and a .pvtu with two pieces and ghosts, with VTK's parallel writers."""
    import vtk
    from vtk.util.vtkAlgorithm import VTKPythonAlgorithmBase

    class Source(VTKPythonAlgorithmBase):
        """Returns the requested piece, like one process of a parallel simulation."""

        def __init__(self, kind, output):
            super().__init__(nInputPorts=0, nOutputPorts=1, outputType=output)
            self.kind = kind

        def RequestInformation(self, request, inputs, outputs):
            outputs.GetInformationObject(0).Set(vtk.vtkAlgorithm.CAN_HANDLE_PIECE_REQUEST(), 1)
            return 1

        def RequestData(self, request, inputs, outputs):
            wanted = outputs.GetInformationObject(0)
            number = wanted.Get(vtk.vtkStreamingDemandDrivenPipeline.UPDATE_PIECE_NUMBER())
            wanted.Get(vtk.vtkDataObject.DATA_OBJECT()).ShallowCopy(vtk_set(self.kind, *overlapping(values)[number]))
            return 1

    for kind, output, ending, writer in [
        ("poly", "vtkPolyData", "pvtp", vtk.vtkXMLPPolyDataWriter()),
        ("grid", "vtkUnstructuredGrid", "pvtu", vtk.vtkXMLPUnstructuredGridWriter()),
    ]:
        source = Source(kind, output)
        writer.SetFileName(f"{folder}/{kind}_0007.{ending}")
        writer.SetInputConnection(source.GetOutputPort())
        writer.SetNumberOfPieces(2)
        writer.SetStartPiece(0)
        writer.SetEndPiece(1)
        writer.SetUseSubdirectory(True)
        writer.EncodeAppendedDataOff()
        writer.SetCompressorTypeToNone()
        assert writer.Write()


def vtkhdf(folder, values):
    """Writes VTKHDF files with VTK's own writer, and a file with three steps as the specification says."""
    import vtk

    for kind in ["poly", "grid"]:
        writer = vtk.vtkHDFWriter()
        writer.SetFileName(f"{folder}/{kind}.vtkhdf")
        # Chunks of the default size would be mostly empty.
        writer.SetChunkSize(16)
        writer.SetInputData(vtk_set(kind, values, ghosts=[1, 5]))
        assert writer.Write()
    with h5py.File(f"{folder}/steps.vtkhdf", "w") as file:
        root = file.create_group("VTKHDF")
        root.attrs["Version"] = np.array([2, 0])
        root.attrs.create("Type", np.bytes_("PolyData"))
        # Each step has two partitions, and the second step has fewer points.
        counts = [[10, len(values) - 10], [5, 3], [len(values), 0]]
        flat = [part for step in counts for part in step]
        root["NumberOfPoints"] = np.array(flat)
        shown = np.concatenate([values[: sum(parts)] + 10 * step for step, parts in enumerate(counts)])
        root["Points"] = shown.astype("f4")
        root["PointData/velocity"] = 2 * shown
        for faces in ["Vertices", "Lines", "Polygons", "Strips"]:
            group = root.create_group(faces)
            group["NumberOfCells"] = np.zeros(len(flat), "i8")
            group["NumberOfConnectivityIds"] = np.zeros(len(flat), "i8")
            group["Offsets"] = np.zeros(len(flat), "i8")
            group["Connectivity"] = np.zeros(0, "i8")
        steps = root.create_group("Steps")
        steps.attrs["NSteps"] = 3
        steps["Values"] = TIME * np.arange(3)
        starts = np.cumsum([0] + [sum(parts) for parts in counts[:-1]])
        for name, entries in [("PartOffsets", [0, 2, 4]), ("NumberOfParts", [2, 2, 2]), ("PointOffsets", starts)]:
            steps[name] = np.array(entries)
        for name in ["CellOffsets", "ConnectivityIdOffsets"]:
            steps[name] = np.zeros((3, 4), "i8")
        steps["PointDataOffsets/velocity"] = starts


def ghost_cells(folder, values):
    """Writes files in which vertices, not points, are flagged as ghosts.

    VTK's own writers write them as VTKHDF, and as legacy files in text and binary.
    """
    import vtk

    flagged = dict(ghosts=None, ghost_cells=[1, 5])
    writer = vtk.vtkHDFWriter()
    writer.SetFileName(f"{folder}/cells.vtkhdf")
    writer.SetChunkSize(16)
    writer.SetInputData(vtk_set("grid", values, **flagged))
    assert writer.Write()
    for kind, writer in [("poly", vtk.vtkPolyDataWriter()), ("grid", vtk.vtkUnstructuredGridWriter())]:
        for version in [42, 51]:
            writer.SetFileName(f"{folder}/cells_{kind}_{version}.vtk")
            writer.SetFileVersion(version)
            writer.SetFileType(vtk.VTK_ASCII if kind == "poly" else vtk.VTK_BINARY)
            writer.SetInputData(vtk_set(kind, values, **flagged))
            assert writer.Write()


# The partitions of `ghost_steps`. Each partition contains points, the point and the flag of every
# vertex, and the flags of lines. In the last partition, the second point has two vertices, and the
# fourth point has none.
PARTITIONS = [
    (6, [(5, 0), (4, 1), (3, 8), (2, 2), (1, 32), (0, 0)], []),
    (0, [], []),
    (3, [(0, 1), (1, 1), (2, 1)], [1]),
    (4, [(0, 1), (1, 1), (1, 0), (2, 1), (2, 1)], []),
]
# The steps of `ghost_steps`: first partition, number of partitions, first point, first cell of each
# kind, first corner of each kind, and first value of the cells' data.
STEPS = [
    (0, 2, 0, (0, 0), (0, 0), 0),
    (2, 2, 6, (6, 0), (6, 0), 6),
    # The same as the first step, but with different flags.
    (0, 2, 0, (0, 0), (0, 0), 15),
    # The points and cells of the first step, as a separate partition.
    (4, 1, 0, (0, 0), (0, 0), 0),
]


def ghost_steps(folder, values):
    """Writes steps whose partitions have vertices flagged as ghosts, as VTKHDF's specification says.

    One file has PolyData, and one an UnstructuredGrid.
    """
    first = PARTITIONS[0]
    flags = [flag for _, vertices, lines in PARTITIONS for flag in [flag for _, flag in vertices] + lines]
    flags += [1 - min(flag, 1) for _, flag in first[1]]
    for kind, name in [("PolyData", "flags_poly"), ("UnstructuredGrid", "flags_grid")]:
        parts = PARTITIONS + [first]
        shown = sum(points for points, _, _ in PARTITIONS)
        with h5py.File(f"{folder}/{name}.vtkhdf", "w") as file:
            root = file.create_group("VTKHDF")
            root.attrs["Version"] = np.array([2, 0])
            root.attrs.create("Type", np.bytes_(kind))
            root["NumberOfPoints"] = np.array([points for points, _, _ in parts])
            root["Points"] = values[:shown]
            root["PointData/id"] = np.arange(shown)
            root["CellData/vtkGhostType"] = np.array(flags, "u1")

            def cells(group, of_parts):
                """Writes the cells of every partition as lists of corners. The last partition uses the first one's cells."""
                group["NumberOfCells"] = np.array([len(cells) for cells in of_parts])
                group["NumberOfConnectivityIds"] = np.array([sum(map(len, cells)) for cells in of_parts])
                ends = [np.cumsum([0] + [len(cell) for cell in cells]) for cells in of_parts[:-1]]
                group["Offsets"] = np.concatenate(ends)
                group["Connectivity"] = np.array([point for cells in of_parts[:-1] for cell in cells for point in cell], "i8")

            vertices = [[[point] for point, _ in vertices] for _, vertices, _ in parts]
            lines = [[[0, 1]] * len(lines) for _, _, lines in parts]
            if kind == "PolyData":
                none = [[] for _ in parts]
                for faces, of_parts in [("Vertices", vertices), ("Lines", lines), ("Polygons", none), ("Strips", none)]:
                    cells(root.create_group(faces), of_parts)
            else:
                of_parts = [own + more for own, more in zip(vertices, lines)]
                cells(root, of_parts)
                root["Types"] = np.array([len(cell) * 2 - 1 for cells in of_parts[:-1] for cell in cells], "u1")
            steps = root.create_group("Steps")
            # The last step refers to its cells by their offset, which VTK supports only for
            # PolyData.
            used_steps = STEPS if kind == "PolyData" else STEPS[:-1]
            steps.attrs["NSteps"] = len(used_steps)
            steps["Values"] = TIME * np.arange(len(used_steps))
            for column, name in enumerate(["PartOffsets", "NumberOfParts", "PointOffsets"]):
                steps[name] = np.array([step[column] for step in used_steps])
            for column, name in [(3, "CellOffsets"), (4, "ConnectivityIdOffsets")]:
                by_kind = [(*step[column], 0, 0) for step in used_steps]
                steps[name] = np.array(by_kind if kind == "PolyData" else [[sum(entry)] for entry in by_kind])
            steps["CellDataOffsets/vtkGhostType"] = np.array([step[5] for step in used_steps])
            steps["PointDataOffsets/id"] = np.array([step[2] for step in used_steps])


def swift(folder, values):
    """Writes a snapshot with gas and dark matter with swiftsimio."""
    import unyt
    from swiftsimio import Writer, cosmo_array

    box = cosmo_array([EDGE] * 3, unyt.Mpc, comoving=True, scale_factor=1.0, scale_exponent=1)
    writer = Writer(boxsize=box, extra_header={"Time": [TIME]})
    unit = writer.a.comoving
    kinds = [(writer.gas, values), (writer.dark_matter, values[:5] / 2)]
    for kind, where in kinds:
        kind.coordinates = where * unyt.Mpc * unit
        kind.velocities = 2 * where * unyt.km / unyt.s * unit**0
        kind.masses = np.ones(len(where)) * 1e10 * unyt.solMass * unit**0
    writer.gas.internal_energy = np.ones(len(values)) * (unyt.km / unyt.s) ** 2 * unit**-2
    writer.gas.smoothing_lengths = np.full(len(values), 0.1) * unyt.Mpc * unit
    writer.write(f"{folder}/swift_0003.hdf5")


def gadget(folder, values):
    """Writes a snapshot in three files in GADGET's layout, and a virtual file that joins them, as SWIFT writes it.

    The second file has no gas.
    """
    cuts = [(0, 9, "f8"), (9, 9, "f8"), (9, len(values), "f4")]
    dark = [0, 4, 2]
    for number, (first, end, kind) in enumerate(cuts):
        with h5py.File(f"{folder}/gadget_005.{number}.hdf5", "w") as file:
            header = file.create_group("Header")
            header.attrs["NumPart_ThisFile"] = np.array([end - first, dark[number], 0, 0, 0, 0], "i4")
            header.attrs["NumPart_Total"] = np.array([len(values), sum(dark), 0, 0, 0, 0], "u4")
            header.attrs["NumPart_Total_HighWord"] = np.zeros(6, "u4")
            header.attrs["NumFilesPerSnapshot"] = 3
            header.attrs["Time"] = TIME
            header.attrs["BoxSize"] = EDGE
            file.create_group("Parameters").attrs["UnitLength_in_cm"] = 100.0
            if end > first:
                gas = file.create_group("PartType0")
                chunks = dict(chunks=(4, 3), compression="gzip", shuffle=True)
                gas.create_dataset("Coordinates", data=values[first:end].astype(kind), **chunks)
                gas.create_dataset("Velocities", data=2 * values[first:end].astype("f4"), **chunks)
                gas["ParticleIDs"] = np.arange(first, end, dtype="u8")
            if dark[number]:
                file["PartType1/Coordinates"] = np.full((dark[number], 3), number, "f8")
                file["PartType1/Velocities"] = np.zeros((dark[number], 3))
    with h5py.File(f"{folder}/gadget_005.hdf5", "w") as file:
        with h5py.File(f"{folder}/gadget_005.0.hdf5") as first:
            first.copy("Header", file)
        file["Header"].attrs["NumPart_ThisFile"] = np.array([len(values), sum(dark), 0, 0, 0, 0], "i4")
        file["Header"].attrs["Virtual"] = 1
        layout = h5py.VirtualLayout(shape=values.shape, dtype="f8")
        for number, (first, end, _) in enumerate(cuts):
            if end > first:
                layout[first:end] = h5py.VirtualSource(f"gadget_005.{number}.hdf5", "PartType0/Coordinates", shape=(end - first, 3))
        file.create_group("PartType0").create_virtual_dataset("Coordinates", layout)


def openpmd(folder, values):
    """Writes two iterations of a species.

    It has positions in millimetres from an offset in metres, an identifier, and a constant weight.
    """
    import openpmd_api as io

    series = io.Series(f"{folder}/openpmd.h5", io.Access.create, '{"hdf5": {"dataset": {"chunks": "none"}}}')
    for step, shift in [(100, 0.0), (200, 10.0)]:
        iteration = series.iterations[step]
        iteration.time, iteration.time_unit_SI, iteration.dt = 1000.0 * TIME * step / 100, 1e-3, 1.0
        species = iteration.particles["water"]
        count = len(values)
        for axis, name in enumerate("xyz"):
            for record, array, unit in [
                ("position", 1000 * (values[:, axis] - 1), 1e-3),
                ("velocity", 2 * values[:, axis].astype("f4"), 1.0),
            ]:
                component = species[record][name]
                component.reset_dataset(io.Dataset(array.dtype, [count]))
                component.store_chunk(np.ascontiguousarray(array))
                component.unit_SI = unit
            offset = species["positionOffset"][name]
            offset.reset_dataset(io.Dataset(np.dtype("f8"), [count]))
            offset.make_constant(1.0 + shift)
            offset.unit_SI = 1.0
        ids = species["id"][io.Record_Component.SCALAR]
        ids.reset_dataset(io.Dataset(np.dtype("u8"), [count]))
        ids.store_chunk(np.arange(count, dtype="u8"))
        weight = species["weighting"][io.Record_Component.SCALAR]
        weight.reset_dataset(io.Dataset(np.dtype("f8"), [count]))
        weight.make_constant(3.0)
        series.flush()
    series.close()


def pysph(folder, values):
    """Writes a fluid with two ghost particles and a wall with PySPH's own writer."""
    from pysph.base.utils import get_particle_array
    from pysph.solver.output import dump

    def array(name, where):
        x, y, z = np.array(where).T
        return get_particle_array(name=name, x=x, y=y, z=z, u=2 * x, v=2 * y, w=2 * z, m=1.0)

    fluid = array("fluid", np.concatenate([values, values[:2] + EDGE]))
    fluid.tag[-2:] = [1, 2]
    fluid.align_particles()
    arrays = [fluid, array("wall", values[:3])]
    dump(f"{folder}/pysph_40.hdf5", arrays, dict(t=TIME, dt=0.1, count=40), detailed_output=True, only_real=False)


if __name__ == "__main__":
    folder, count = sys.argv[1], int((sys.argv[2:] or [24])[0])
    os.makedirs(folder, exist_ok=True)
    values = points(count)
    np.savetxt(f"{folder}/points.csv", values, fmt="%.17g", delimiter=",", header="x,y,z", comments="")
    for make in [vtk_pieces, vtkhdf, ghost_cells, ghost_steps, swift, gadget, openpmd, pysph]:
        make(folder, values)

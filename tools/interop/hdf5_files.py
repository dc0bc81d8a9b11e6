"""Writes the HDF5 files of tests/data/h5 with h5py. usage: hdf5_files.py FOLDER"""

import sys
import h5py
import numpy as np

folder = sys.argv[1]
points = np.random.default_rng(1).random((60, 3))
with h5py.File(f"{folder}/steps.h5part", "w") as file:
    for step in (0, 2, 10):
        group = file.create_group(f"Step#{step}")
        group.attrs["TimeValue"] = 0.25 * step
        for axis, name in enumerate("xyz"):
            group[name] = points[:, axis] + step
            group[f"v{name}"] = points[:, axis].astype("f4")
        group["id"] = np.arange(60)
        group["nparticles"] = 60
with h5py.File(f"{folder}/packed.h5", "w", libver="latest") as file:
    file.attrs["time"] = np.float32(1.5)
    file.create_dataset("pos", data=points.astype(">f4"), chunks=(16, 3), compression="gzip", shuffle=True, fletcher32=True)
    file.create_dataset("velocity", data=2 * points, chunks=(16, 3), compression="gzip")
    file.create_dataset("mass", data=np.ones(60, "f4"))
    file.create_dataset("box", data=np.zeros((8, 3)))
    file["name"] = "pool"
# A data set that declares more rows than a file of this size can contain.
with h5py.File(f"{folder}/huge.h5", "w") as file:
    file.create_dataset("pos", shape=(1 << 40, 3), chunks=(1024, 3), dtype="f8")
# A table with a compound type in compressed chunks, as CB-Geo MPM and PyTables write it.
kinds = [("id", "u2"), ("coord_x", "f4"), ("coord_y", "f8"), ("coord_z", ">f4"), ("velocity", "f4", 3), ("name", "S3")]
table = np.zeros(60, kinds)
table["id"] = np.arange(60)
for axis, name in enumerate("xyz"):
    table[f"coord_{name}"] = points[:, axis]
table["velocity"] = 2 * points
with h5py.File(f"{folder}/table.h5", "w", libver="latest") as file:
    file.create_dataset("mpm/particles", data=table, chunks=(16,), compression="gzip")
# Arrays with the components along the first axis, as Taichi and MATLAB write them.
with h5py.File(f"{folder}/columns.h5", "w", libver="latest") as file:
    file["x"] = points.T
    file.create_dataset("v", data=2 * points.T, chunks=(2, 25), compression="lzf")
    file["C"] = np.zeros((9, 60), "i1")
    file["X"] = np.zeros((3, 60), "f4")
    file["time"] = [[0.5]]
# An H5MD file with three frames. The second frame has two particles fewer.
with h5py.File(f"{folder}/h5md.h5", "w", libver="latest") as file:
    file.create_group("h5md").attrs["version"] = [1, 1]
    fluid = file.create_group("particles/fluid")
    fluid["box/edges"] = [1.0, 2.0, 3.0]
    steps, times = np.array([0, 100, 200]), np.array([0, 0.5, 1])
    ids = np.tile(np.arange(60), (3, 1))
    ids[1, 7:9] = -1
    frames = points + np.arange(3)[:, None, None]
    for name, values in (("position", frames), ("velocity", 2 * frames), ("id", ids)):
        element = fluid.create_group(name)
        element.create_dataset("value", data=values, chunks=(2, *values.shape[1:]), compression="gzip")
        element["step"], element["time"] = steps, times
    fluid["force/value"], fluid["force/step"] = np.zeros((3, 60, 3), "i1"), [0, 1, 2]
    fluid["mass"] = np.ones(60)
# Frames as groups, each with groups for two kinds of particles, as EDEM writes them.
with h5py.File(f"{folder}/groups.h5", "w", libver="latest") as file:
    for number in (3, 20):
        frame = file.create_group(f"TimestepData/{number}")
        frame.attrs["time"] = number / 4
        frame["ParticleTypes/sand/position"] = points + number
        frame["ParticleTypes/wall/position"] = np.zeros((4, 3), "f4")
# Two groups with an attribute called "type", although this name also selects a group, and with
# arrays of up to 100 numbers per row.
with h5py.File(f"{folder}/types.h5", "w", libver="latest") as file:
    for name in ("PartType0", "wall"):
        group = file.create_group(name)
        group["position"] = points
        group["type"] = (np.arange(60) % 3).astype("u1")
        group["gradient"] = np.arange(540, dtype="f4").reshape(60, 3, 3)
        group["spectrum"] = np.zeros((60, 100), "i1")
# Two groups of particles; the name of one of them is Fluid.
with h5py.File(f"{folder}/fluid.h5", "w", libver="latest") as file:
    file["Fluid/position"] = points
    file["boundary/position"] = np.zeros((4, 3), "f4")
# An openPMD file with two species; the name of one of them is fluid.
with h5py.File(f"{folder}/species.h5", "w", libver="latest") as file:
    file.attrs["openPMD"], file.attrs["basePath"] = "1.1.0", "/data/%T/"
    file.attrs["particlesPath"] = "particles/"
    for species, positions in (("fluid", points), ("walls", np.zeros((4, 3)))):
        for axis, name in enumerate("xyz"):
            file[f"data/0/particles/{species}/position/{name}"] = positions[:, axis]
# A virtual data set of the positions in another file.
layout = h5py.VirtualLayout((60, 3), "f8")
layout[:] = h5py.VirtualSource("fluid.h5", "Fluid/position", shape=(60, 3))
with h5py.File(f"{folder}/virtual.h5", "w", libver="latest") as file:
    file.create_virtual_dataset("pos", layout)
# A gas and a liquid: as groups, as arrays of PySPH and as species of openPMD. Some arrays have
# other lengths than the positions.
with h5py.File(f"{folder}/gas_groups.h5", "w", libver="latest") as file:
    file["gas/position"] = np.zeros((4, 3), "f4")
    file["liquid/position"] = points
with h5py.File(f"{folder}/gas_pysph.hdf5", "w", libver="latest") as file:
    file.create_group("solver_data").attrs["t"] = 0.5
    for name, positions in (("gas", np.zeros((4, 3))), ("liquid", points)):
        arrays = file.create_group(f"particles/{name}/arrays")
        for axis, coordinate in enumerate("xyz"):
            arrays[coordinate] = positions[:, axis]
        arrays["au"] = np.zeros(0, "f4")
        arrays["gradient"] = np.zeros(9 * len(positions), "i1")
with h5py.File(f"{folder}/gas_openpmd.h5", "w", libver="latest") as file:
    file.attrs["openPMD"], file.attrs["basePath"] = "1.1.0", "/data/%T/"
    file.attrs["particlesPath"] = "particles/"
    for species, positions in (("gas", np.zeros((4, 3))), ("liquid", points)):
        for axis, name in enumerate("xyz"):
            file[f"data/0/particles/{species}/position/{name}"] = positions[:, axis]
        file[f"data/0/particles/{species}/mass"] = np.ones(55, "f4")
with h5py.File(f"{folder}/shapes.h5", "w", libver="latest") as file:
    file["pos"], file["vel"] = points, np.zeros((55, 3), "f4")
    file["mass"], file["bounds"] = np.ones(60, "f4"), np.zeros((2, 3))
# Groups whose names are bare numbers: frames, types of particles, and frames next to a wall.
with h5py.File(f"{folder}/numbers.h5", "w", libver="latest") as file:
    for number in (9, 10, 11):
        frame = file.create_group(f"{number}")
        frame["time"] = number / 4
        frame["fluid/position"] = points + number
        frame["wall/position"] = np.zeros((4, 3), "f4")
    file["units/length"] = [1.0]
with h5py.File(f"{folder}/number_types.h5", "w", libver="latest") as file:
    file["0/position"] = file["1/position"] = np.zeros((4, 3), "f4")
    file["1/velocity"] = np.zeros((4, 3), "f4")
with h5py.File(f"{folder}/number_walls.h5", "w", libver="latest") as file:
    for name in ("0", "1", "wall"):
        file[f"{name}/position"] = np.zeros((4, 3), "f4")

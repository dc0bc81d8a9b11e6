"""Makes the HDF5 files of tests/data/h5, by h5py. usage: hdf5_files.py FOLDER"""

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
# As many rows as no file of this size can hold.
with h5py.File(f"{folder}/huge.h5", "w") as file:
    file.create_dataset("pos", shape=(1 << 40, 3), chunks=(1024, 3), dtype="f8")

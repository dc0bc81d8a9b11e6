import json, subprocess, sys
import numpy as np

folder, meniscus = sys.argv[1:]
points = np.random.default_rng(1).random((5000, 3))
read = 0


def check(path, values, attributes):
    global read
    info = json.loads(subprocess.check_output([meniscus, "info", "--json", path]))[0]
    assert info["particles"] == len(values), info
    assert info["bounds"] == [values.min(0).tolist(), values.max(0).tolist()], info
    found = {a["name"]: a["components"] for a in info["attributes"]}
    assert found == attributes, (found, attributes)
    read += 1


for kind in ["<f4", ">f4", "<f8", ">f8"]:
    for order in "CF":
        values = points.astype(kind, order=order)
        np.save(f"{folder}/a.npy", values)
        check(f"{folder}/a.npy", values.astype("f8"), {})
        for save in [np.savez, np.savez_compressed]:
            ids = np.arange(len(points))
            save(f"{folder}/a.npz", pos=values, vel=2 * values, id=ids, mass=np.ones(len(points)), dt=0.1, name="pool",
                 box=np.zeros((8, 3)), solid=ids % 2 == 0)
            check(f"{folder}/a.npz", values.astype("f8"), {"vel": 3, "id": 1, "mass": 1, "solid": 1})
            x, y, z = values.T
            save(f"{folder}/b.npz", x=x, y=y, z=z, vx=x, vy=y, vz=z)
            check(f"{folder}/b.npz", values.astype("f8"), {"v": 3})
            save(f"{folder}/c.npz", values)
            check(f"{folder}/c.npz", values.astype("f8"), {})
print(f"read {read} .npy and .npz files of NumPy {np.__version__}")

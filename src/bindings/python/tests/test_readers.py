"""This module reads particle files of all formats and number widths like the program."""

from __future__ import annotations

import gzip
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import meniscus
from conftest import ROOT, lattice

DATA = ROOT / "tests" / "data"
# Files that other programs wrote. Options give the spacing if the file contains none and has too
# few particles for an estimate.
FILES: dict[str, dict[str, Any]] = {
    "dambreak_small/ParticleData_Fluid_20.bgeo": {},
    "dambreak_small/ParticleData_Fluid_10.vtk": {},
    "dualsphysics_dambreak/Part_0005.bi4": {},
    "simulations/grid_0007.pvtu": {"spacing": 0.1},
    "simulations/poly_0007.pvtp": {"spacing": 0.1},
    "simulations/grid_0007/grid_0007_0.vtu": {"spacing": 0.1},
    "simulations/poly_0007/poly_0007_1.vtp": {"spacing": 0.1},
    "simulations/grid.vtkhdf": {"spacing": 0.1},
    "simulations/steps.vtkhdf#1": {"spacing": 0.1},
    "simulations/swift_0003.hdf5": {"spacing": 0.1},
    "simulations/gadget_005.hdf5": {"spacing": 0.1},
    "simulations/openpmd.h5#200": {"spacing": 0.1},
    "simulations/pysph_40.hdf5": {"spacing": 0.1},
    "simulations/points.csv": {"spacing": 0.1},
    "h5/steps.h5part#10": {"spacing": 0.1},
}
# Files that this test writes, with 32-bit and 64-bit numbers.
WRITTEN = ["csv", "dat", "dump", "json", "npy", "npz", "ply", "txt", "vtk", "vtp", "vtu"]


def put(path: Path, positions: Any, velocity: Any) -> None:
    """Writes particles in the format that the extension selects, with numbers as wide as the positions'."""
    kind, bits = path.suffix[1:], positions.dtype.itemsize * 8
    count = len(positions)
    if kind == "npy":
        np.save(path, positions)
    elif kind == "npz":
        np.savez(path, positions=positions, velocity=velocity)
    elif kind == "json":
        path.write_text(json.dumps(positions.tolist()))
    elif kind == "dump":
        names = "x y z vx vy vz"
        box = "".join(f"{lowest:.17g} {highest:.17g}\n" for lowest, highest in zip(positions.min(axis=0) - 1, positions.max(axis=0) + 1))
        head = f"ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n{count}\nITEM: BOX BOUNDS ff ff ff\n{box}ITEM: ATOMS {names}"
        np.savetxt(path, np.hstack([positions, velocity]), fmt="%.17g", header=head, comments="")
    elif kind in ("csv", "dat", "txt"):
        apart = "," if kind == "csv" else " "
        head = apart.join(["x", "y", "z", "vx", "vy", "vz"])
        np.savetxt(path, np.hstack([positions, velocity]), fmt="%.17g", delimiter=apart, header=head, comments="")
    elif kind == "ply":
        name = {32: "float", 64: "double"}[bits]
        columns = "".join(f"property {name} {axis}\n" for axis in "xyz")
        columns += "".join(f"property float v{axis}\n" for axis in "xyz")
        rows = np.zeros(count, [("x", positions.dtype.newbyteorder("<"), 3), ("v", "<f4", 3)])
        rows["x"], rows["v"] = positions, velocity
        head = f"ply\nformat binary_little_endian 1.0\nelement vertex {count}\n{columns}end_header\n"
        path.write_bytes(head.encode() + rows.tobytes())
    elif kind == "vtk":
        name = {32: "float", 64: "double"}[bits]
        head = f"# vtk DataFile Version 3.0\nwater\nBINARY\nDATASET POLYDATA\nPOINTS {count} {name}\n"
        data = f"\nPOINT_DATA {count}\nVECTORS velocity float\n"
        big = positions.astype(positions.dtype.newbyteorder(">"))
        path.write_bytes(head.encode() + big.tobytes() + data.encode() + velocity.astype(">f4").tobytes() + b"\n")
    else:
        dataset, counts = {
            "vtp": ("PolyData", f'NumberOfPoints="{count}" NumberOfVerts="0"'),
            "vtu": ("UnstructuredGrid", f'NumberOfPoints="{count}" NumberOfCells="0"'),
        }[kind]
        blocks = [block.astype(block.dtype.newbyteorder("<")).tobytes() for block in (positions, velocity)]
        arrays = [
            f'<DataArray type="Float{wide}" {name}NumberOfComponents="3" format="appended" offset="{offset}"/>'
            for wide, name, offset in [(bits, "", 0), (32, 'Name="velocity" ', 4 + len(blocks[0]))]
        ]
        cells = '<Cells><DataArray type="Int32" Name="connectivity" format="ascii"/><DataArray type="Int32" Name="offsets" format="ascii"/>'
        cells += '<DataArray type="UInt8" Name="types" format="ascii"/></Cells>'
        head = f'<VTKFile type="{dataset}" version="0.1" byte_order="LittleEndian"><{dataset}><Piece {counts}><Points>{arrays[0]}</Points>'
        head += f'<PointData>{arrays[1]}</PointData>{cells if kind == "vtu" else ""}</Piece></{dataset}>'
        head += '<AppendedData encoding="raw">_'
        appended = b"".join(len(block).to_bytes(4, "little") + block for block in blocks)
        path.write_bytes(head.encode() + appended + b"</AppendedData></VTKFile>")


def compare(folder: Path, program: Any, path: Path, options: dict[str, Any]) -> meniscus.Particles:
    """Checks that the program's mesh of a file equals this module's meshes of the file and of the file's arrays."""
    given = [f"--{name}={value}" for name, value in options.items()]
    program("reconstruct", path, "-o", folder / "theirs.ply", "-q", "--overwrite", *given)
    theirs = (folder / "theirs.ply").read_bytes()
    particles = meniscus.read_particles(path)
    keywords = {"spacing": particles.spacing, "particles_up": particles.up, **options}
    meshes = {
        "arrays": meniscus.reconstruct(particles.positions, velocity=particles.velocity, **keywords),
        "file": meniscus.Frame.load(path, **options).surface(),
    }
    for by, mesh in meshes.items():
        mesh.write(folder / f"{by}.ply", overwrite=True)
        assert (folder / f"{by}.ply").read_bytes() == theirs, f"{path} by its {by}"
    return particles


@pytest.mark.parametrize("file", FILES)
def test_files_of_other_programs_give_the_programs_bytes(tmp_path: Path, program: Any, file: str) -> None:
    assert len(compare(tmp_path, program, DATA / file, FILES[file])) > 0


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("extension", WRITTEN)
def test_every_width_of_numbers_gives_the_programs_bytes(tmp_path: Path, program: Any, extension: str, dtype: str) -> None:
    # Move float64 particles so far from the origin that float32 would change their positions.
    positions = (lattice(6.0) + (1000.0 if dtype == "float64" else 0.0)).astype(dtype)
    velocity = positions.astype(np.float32)
    path = tmp_path / f"water.{extension}"
    put(path, positions, velocity)
    particles = compare(tmp_path, program, path, {"spacing": 1.0})
    assert np.array_equal(particles.positions, positions)
    if extension not in ("json", "npy"):
        assert particles.velocity is not None and np.array_equal(particles.velocity, velocity)
    # The gzipped file must give the same mesh.
    packed = path.with_suffix(path.suffix + ".gz")
    packed.write_bytes(gzip.compress(path.read_bytes()))
    assert np.array_equal(compare(tmp_path, program, packed, {"spacing": 1.0}).positions, positions)


def test_files_without_a_header_give_the_programs_bytes(tmp_path: Path, program: Any) -> None:
    positions = lattice(6.0).astype("<f4")
    path = tmp_path / "water.xyz"
    path.write_bytes(positions.tobytes())
    assert np.array_equal(compare(tmp_path, program, path, {"spacing": 1.0}).positions, positions)


def test_all_formats_of_the_program_are_tested() -> None:
    with pytest.raises(meniscus.InputError) as raised:
        meniscus.read_particles("water.abc")
    known = set(re.findall(r"\.(\w+)", str(raised.value).split("abc", 1)[1])) - {"gz", "xz", "zst"}
    assert len(known) > 15
    tried = {Path(file.split("#")[0]).suffix[1:] for file in FILES} | set(WRITTEN) | {"xyz"}
    # Extensions of files with the same data as another format, or of files that list a dataset's
    # pieces.
    alike = {"bhclassic": "bgeo", "geo": "bgeo", "sc": "bgeo", "extxyz": "xyz", "h5md": "h5", "hdf": "hdf5", "lammpstrj": "dump", "vtm": "pvtp", "vtpc": "pvtp", "vtpd": "pvtp"}
    assert {alike.get(name, name) for name in known} == tried


def test_particles_of_a_file_are_selected_by_their_attributes(tmp_path: Path, program: Any) -> None:
    positions = lattice(6.0)
    path = tmp_path / "water.npz"
    np.savez(path, positions=np.concatenate([positions, positions + 50.0]), kind=np.repeat(np.array([1, 2], np.int32), len(positions)))
    read = meniscus.read_particles(path, where="kind=1")
    assert np.array_equal(read.positions, positions) and set(read.attributes["kind"].tolist()) == {1}
    assert len(meniscus.read_particles(path, where=["kind=2", "x<51"])) < len(positions)
    program("reconstruct", path, "-o", tmp_path / "theirs.ply", "-q", "--spacing", 1, "--where", "kind=1")
    mesh = meniscus.Frame.load(path, spacing=1.0, where="kind=1").surface()
    mesh.write(tmp_path / "ours.ply")
    assert (tmp_path / "ours.ply").read_bytes() == (tmp_path / "theirs.ply").read_bytes()
    with pytest.raises(meniscus.Error, match="heat"):
        meniscus.read_particles(path, where="heat=1")


def test_integers_in_files_stay_integers(tmp_path: Path) -> None:
    positions = lattice(6.0)
    numbers = np.arange(len(positions)) + 2**24
    dtypes = {"int16": "int32", "int32": "int32", "uint32": "uint32", "int64": "int64", "float64": "float32"}
    path = tmp_path / "water.npz"
    np.savez(path, positions=positions, **{name: (numbers % 1000 if name == "int16" else numbers).astype(name) for name in dtypes})
    read = meniscus.read_particles(path)
    assert {name: str(values.dtype) for name, values in read.attributes.items()} == dtypes
    assert np.array_equal(read.attributes["uint32"], numbers) and np.array_equal(read.attributes["int64"], numbers)
    mesh = meniscus.Frame.load(path, spacing=1.0, attributes=["uint32", "int64"]).surface()
    arrays = meniscus.reconstruct(positions, spacing=1.0, attributes={name: read.attributes[name] for name in ("uint32", "int64")})
    for name in "uint32", "int64":
        assert mesh.attributes[name].dtype == {"uint32": np.uint32, "int64": np.int32}[name]
        assert np.array_equal(mesh.attributes[name], arrays.attributes[name])
    assert set(mesh.attributes["int64"].tolist()) <= set(numbers.tolist())

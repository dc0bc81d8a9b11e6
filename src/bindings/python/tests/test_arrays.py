"""Arrays of every kind are read in place."""

from __future__ import annotations

import array
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import meniscus


class OnlyDLPack:
    """An array that offers only DLPack, as arrays of other libraries do."""

    def __init__(self, of: Any, device: tuple[int, int] = (1, 0), name: str = "") -> None:
        self.of, self.where, self.device = of, device, name

    def __dlpack__(self, **keywords: Any) -> Any:
        assert self.where[0] == 1, "meniscus must not read an array on a device"
        return self.of.__dlpack__(**keywords)

    def __dlpack_device__(self) -> tuple[int, int]:
        return self.where


def same(mesh: meniscus.Mesh, other: meniscus.Mesh) -> bool:
    return np.array_equal(mesh.vertices, other.vertices) and np.array_equal(mesh.triangles, other.triangles)


def strided(ball: Any) -> Any:
    wide = np.full((2 * len(ball), 7), np.nan, ball.dtype)
    view = wide[::-2, 5::-2]
    view[:] = ball
    return view


def unaligned(ball: Any) -> Any:
    raw = np.zeros(ball.nbytes + 1, np.uint8)[1:]
    view = raw.view(ball.dtype).reshape(ball.shape)
    view[:] = ball
    assert not view.flags.aligned
    return view


def of_structure(ball: Any) -> Any:
    record = np.zeros(len(ball), [("id", "u1"), ("x", ball.dtype, 3)])
    record["x"] = ball
    return record["x"]


def buffer(ball: Any) -> Any:
    return memoryview(np.ascontiguousarray(ball))


def read_only(ball: Any) -> Any:
    copy = ball.copy()
    copy.setflags(write=False)
    return copy


KINDS = {
    "fortran": np.asfortranarray,
    "strided": strided,
    "reversed": lambda ball: ball[::-1].copy()[::-1],
    "unaligned": unaligned,
    "of a structure": of_structure,
    "read-only": read_only,
    "DLPack": OnlyDLPack,
    "buffer": buffer,
    "a view of bytes": lambda ball: np.frombuffer(ball.tobytes(), ball.dtype).reshape(-1, 3),
}


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_array_gives_the_mesh_of_a_contiguous_array(ball: Any, kind: str, dtype: str) -> None:
    plain = ball.astype(dtype)
    kept = plain.copy()
    heat = plain[:, 1].copy()
    mesh = meniscus.reconstruct(KINDS[kind](plain), velocity=KINDS[kind](plain), attributes={"heat": heat}, spacing=1.0)
    wanted = meniscus.reconstruct(plain, velocity=plain, attributes={"heat": heat}, spacing=1.0)
    assert same(mesh, wanted)
    for name in "velocity", "heat":
        assert np.array_equal(mesh.attributes[name], wanted.attributes[name])
    assert np.array_equal(plain, kept)


def test_positions_are_not_copied() -> None:
    # The array repeats one row, so it takes no memory, but a copy would take 192 MB.
    code = """
import re, numpy, meniscus
def peak(): return int(re.search(r"VmHWM:\\s+(\\d+)", open("/proc/self/status").read())[1]) / 1024
many = numpy.broadcast_to(numpy.zeros((1, 3)), (8_000_000, 3))
before = peak()
meniscus.reconstruct(many, spacing=1.0, memory="64MiB", threads=2)
print(peak() - before)
"""
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", code], capture_output=True, text=True, check=True)
    assert float(done.stdout) < 150


def test_a_torch_tensor_in_host_memory_is_read_by_dlpack(ball: Any) -> None:
    torch = pytest.importorskip("torch")
    assert same(meniscus.reconstruct(torch.from_numpy(ball.copy())), meniscus.reconstruct(ball))


@pytest.mark.parametrize("keyword", ["positions", "velocity"])
def test_an_array_on_a_device_is_a_type_error_that_suggests_cpu(ball: Any, keyword: str) -> None:
    arrays = {"positions": ball, keyword: OnlyDLPack(ball, (2, 0), "cuda:0")}
    with pytest.raises(TypeError, match=rf"^{keyword}: OnlyDLPack is on cuda:0; use \.cpu\(\) to copy it to the CPU"):
        meniscus.reconstruct(**arrays)

    class Cuda:
        __cuda_array_interface__: dict[str, Any] = {}

    with pytest.raises(TypeError, match=r"is on a CUDA device; use \.cpu\(\)"):
        meniscus.reconstruct(Cuda())  # type: ignore[arg-type]

    class Nowhere(OnlyDLPack):
        def __dlpack_device__(self) -> tuple[int, int]:
            raise ValueError("no such device")

    with pytest.raises(TypeError, match=r"^positions: Nowhere cannot be read as an array: no such device"):
        meniscus.reconstruct(Nowhere(ball))


def test_an_error_for_an_array_without_astype_names_its_type_and_conversion(ball: Any) -> None:
    class Half(OnlyDLPack):
        dtype = "torch.half"

        def float(self) -> None: ...

    with pytest.raises(TypeError, match=r"not float16; use \.float\(\)"):
        meniscus.reconstruct(Half(ball.astype(np.float16)))
    with pytest.raises(TypeError, match=r"^positions: Half of torch\.half cannot be read as an array: "):
        meniscus.reconstruct(Half(ball.astype(object)))


def test_an_error_for_a_field_names_the_method_that_makes_an_array() -> None:
    class Field:
        def to_numpy(self) -> None: ...

    with pytest.raises(TypeError, match=r"^positions: must be an array, not Field; try \.to_numpy\(\)"):
        meniscus.reconstruct(Field())  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("positions", "error", "what"),
    [
        (np.zeros((5, 2)), meniscus.InputError, r"shape \(N, 3\), not \(5, 2\); .*column of zeros"),
        (np.zeros(3), meniscus.InputError, r"not \(3,\)"),
        (np.zeros((1, 5, 3)), meniscus.InputError, r"not \(1, 5, 3\)"),
        (np.zeros((5, 3), np.int64), TypeError, r"not int64; use \.astype"),
        (np.zeros((5, 3), np.float16), TypeError, "not float16"),
        (np.zeros((5, 3), np.complex64), TypeError, "not complex64"),
        (np.zeros((5, 3), object), TypeError, "not object"),
        (np.zeros((5, 3), ">f8"), TypeError, r"byte-swapped \(>f8\)"),
        (np.zeros((5, 3), ">f4"), TypeError, r'use \.astype\("float32"\)'),
        (np.zeros((3, 5)), meniscus.InputError, r"not \(3, 5\); use \.T"),
        (np.zeros(5, [("x", "f4"), ("y", "f4"), ("z", "f4")]), TypeError, r"; use numpy\.lib\.recfunctions\.structured_to_unstructured"),
        (np.ma.masked_array(np.zeros((5, 3))), TypeError, r"has a mask; use \.filled\(numpy\.nan\)"),
        (np.ma.masked_array(np.zeros((5, 3), int)), TypeError, r'has a mask; use \.astype\("float32"\)\.filled\(numpy\.nan\)'),
        ([[0.0, 0.0, 0.0]], TypeError, "not list"),
        ("positions", TypeError, "not str"),
        (None, TypeError, "not NoneType"),
        (array.array("d", [0.0] * 9), meniscus.InputError, r"not \(9,\)"),
        (b"bytes", TypeError, "not uint8"),
    ],
)
def test_invalid_positions_give_an_error_that_names_the_argument(positions: Any, error: type[Exception], what: str) -> None:
    with pytest.raises(error, match=f"^positions: .*{what}"):
        meniscus.reconstruct(positions)
    with pytest.raises(error, match=f"^positions: .*{what}"):
        meniscus.Frame(positions)
    with pytest.raises(error, match=f"^positions: .*{what}"):
        meniscus.Simulation().frame(positions)


@pytest.mark.parametrize(
    ("keywords", "error", "what"),
    [
        ({"velocity": np.zeros((4, 3))}, meniscus.InputError, "velocity: has 4 rows for 5 particles"),
        ({"velocity": np.zeros((5, 2))}, meniscus.InputError, r"velocity: .*not \(5, 2\)"),
        ({"attributes": {"t": np.zeros(6)}}, meniscus.InputError, r'attributes\["t"\]: has 6 rows for 5'),
        ({"attributes": {"t": np.zeros((5, 2, 2))}}, meniscus.InputError, r'attributes\["t"\]: .*\(5, 2, 2\)'),
        ({"attributes": {"t": np.zeros((5, 0))}}, meniscus.InputError, r'attributes\["t"\]'),
        ({"attributes": {"t": np.zeros(5, complex)}}, TypeError, r'attributes\["t"\]: .*or integers, not complex128'),
        ({"attributes": {"t": np.zeros(5, bool)}}, TypeError, r'attributes\["t"\]: .*not bool'),
        ({"attributes": {"t": np.zeros(5, ">i4")}}, TypeError, r'byte-swapped \(>i4\); use \.astype\("int32"\)'),
        ({"velocity": np.zeros((5, 3), int)}, TypeError, "velocity: .*not int64"),
        ({"attributes": {"t": np.ma.masked_array(np.zeros(5, int))}}, TypeError, r'attributes\["t"\]: .*mask; use \.filled with a value'),
        ({"attributes": {3: np.zeros(5)}}, TypeError, "attributes: 3 is not a name"),
        ({"attributes": ["t"]}, TypeError, "attributes: must be a mapping"),
        ({"attributes": {"velocity": np.zeros(5)}, "velocity": np.zeros((5, 3))}, TypeError, "velocity: "),
    ],
)
def test_other_invalid_arrays_give_errors_that_name_them(keywords: dict[str, Any], error: type[Exception], what: str) -> None:
    with pytest.raises(error, match=what):
        meniscus.reconstruct(np.zeros((5, 3)), **keywords)


IDENTIFIERS = {
    "int8": (np.int32, -100),
    "uint8": (np.int32, 100),
    "int16": (np.int32, -30_000),
    "uint16": (np.int32, 60_000),
    "int32": (np.int32, -(2**31)),
    "uint32": (np.uint32, 2**31),
    # 64-bit integers are converted by value if they fit into 32 bits.
    "int64": (np.int32, -(2**25) - 1),
    "uint64": (np.uint32, 2**32 - 3000),
}


@pytest.mark.parametrize("dtype", IDENTIFIERS)
def test_integers_come_from_a_nearby_particle(ball: Any, dtype: str) -> None:
    kind, first = IDENTIFIERS[dtype]
    narrow = np.dtype(dtype).itemsize == 1
    ids = (first + np.arange(len(ball)) % (28 if narrow else 2500)).astype(dtype)
    pair = np.stack([ids, ids[::-1]], axis=1)
    mesh = meniscus.reconstruct(ball, spacing=1.0, attributes={"id": ids, "pair": pair, "height": ball[:, 1]})
    found = mesh.attributes["id"]
    assert found.dtype == kind and found.shape == (len(mesh.vertices),) and set(found.tolist()) <= set(ids.tolist())
    assert mesh.attributes["pair"].dtype == kind and np.array_equal(mesh.attributes["pair"][:, 0], found)
    if not narrow:
        # Each value is the identifier of a particle, which gives the particle's position.
        near = ball[found.astype(np.int64) - first]
        assert np.linalg.norm(mesh.vertices - near, axis=1).max() < 2.0
    assert mesh.attributes["height"].dtype == np.float32
    strided = np.zeros(2 * len(ball), dtype)[::2]
    strided[:] = ids
    other = meniscus.reconstruct(ball, spacing=1.0, attributes={"id": strided})
    assert np.array_equal(other.attributes["id"], found)


@pytest.mark.parametrize(("dtype", "greatest"), [(np.uint8, 255), (np.int64, 255), (np.uint16, 65535)])
def test_integer_colours_are_scaled_to_floats(ball: Any, tmp_path: Path, dtype: Any, greatest: int) -> None:
    colours = np.tile(np.round(np.array([0.2, 0.4, 1.0]) * greatest).astype(dtype), (len(ball), 1))
    mesh = meniscus.reconstruct(ball, spacing=1.0, attributes={"Cd": colours})
    mesh.write(tmp_path / "mesh.obj")
    with open(tmp_path / "mesh.obj") as file:
        vertex = next(line for line in file if line.startswith("v "))
    assert np.allclose([float(word) for word in vertex.split()[4:]], [0.2, 0.4, 1.0], atol=1e-6)


def test_integers_beyond_32_bits_are_an_error(ball: Any) -> None:
    ids = np.arange(len(ball)) + 2**40
    with pytest.raises(meniscus.InputError, match='"id" has the value .* 2147483647'):
        meniscus.reconstruct(ball, spacing=1.0, attributes={"id": ids})


def test_radii_give_particles_of_several_sizes_their_own_volume() -> None:
    coarse = 4.0 * np.indices((8, 8, 8)).reshape(3, -1).T
    fine = np.indices((32, 32, 16)).reshape(3, -1).T - [1.5, 1.5, 17.5]
    positions = np.concatenate([coarse, fine])
    radii = np.concatenate([np.full(len(coarse), 2.0), np.full(len(fine), 0.5)])
    volume = float(np.sum((2 * radii) ** 3))
    mesh = meniscus.reconstruct(positions, attributes={"radius": radii})
    assert abs(mesh.volume / volume - 1) < 0.03
    assert mesh.report.spacing == 1.0
    same_sizes = meniscus.reconstruct(positions, attributes={"width": 2 * radii, "radius": radii}, size="radius")
    assert np.array_equal(mesh.vertices, same_sizes.vertices)
    one_size = meniscus.reconstruct(positions, attributes={"radius": radii}, size="none")
    assert one_size.volume < 0.8 * volume
    with pytest.raises(ValueError, match="width"):
        meniscus.reconstruct(positions, attributes={"radius": radii}, size="width")


def test_particles_are_selected_by_their_attributes(ball: Any) -> None:
    both = np.concatenate([ball, ball + 100.0])
    kind = np.repeat(np.array([1, 2**24 + 1], np.int32), len(ball))
    alone = meniscus.reconstruct(ball, spacing=1.0)
    common = {"attributes": {"kind": kind, "height": both[:, 1]}, "spacing": 1.0}
    assert same(meniscus.reconstruct(both, where="kind=1", **common), alone)
    assert same(meniscus.reconstruct(both, where="kind!=16777217 and height<50", **common), alone)
    assert same(meniscus.reconstruct(both, where=["kind<2", "x<50"], **common), alone)
    assert same(meniscus.Frame(both, where="kind=1", **common).surface(), alone)
    # The kind 2^24 + 1 must be compared exactly. Rounded to float32, it would be 2^24, and match.
    with pytest.raises(meniscus.Error):
        meniscus.reconstruct(both, where="kind=16777216", **common)
    with pytest.raises(meniscus.Error, match="heat"):
        meniscus.reconstruct(both, where="heat<3", **common)

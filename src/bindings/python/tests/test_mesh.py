"""Meshes: arrays, measures and files."""

from __future__ import annotations

import errno
import gc
import os
import pickle
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import meniscus
from conftest import lattice


def test_arrays_have_the_documented_shapes_and_types_and_are_writable(ball: Any) -> None:
    mesh = meniscus.reconstruct(ball, velocity=ball, attributes={"heat": ball[:, 0], "pair": ball[:, :2]}, normals=True)
    count = len(mesh.vertices)
    assert mesh.vertices.shape == (count, 3) and mesh.vertices.dtype == np.float64
    assert mesh.triangles.shape == (2 * count - 4, 3) and mesh.triangles.dtype == np.uint32
    assert mesh.triangles_u64.dtype == np.uint64 and np.array_equal(mesh.triangles_u64, mesh.triangles)
    assert mesh.normals is not None and mesh.normals.shape == (count, 3) and mesh.normals.dtype == np.float32
    assert {name: values.shape for name, values in mesh.attributes.items()} == {
        "velocity": (count, 3),
        "heat": (count,),
        "pair": (count, 2),
    }
    for values in mesh.vertices, mesh.triangles, mesh.triangles_u64, mesh.normals, *mesh.attributes.values():
        assert values.flags.writeable and values.flags.c_contiguous
    mesh.vertices[0] = 7.0
    assert mesh.vertices[0, 0] == 7.0, "each access returns the same array"
    assert meniscus.reconstruct(ball).normals is None


def test_vertex_values_are_close_to_those_of_nearby_particles(ball: Any) -> None:
    mesh = meniscus.reconstruct(ball, attributes={"height": ball[:, 1]}, normals=True, spacing=1.0)
    assert np.abs(mesh.attributes["height"] - mesh.vertices[:, 1]).max() < 1.5
    outward = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    assert mesh.normals is not None and (mesh.normals * outward).sum(axis=1).min() > 0.5


def test_arrays_outlive_their_mesh(ball: Any) -> None:
    mesh = meniscus.reconstruct(ball)
    vertices, copy = mesh.vertices, mesh.vertices.copy()
    del mesh
    gc.collect()
    meniscus.reconstruct(ball, cell=0.4)
    assert np.array_equal(vertices, copy)


def test_measures_and_checks_of_a_ball_are_correct(ball: Any) -> None:
    mesh = meniscus.reconstruct(ball, spacing=1.0)
    assert mesh.volume == pytest.approx(len(ball), rel=0.05)
    a, b, c = (mesh.vertices[mesh.triangles[:, corner]] for corner in range(3))
    assert mesh.volume == pytest.approx((a * np.cross(b, c)).sum() / 6, rel=1e-9)
    assert mesh.area == pytest.approx(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2, rel=1e-9)
    assert mesh.bounds is not None and np.array_equal(mesh.bounds, [mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)])
    check = mesh.check()
    assert check and check.closed and check.oriented and check.manifold and check.genus == 0 and check.components == 1
    assert check.volume == mesh.volume and check.triangles == len(mesh.triangles)
    assert not any([check.boundary_edges, check.misoriented_edges, check.pinched_vertices, check.degenerate_triangles])


def test_the_report_describes_the_reconstruction(ball: Any) -> None:
    report = meniscus.reconstruct(ball, threads=2).report
    assert report.spacing == pytest.approx(1.0, rel=0.1) and report.cell_size == pytest.approx(report.spacing / 2)
    assert report.spacing_source == "estimated from the particles" and report.indicator == "cloud" and report.smooth == 1.6
    assert report.particles == len(ball) and report.threads == 2 and report.warnings == []
    assert set(report.seconds) >= {"count", "bin", "mesh"} and sum(report.seconds.values()) > 0
    dirty = np.concatenate([ball, [[np.nan, 0, 0], [1e300, 0, 0], [0, 90, 0]]])
    report = meniscus.reconstruct(dirty, spacing=1.0, skip_invalid=True, domain=(-9, -9, -9, 9, 9, 9)).report
    assert (report.not_finite, report.outside) == (1, 2) and report.particles == len(ball)
    # The last particle is half a spacing outside the periodic box.
    meshes = [
        meniscus.reconstruct(np.concatenate([ball, [[x, 0, 0]]]), spacing=1.0, periodic=(-16, None, None, 16, None, None))
        for x in (-15.5, 16.5)
    ]
    assert [mesh.report.wrapped for mesh in meshes] == [0, 1] and meshes[1].report.particles == len(ball) + 1
    assert np.array_equal(meshes[0].vertices, meshes[1].vertices)


def test_a_warning_in_a_loop_is_shown_once_even_if_numbers_differ(ball: Any) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("default")
        reports = [meniscus.reconstruct(ball, spacing=spacing).report for spacing in (3.0, 3.1, 3.2)]
    texts = [text for report in reports for text in report.warnings]
    assert len(set(texts)) == 3 * len(caught) and caught
    for warning in caught:
        message = warning.message
        assert isinstance(message, meniscus.MeshWarning) and message.figures
        assert str(message) in texts and str(message) != "another"
    with warnings.catch_warnings(record=True) as always:
        warnings.simplefilter("always")
        for spacing in (3.0, 3.1):
            meniscus.reconstruct(ball, spacing=spacing)
    assert len(always) == 2 * len(caught)


def test_library_warnings_become_python_warnings(ball: Any) -> None:
    with pytest.warns(meniscus.MeshWarning, match="too large: the particles are about"):
        mesh = meniscus.reconstruct(ball, spacing=3.0)
    assert any("too large" in warning for warning in mesh.report.warnings)
    with pytest.warns(meniscus.MeshWarning, match="0.5 may be their radius"):
        meniscus.reconstruct(ball, spacing=0.5)
    with pytest.warns(meniscus.MeshWarning, match="have the same position as an earlier particle"):
        meniscus.reconstruct(np.concatenate([ball, ball]), spacing=1.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(meniscus.MeshWarning):
            meniscus.reconstruct(ball, spacing=3.0)
        meniscus.reconstruct(ball, spacing=1.0)


@pytest.mark.parametrize("name", ["velocity", "v"])
def test_an_attribute_named_like_the_velocity_keeps_its_shape(name: str, ball: Any) -> None:
    keywords = {"attributes": {name: ball[:, :2].copy()}, "spacing": 1.0}
    for mesh in meniscus.reconstruct(ball, **keywords), meniscus.Frame(ball, **keywords).surface():
        assert {known: values.shape for known, values in mesh.attributes.items()} == {name: (len(mesh.vertices), 2)}
    velocity = meniscus.reconstruct(ball, attributes={name: ball}, spacing=1.0)
    assert list(velocity.attributes) == ["velocity"]
    live = meniscus.Simulation(spacing=1.0)
    live.frame(ball, attributes={"velocity": ball})
    with pytest.raises(meniscus.InputError, match=f"\"{name}\" was not named"):
        live.frame(ball, attributes=keywords["attributes"])


def test_write_replaces_a_file_only_with_overwrite(tmp_path: Path, ball: Any) -> None:
    mesh = meniscus.reconstruct(ball)
    path = tmp_path / "mesh.ply"
    size = mesh.write(str(path))
    assert size == path.stat().st_size
    with pytest.raises(meniscus.FileError, match=r"mesh\.ply: the file already exists") as raised:
        mesh.write(path)
    assert isinstance(raised.value, FileExistsError) and "overwrite=True" in str(raised.value)
    assert mesh.write(path, overwrite=True) == size
    assert mesh.write(tmp_path / "made" / "mesh.ply") == size
    with pytest.raises(OSError, match="cannot create the folder"):
        mesh.write(path / "none" / "mesh.ply")
    with pytest.raises(ValueError, match="unknown extension"):
        mesh.write(tmp_path / "mesh.fbx")
    with pytest.raises(meniscus.InputError, match="cannot store `normals`"):
        meniscus.reconstruct(ball, normals=True).write(tmp_path / "mesh.stl")
    assert sorted(os.listdir(tmp_path)) == ["made", "mesh.ply"]


def test_trimesh_and_meshio_accept_the_mesh_unchanged(ball: Any) -> None:
    trimesh, meshio = pytest.importorskip("trimesh"), pytest.importorskip("meshio")
    mesh = meniscus.reconstruct(ball, velocity=ball, normals=True)
    theirs = trimesh.Trimesh(**mesh.for_trimesh())
    assert theirs.is_watertight and theirs.is_winding_consistent and theirs.volume == pytest.approx(mesh.volume)
    assert len(theirs.vertices) == len(mesh.vertices)
    cells = meshio.Mesh(**mesh.for_meshio())
    assert len(cells.cells[0].data) == len(mesh.triangles) and set(cells.point_data) == {"velocity", "normals"}


def test_errors_about_numbers_name_the_keyword_or_the_value(ball: Any) -> None:
    for keywords, what in [
        ({"spacing": -1.0}, "^`spacing` .* -1"),
        ({"spacing": float("nan")}, "^`spacing` .* NaN"),
        ({"cell": 0.0}, "^`cell` must be"),
        ({"smooth": 99.0}, "99"),
        ({"radius": -0.5}, "^`radius` must be"),
        ({"threads": 0}, "threads"),
        ({"threads": -1}, "^threads: -1 is out of range"),
        ({"memory": "lots"}, "^memory: "),
        ({"memory": 1}, "the memory limit must be at least"),
        ({"spacing": 1.0, "radius": 0.5}, "^radius: cannot be used with spacing|^spacing: cannot be used with radius"),
        ({"cell": 0.5, "cell_size": 0.5}, "cannot be used with cell(_size)?, which sets the same length"),
        ({"domain": (0, 0, 0, 1, 1)}, "^domain: must be six numbers"),
        ({"periodic": (0, None, 0, 1, 1, 1)}, "^periodic: only one end of y is open.* None"),
        ({"domain": (5, 5, 5, 1, 1, 1)}, "invalid domain"),
        ({"origin": (0, 0)}, "^origin: must be three numbers"),
        ({"indicator": "fog"}, "^indicator: \"fog\" is not one of cloud, counting, symmetry"),
        ({"sigma": 1.0}, "^`sigma` needs the indicator counting or symmetry"),
        ({"periodic_mesh": "cut"}, "^`periodic_mesh` has no effect without `periodic`"),
        ({"device": "0", "backend": "cpu"}, "^device: "),
        ({"simplify": -1.0}, "-1"),
        ({"smallest_drop": 2**40}, "^smallest_drop: "),
    ]:
        with pytest.raises(meniscus.InputError, match=what) as raised:
            meniscus.reconstruct(ball, **keywords)
        assert isinstance(raised.value, ValueError) and isinstance(raised.value, meniscus.Error)


def test_errors_about_particles_say_which_and_why(ball: Any) -> None:
    bad = ball.copy()
    bad[7, 1] = np.inf
    with pytest.raises(ValueError, match="particle 7 has a coordinate that is not finite"):
        meniscus.reconstruct(bad, spacing=1.0)
    with pytest.raises(ValueError, match="no particles to reconstruct"):
        meniscus.reconstruct(np.zeros((0, 3)), spacing=1.0)
    with pytest.raises(ValueError, match="cannot estimate the spacing of 1 particle:"):
        meniscus.reconstruct(np.zeros((1, 3), np.float32))
    with pytest.raises(ValueError, match="removed its only component"):
        meniscus.reconstruct(ball, smallest_drop=10**6)
    with pytest.raises(ValueError, match=f"none of {len(ball)} particles satisfies x>99"):
        meniscus.reconstruct(ball, where="x>99")
    with pytest.raises(ValueError, match="no particles to reconstruct: the input has none"):
        meniscus.reconstruct(np.zeros((0, 3)), where="x>99", spacing=1.0)
    with pytest.warns(meniscus.MeshWarning, match=f"none of {len(ball)} particles satisfies x>99"):
        assert len(meniscus.Simulation(where="x>99", spacing=1.0).frame(ball).triangles) == 0


def test_the_reason_for_an_empty_mesh_is_reported(tmp_path: Path, ball: Any) -> None:
    cover, keywords = tmp_path / "cover.ply", {"spacing": 1.0}
    meniscus.reconstruct(lattice(12.0), spacing=1.0).write(cover)
    with pytest.raises(meniscus.InputError, match="solids cover the fluid"):
        meniscus.reconstruct(ball, solid=[str(cover)], **keywords)
    with pytest.warns(meniscus.MeshWarning, match="solids cover the fluid"):
        assert len(meniscus.Simulation(solid=[cover], **keywords).frame(ball).triangles) == 0
    with pytest.raises(meniscus.InputError, match="fluid; use smaller cells$"):
        meniscus.reconstruct(lattice(2.0), spacing=1.0, cell_size=30.0)


def test_missing_and_damaged_files_are_file_errors(tmp_path: Path) -> None:
    missing = tmp_path / "none.bgeo"
    with pytest.raises(FileNotFoundError, match=r"none\.bgeo: No such file") as raised:
        meniscus.read_particles(missing)
    for error in raised.value, pickle.loads(pickle.dumps(raised.value)):
        assert isinstance(error, meniscus.FileError) and isinstance(error, FileNotFoundError)
        assert (error.errno, error.filename, error.strerror) == (errno.ENOENT, str(missing), os.strerror(errno.ENOENT))
        assert str(error).startswith(f"{missing}: No such file")
    (tmp_path / "bad.npy").write_bytes(b"\x93NUMPY bad")
    with pytest.raises(OSError, match=r"bad\.npy: ") as damaged:
        meniscus.read_particles(tmp_path / "bad.npy")
    assert type(damaged.value) is meniscus.FileError
    assert (damaged.value.errno, damaged.value.filename) == (None, str(tmp_path / "bad.npy"))
    with pytest.raises(meniscus.InputError, match="unknown extension"):
        meniscus.read_particles("particles.abc")
    with pytest.raises(meniscus.FileError, match="No such file"):
        meniscus.Frame.load(tmp_path / "none.mnf")


def test_a_missing_device_is_a_device_error(ball: Any) -> None:
    for device in "no device is called so", 4_000_000_000:
        with pytest.raises(meniscus.DeviceError, match=str(device)):
            meniscus.reconstruct(ball, backend="vulkan", device=device)


def test_a_device_gives_the_same_bytes_as_the_cpu(ball: Any) -> None:
    try:
        by_device = meniscus.reconstruct(ball, backend="vulkan", normals=True)
    except meniscus.DeviceError as error:
        if os.environ.get("MENISCUS_REQUIRE_VULKAN"):
            raise
        pytest.skip(str(error))
    mesh = meniscus.reconstruct(ball, backend="cpu", normals=True)
    assert "cpu" not in by_device.report.backend.lower() and by_device.report.backend != mesh.report.backend
    for name in ["vertices", "triangles", "normals"]:
        assert getattr(mesh, name).tobytes() == getattr(by_device, name).tobytes()


def test_kernel_methods_reject_a_required_device(ball: Any) -> None:
    with pytest.raises(meniscus.InputError, match="kernel methods"):
        meniscus.reconstruct(ball, backend="vulkan", method="zhu-bridson")
    with pytest.raises(meniscus.InputError, match="kernel methods"):
        meniscus.reconstruct(ball, device="0", method="zhu-bridson")
    assert len(meniscus.reconstruct(ball, backend="auto", method="zhu-bridson").triangles) > 0

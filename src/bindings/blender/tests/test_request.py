"""Surfaces are recomputed only if one of their inputs or settings has changed."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import meniscus
import numpy as np
import pytest
from surfaces.arrays import Arrays
from surfaces.request import Filters, FromFile, FromPoints, Maker, Request, Sampling
from surfaces.solids import SolidMesh, Solids


def request_of(path: Path, **changed: object) -> Request:
    return Request(FromFile(str(path), Sampling(spacing=1.0, cell=1.0)), replace(Filters(smooth=1.6), **changed))


def test_the_key_changes_with_settings_and_with_the_file(sequence: Path) -> None:
    file = sequence / "ball_002.npy"
    request = request_of(file)
    assert request.key == request_of(file).key and request.name == request_of(file).name
    others = [
        request_of(file, smooth=2.0),
        request_of(file, smallest_drop=5),
        request_of(file, simplify=0.1),
        request_of(sequence / "ball_003.npy"),
        replace(request, source=replace(request.source, sampling=Sampling(spacing=1.0, cell=0.5))),
        replace(request, source=replace(request.source, sampling=Sampling(spacing=1.1, cell=1.0))),
        replace(request, source=replace(request.source, sampling=Sampling(1.0, 1.0, attributes=("id",)))),
        replace(request, source=replace(request.source, sampling=Sampling(1.0, 1.0, domain=(-9.0, -9.0, -9.0, 9.0, 9.0, 9.0)))),
    ]
    assert len({each.name for each in [request, *others]}) == 1 + len(others)
    name, written = request.name, file.stat()
    os.utime(file, ns=(written.st_atime_ns, written.st_mtime_ns + 10**9))
    assert request_of(file).name != name


def test_requests_of_equal_points_have_the_same_key() -> None:
    points = np.random.default_rng(1).random((50, 3), np.float32)
    request = FromPoints(points, None, Sampling(cell=1.0))
    assert FromPoints(points.copy(), None, Sampling(cell=1.0)).key == request.key
    moved = points.copy()
    moved[30, 1] += 1e-3
    assert FromPoints(moved, None, Sampling(cell=1.0)).key != request.key
    assert FromPoints(points, points, Sampling(cell=1.0)).key != request.key
    assert FromPoints(points, None, Sampling(cell=0.5)).key != request.key


def test_changed_filters_do_not_read_the_particles_again(sequence: Path) -> None:
    file = sequence / "ball_006.npy"
    maker = Maker()
    maker.make(request_of(file))
    stamp = file.stat()
    # Overwrite the file, so that the test fails if the maker reads it again.
    file.write_bytes(b"\0" * stamp.st_size)
    os.utime(file, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
    calm = maker.make(request_of(file, smooth=2.5))
    assert len(calm.triangles) > 0
    maker.forget()
    with pytest.raises(meniscus.Error, match="ball_006.npy"):
        maker.make(request_of(file, smooth=2.5))


def test_arrays_equal_the_librarys_mesh(sequence: Path) -> None:
    points = np.load(sequence / "ball_002.npy")
    made = Maker().make(Request(FromPoints(points.astype(np.float32), points.astype(np.float32), Sampling(1.0, 1.0)), Filters()))
    mesh = meniscus.reconstruct(points.astype(np.float32), velocity=points.astype(np.float32), spacing=1.0, cell=1.0)
    assert made.vertices.dtype == np.float32 and made.triangles.dtype == np.int32
    assert np.array_equal(made.vertices, mesh.vertices.astype(np.float32)) and np.array_equal(made.triangles, mesh.triangles)
    assert np.array_equal(made.attributes["velocity"], mesh.attributes["velocity"])
    size = len(made.vertices) * 24 + len(made.triangles) * 12
    assert made.nbytes == size and made.spacing == 1.0


def test_packed_frames_ignore_settings_of_the_sampling(sequence: Path) -> None:
    packed = sequence / "ball.mnf"
    meniscus.Frame(np.load(sequence / "ball_002.npy"), spacing=1.0).save(packed)
    made = Maker().make(request_of(packed))
    assert len(made.triangles) > 0 and made.spacing == 1.0
    other = FromFile(str(packed), Sampling(spacing=7.0, cell=0.3))
    assert other.key == request_of(packed).source.key
    # Conversions read `used_sampling`, which also ignores the sampling of a packed frame.
    assert other.used_sampling == Sampling() and request_of(sequence / "ball_002.npy").source.used_sampling.spacing == 1.0


def test_a_surface_stores_the_up_axis_of_its_particles(sequence: Path) -> None:
    assert Maker().make(request_of(sequence / "ball_002.npy")).particles_up == "y"


def cube(centre: float, half: float) -> SolidMesh:
    """A cube whose triangles face outwards."""
    corners = np.array([[x, y, z] for z in (-1.0, 1.0) for y in (-1.0, 1.0) for x in (-1.0, 1.0)]) * half + centre
    quads = np.array([[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]], np.int32)
    return SolidMesh("Cube.001", corners, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]))


def test_solids_bound_the_fluid_and_change_the_key(sequence: Path, tmp_path: Path) -> None:
    request = request_of(sequence / "ball_006.npy")
    given = [(cube(5.0, 3.0), 0.0), (cube(5.0, 3.0), 0.5), (cube(4.0, 3.0), 0.0)]
    touching = [replace(request, solids=Solids((mesh,), offset)) for mesh, offset in given]
    assert len({each.name for each in [request, *touching]}) == 4
    assert replace(request, solids=Solids((), 0.5)).name == request.name
    file = tmp_path / "cube.ply"
    cube(5.0, 3.0).write(file)
    written = file.stat().st_mtime_ns
    cube(5.0, 3.0).write(file)
    assert file.stat().st_mtime_ns == written, "the same mesh is not written again"
    made = Maker().make(touching[0])
    expected = meniscus.Frame.load(request.source.path, spacing=1.0, cell=1.0).surface(solid=[str(file)], solid_offset=0.0)
    assert np.array_equal(made.vertices, expected.vertices.astype(np.float32)) and made.warnings == ()
    assert not ((made.vertices > 2.5) & (made.vertices < 7.5)).all(axis=1).any()


def test_an_open_solid_gives_the_librarys_error_with_its_name(sequence: Path) -> None:
    whole = cube(5.0, 3.0)
    open_one = SolidMesh("Ship", whole.vertices, whole.triangles[:-1])
    with pytest.raises(meniscus.Error, match=r"Ship-0-solid\.ply.*3 edges"):
        Maker().make(replace(request_of(sequence / "ball_006.npy"), solids=Solids((open_one,))))


def test_no_particles_give_the_librarys_error(tmp_path: Path) -> None:
    np.save(tmp_path / "none.npy", np.zeros((0, 3)))
    with pytest.raises(meniscus.Error, match="no particles"):
        Maker().make(request_of(tmp_path / "none.npy"))
    assert Arrays.empty().nbytes == 0

"""Frames that are sampled once for several surfaces, or packed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import meniscus


def same(mesh: meniscus.Mesh, other: meniscus.Mesh) -> bool:
    return np.array_equal(mesh.vertices, other.vertices) and np.array_equal(mesh.triangles, other.triangles)


def test_surface_equals_reconstruct_with_the_same_keywords(ball: Any) -> None:
    frame = meniscus.Frame(ball, spacing=1.0, velocity=ball, normals=True)
    expected = meniscus.reconstruct(ball, spacing=1.0, velocity=ball, normals=True)
    assert same(frame.surface(), expected) and np.array_equal(frame.surface().normals, expected.normals)  # type: ignore[arg-type]
    assert np.array_equal(frame.surface().attributes["velocity"], expected.attributes["velocity"])
    # A keyword overrides the frame's value of this keyword. All other keywords keep the frame's
    # values.
    calm = frame.surface(smooth=2.5)
    assert same(calm, meniscus.reconstruct(ball, spacing=1.0, smooth=2.5)) and calm.normals is not None
    assert frame.surface(normals=False).normals is None
    with pytest.raises(TypeError, match="unexpected keyword argument 'spacing'"):
        frame.surface(spacing=2.0)  # type: ignore[call-arg]


def test_a_frame_does_not_need_its_particles(ball: Any) -> None:
    positions = ball.copy()
    frame = meniscus.Frame(positions, spacing=1.0)
    positions[:] = np.nan
    assert same(frame.surface(), meniscus.reconstruct(ball, spacing=1.0))


def test_packed_frames_equal_the_programs_and_can_be_loaded(tmp_path: Path, program: Any, ball: Any) -> None:
    np.save(tmp_path / "in.npy", ball)
    program("pack", tmp_path / "in.npy", "-o", tmp_path / "theirs.mnf", "-q", "--spacing", 1)
    frame = meniscus.Frame(ball, spacing=1.0)
    size = frame.save(tmp_path / "ours.mnf")
    assert size == (tmp_path / "ours.mnf").stat().st_size
    assert (tmp_path / "ours.mnf").read_bytes() == (tmp_path / "theirs.mnf").read_bytes()
    opened = meniscus.Frame.load(tmp_path / "ours.mnf", smooth=2.0)
    assert same(opened.surface(), meniscus.reconstruct(ball, spacing=1.0, smooth=2.0))
    assert same(opened.surface(smooth=None), frame.surface())
    with pytest.raises(meniscus.FileError, match="already exists"):
        frame.save(tmp_path / "ours.mnf")
    assert frame.save(tmp_path / "ours.mnf", overwrite=True) == size
    with pytest.raises(meniscus.InputError, match="`method` is not supported when packing"):
        meniscus.Frame(ball, method="mueller").save(tmp_path / "kernels.mnf")


def test_loading_a_file_equals_reconstructing_its_arrays(dambreak: Path) -> None:
    file = dambreak / "ParticleData_Fluid_20.bgeo"
    read = meniscus.read_particles(file)
    frame = meniscus.Frame.load(file, cell=1.0, attributes=["velocity", "density"])
    expected = meniscus.reconstruct(
        read.positions, spacing=read.spacing, cell=1.0, velocity=read.velocity, attributes={"density": read.attributes["density"]}
    )
    assert same(frame.surface(), expected) and set(frame.surface().attributes) == {"velocity", "density"}
    assert np.array_equal(frame.surface().attributes["density"], expected.attributes["density"])
    assert set(meniscus.Frame.load(file).surface(smooth=2.0).attributes) == {"velocity"}
    assert frame.particles_up == "y" and meniscus.Frame.load(file, particles_up="z").particles_up == "z"
    with pytest.raises(meniscus.InputError, match='no attribute "heat"'):
        meniscus.Frame.load(file, attributes=["heat"])


def test_a_packed_frame_rejects_keywords_of_the_sampling(tmp_path: Path, ball: Any) -> None:
    meniscus.Frame(ball, spacing=1.0).save(tmp_path / "ball.mnf")
    with pytest.raises(meniscus.InputError, match="ball.mnf"):
        meniscus.Frame.load(tmp_path / "ball.mnf", spacing=2.0)


def test_particles_of_several_files_make_one_surface(tmp_path: Path, program: Any, ball: Any) -> None:
    parts = [tmp_path / f"{name}.npy" for name in "ab"]
    for part, points in zip(parts, (ball[:1000], ball[1000:])):
        np.save(part, points)
    mesh = meniscus.Frame.load(parts, spacing=1.0).surface()
    assert same(mesh, meniscus.Frame.load([str(part) for part in parts], spacing=1.0).surface())
    assert mesh.report.particles == len(ball) and mesh.check().components == 1
    program("reconstruct", *parts, "-o", tmp_path / "theirs.ply", "-q", "--together", "--spacing", 1)
    mesh.write(tmp_path / "ours.ply")
    assert (tmp_path / "ours.ply").read_bytes() == (tmp_path / "theirs.ply").read_bytes()
    with pytest.raises(TypeError, match="^path: must be a path or a list of paths"):
        meniscus.Frame.load(7)  # type: ignore[arg-type]
    with pytest.raises(meniscus.InputError, match="no input file"):
        meniscus.Frame.load([])


def test_the_volume_contains_distances_from_the_surface(ball: Any) -> None:
    frame = meniscus.Frame(ball, spacing=1.0)
    mesh, volume = frame.surface(), frame.volume()
    bricks = len(volume.origins)
    assert volume.origins.shape == (bricks, 3) and volume.values.shape == (bricks, 8, 8, 8)
    assert volume.voxel_size == mesh.report.cell_size == 0.5
    assert (volume.origins % 8 == 0).all() and np.array_equal(volume.origins, np.unique(volume.origins, axis=0))
    band = 3 * volume.voxel_size
    assert np.abs(volume.values).max() == band
    # Each vertex is on an edge between two voxels, where the distance changes its sign.
    voxels = (mesh.vertices - volume.transform[:3, 3]) / volume.voxel_size
    assert (np.abs(voxels - np.rint(voxels)) < 1e-4).sum(axis=1).min() >= 2
    brick = {tuple(origin): i for i, origin in enumerate(volume.origins)}
    for ends in zip(np.floor(voxels + 1e-4).astype(int), np.ceil(voxels - 1e-4).astype(int), strict=True):
        low, high = (volume.values[brick[tuple(at // 8 * 8)]][tuple(at % 8)] for at in ends)
        assert low * high <= 0 and max(abs(low), abs(high)) <= volume.voxel_size + 1e-5
    # The magnitude of each voxel's value may exceed the distance to the nearest vertex by at most a
    # tenth of a voxel. The square of this distance may exceed the square of the value by less than
    # the square of the voxel size.
    steps = np.stack(np.meshgrid(*[np.arange(8)] * 3, indexing="ij"), axis=-1)
    places = (volume.origins[:, None, None, None] + steps) * volume.voxel_size + volume.transform[:3, 3]
    inner = np.abs(volume.values) < band
    nearest = np.array([np.linalg.norm(mesh.vertices - place, axis=1).min() for place in places[inner]])
    distances = np.abs(volume.values[inner])
    assert (distances <= nearest + 0.1 * volume.voxel_size).all() and (nearest**2 - distances**2 < volume.voxel_size**2).all()
    inside = np.linalg.norm(places, axis=-1) < 7.0
    assert inside.any() and (volume.values[inside] < 0).all()


def test_the_volume_depends_on_keywords(ball: Any) -> None:
    frame = meniscus.Frame(ball, spacing=1.0)
    calm = frame.volume(smooth=2.5)
    assert not np.array_equal(calm.values, frame.volume().values)
    assert np.array_equal(calm.values, meniscus.Frame(ball, spacing=1.0, smooth=2.5, threads=1).volume().values)
    with pytest.raises(TypeError, match="unexpected keyword argument 'spacing'"):
        frame.volume(spacing=2.0)  # type: ignore[call-arg]

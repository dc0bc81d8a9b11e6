"""The interface of pysplashsurf."""

from __future__ import annotations

import importlib.util
import inspect
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import meniscus
from conftest import lattice
from meniscus.compat import pysplashsurf as ours

theirs = pytest.importorskip("pysplashsurf")

FUNCTIONS = ["reconstruct_surface", "reconstruction_pipeline"]
README = Path(__file__).resolve().parents[1] / "README.md"
RADIUS = 0.05


@pytest.fixture
def positions() -> Any:
    return (lattice(8.0) * 2 * RADIUS).astype(np.float32)


@pytest.fixture(autouse=True)
def _reset_ignored(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ours, "_ignored", set())


@pytest.mark.parametrize("name", FUNCTIONS)
def test_signatures_equal_those_of_pysplashsurf(name: str) -> None:
    def shown(function: Any) -> list[tuple[str, Any, Any]]:
        return [(p.name, p.kind, p.default) for p in inspect.signature(function).parameters.values()]

    assert shown(getattr(ours, name)) == shown(getattr(theirs, name))


def test_the_docs_have_a_row_for_every_keyword() -> None:
    rows = set(re.findall(r"`(\w+)`", "".join(re.findall(r"^\|([^|]*)\|", README.read_text(), re.MULTILINE))))
    wanted = {name for function in FUNCTIONS for name in inspect.signature(getattr(theirs, function)).parameters}
    assert wanted <= rows, wanted - rows


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_call_of_genesis_needs_only_a_different_import(positions: Any, dtype: Any) -> None:
    def call(reconstruction_pipeline: Any) -> tuple[Any, Any]:
        mesh_with_data, reconstruction = reconstruction_pipeline(
            positions.astype(dtype),
            particle_radius=RADIUS,
            smoothing_length=2.0,
            cube_size=0.8,
            iso_surface_threshold=0.6,
            mesh_smoothing_weights=True,
            mesh_smoothing_iters=25,
            normals_smoothing_iters=10,
            mesh_cleanup=True,
            compute_normals=True,
            multi_threading=True,
        )
        return mesh_with_data, reconstruction

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (data, reconstruction), (other, _) = call(ours.reconstruction_pipeline), call(theirs.reconstruction_pipeline)
    pairs = [
        (data.point_attributes["normals"], other.point_attributes["normals"]),
        (data.mesh.vertices, other.mesh.vertices),
        (data.mesh.triangles, other.mesh.triangles),
    ]
    for mine, wanted in pairs:
        assert mine.dtype == wanted.dtype and mine.shape[1] == wanted.shape[1] and mine.flags.writeable
    assert len(data.point_attributes["normals"]) == data.nvertices and data.ncells == len(data.mesh.triangles)
    # The upper bounds of the two libraries' meshes must differ by less than one radius.
    assert np.abs(data.mesh.vertices.max(axis=0) - other.mesh.vertices.max(axis=0)).max() < RADIUS
    assert reconstruction.grid.cell_size == pytest.approx(0.8 * RADIUS)
    exact = meniscus.reconstruct(positions.astype(dtype), spacing=2 * RADIUS, cell_size=0.8 * RADIUS, normals=True)
    assert np.array_equal(data.mesh.triangles, exact.triangles)
    assert np.array_equal(data.mesh.vertices, exact.vertices.astype(dtype))


def test_lengths_are_relative_to_the_radius_in_both_functions(positions: Any) -> None:
    for function in theirs.reconstruct_surface, ours.reconstruct_surface:
        made = function(positions, particle_radius=RADIUS, smoothing_length=2.0, cube_size=0.8)
        assert made.grid.cell_size == pytest.approx(0.8 * RADIUS)


def test_attributes_and_raw_normals_are_point_attributes(positions: Any) -> None:
    attributes = {"v": positions, "heat": positions[:, 1].copy(), "id": np.arange(len(positions), dtype=np.uint64)}
    keywords = {"particle_radius": RADIUS, "smoothing_length": 2.0, "cube_size": 1.0, "compute_normals": True}
    data, _ = ours.reconstruction_pipeline(
        positions, attributes_to_interpolate=attributes, output_raw_normals=True, **keywords
    )
    assert {name: values.shape[1:] for name, values in data.point_attributes.items()} == {
        "normals": (3,),
        "raw_normals": (3,),
        "v": (3,),
        "heat": (),
        "id": (),
    }
    assert np.abs(data.point_attributes["heat"] - data.mesh.vertices[:, 1]).max() < 4 * RADIUS


def test_boxes_remove_the_same_particles_and_triangles_as_pysplashsurf(positions: Any) -> None:
    keywords: dict[str, Any] = {"particle_radius": RADIUS, "smoothing_length": 2.0, "cube_size": 1.0}
    inside = {}
    for by in ours, theirs:
        made = by.reconstruct_surface(positions, aabb_min=[0, -9, -9], aabb_max=[9, 9, 9], **keywords)
        assert -2 * RADIUS < made.mesh.vertices[:, 0].min() < 0
        inside[by] = made.particle_inside_aabb
    assert np.array_equal(inside[ours], inside[theirs])
    for clamp in True, False:
        data, whole = ours.reconstruction_pipeline(
            positions, mesh_aabb_min=[0.01, -9, -9], mesh_aabb_max=[9, 9, 9], mesh_aabb_clamp_vertices=clamp, **keywords
        )
        least = data.mesh.vertices[:, 0].min()
        assert least == np.float32(0.01) if clamp else -2 * RADIUS < least < 0.01
        kept = (whole.mesh.vertices[:, 0] >= 0.01)[whole.mesh.triangles].any(axis=1).sum()
        assert data.ncells == kept and data.mesh.triangles.max() == data.nvertices - 1


def test_ignored_keywords_give_one_warning(positions: Any) -> None:
    keywords: dict[str, Any] = {"particle_radius": RADIUS, "smoothing_length": 2.0, "cube_size": 1.0}
    with pytest.warns(meniscus.MeshWarning, match="iso_surface_threshold, generate_quads") as caught:
        for _ in range(3):
            ours.reconstruction_pipeline(positions, iso_surface_threshold=0.5, generate_quads=True, **keywords)
    assert len(caught) == 1 and caught[0].filename == __file__


def test_no_particles_give_an_empty_mesh_as_in_pysplashsurf(positions: Any) -> None:
    for by in ours, theirs:
        made = by.reconstruct_surface(positions[:0], particle_radius=RADIUS, smoothing_length=2.0, cube_size=1.0)
        assert made.mesh.vertices.shape == (0, 3) and made.mesh.triangles.shape == (0, 3)


def test_other_types_are_errors_as_in_pysplashsurf(positions: Any) -> None:
    for by in ours, theirs:
        with pytest.raises(TypeError, match="only f32 and f64 are supported"):
            by.reconstruct_surface(positions.astype(int), particle_radius=RADIUS, smoothing_length=2.0, cube_size=1.0)


@pytest.mark.skipif(importlib.util.find_spec("meshio") is None, reason="needs meshio")
def test_files_are_written_by_meshio(positions: Any, tmp_path: Path) -> None:
    import meshio

    data, _ = ours.reconstruction_pipeline(
        positions, particle_radius=RADIUS, smoothing_length=2.0, cube_size=1.0, compute_normals=True
    )
    data.write_to_file(tmp_path / "mesh.vtk")
    read = meshio.read(tmp_path / "mesh.vtk")
    assert len(read.points) == data.nvertices and "normals" in read.point_data

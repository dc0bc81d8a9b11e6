"""Files that this module writes have the same bytes as the program's files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import meniscus

FORMATS = ["ply", "obj", "vtk", "vtp", "vtkhdf", "stl", "usdc", "glb", "abc"]


def written(folder: Path, name: str, mesh: meniscus.Mesh) -> bytes:
    path = folder / name
    assert mesh.write(path) == path.stat().st_size
    return path.read_bytes()


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("extension", FORMATS)
def test_all_formats_have_the_programs_bytes(tmp_path: Path, program: Any, ball: Any, extension: str, dtype: str) -> None:
    positions = ball.astype(dtype)
    # Move float64 particles so far from the origin that float32 could not tell vertices apart.
    positions += 1e5 if dtype == "float64" else 0.0
    velocity = (positions * 0.5).astype(np.float32)
    np.savez(tmp_path / "in.npz", positions=positions, velocity=velocity)
    program("reconstruct", tmp_path / "in.npz", "-o", tmp_path / f"theirs.{extension}", "-q", "--spacing", 1)
    mesh = meniscus.reconstruct(positions, velocity=velocity, spacing=1.0)
    ours = written(tmp_path, f"ours.{extension}", mesh)
    theirs = (tmp_path / f"theirs.{extension}").read_bytes()
    assert ours == theirs


def test_pieces_of_pvtp_have_the_programs_bytes(tmp_path: Path, program: Any, ball: Any) -> None:
    np.save(tmp_path / "in.npy", ball)
    for by in "ours", "theirs":
        (tmp_path / by).mkdir()
    program("reconstruct", tmp_path / "in.npy", "-o", tmp_path / "theirs" / "mesh.pvtp", "-q")
    meniscus.reconstruct(ball).write(tmp_path / "ours" / "mesh.pvtp")
    files = {by: {path.relative_to(tmp_path / by): path.read_bytes() for path in (tmp_path / by).rglob("*") if path.is_file()} for by in ("ours", "theirs")}
    assert len(files["ours"]) > 1
    assert files["ours"] == files["theirs"]


OPTIONS: list[dict[str, Any]] = [
    {"radius": 0.5, "cell": 0.4, "smooth": 2.0},
    {"cell_size": 0.6, "normals": True, "origin": (0.1, 0.2, -0.3)},
    {"indicator": "counting", "mu0": 0.3, "sigma": 1.5, "iso": 0.4, "detail": True},
    {"method": "mueller", "spacing": 1.0},
    {"method": "yu-turk", "spacing": 1.0, "iso": 0.4},
    {"domain": (-4, None, -9, 9, None, 9), "spacing": 1.0, "simplify": 0.5},
    {"periodic": (None, None, -12, None, None, 12), "spacing": 1.0, "periodic_mesh": "overlap"},
    {"memory": "24MiB", "threads": 1, "smallest_drop": 5, "smallest_component": 3.0, "spacing": 1.0},
    {"up": "z", "particles_up": "y", "spacing": 1.0, "backend": "cpu"},
    {"skip_invalid": True, "iso": "auto"},
]


def option(name: str, value: Any) -> list[str]:
    if value is True:
        return [f"--{name.replace('_', '-')}"]
    if isinstance(value, tuple):
        value = ",".join("-" if number is None else str(number) for number in value)
    return [f"--{name.replace('_', '-')}={value}"]


@pytest.mark.parametrize("options", OPTIONS, ids=lambda options: ",".join(options))
def test_keywords_have_the_same_effect_as_the_programs_options(tmp_path: Path, program: Any, ball: Any, options: dict[str, Any]) -> None:
    np.save(tmp_path / "in.npy", ball)
    given = [word for name, value in options.items() for word in option(name, value)]
    program("reconstruct", tmp_path / "in.npy", "-o", tmp_path / "theirs.ply", "-q", *given)
    theirs = (tmp_path / "theirs.ply").read_bytes()
    assert written(tmp_path, "ours.ply", meniscus.reconstruct(ball, **options)) == theirs
    # The options must change the mesh, unless they select resources or do not affect this ball.
    plain = written(tmp_path, "plain.ply", meniscus.reconstruct(ball, spacing=1.0))
    may_equal_plain = set(options) <= {"backend", "spacing", "skip_invalid", "iso"} or options.get("memory")
    assert (plain != theirs) or may_equal_plain


def test_compressed_glb_has_the_programs_bytes(tmp_path: Path, program: Any, ball: Any) -> None:
    np.save(tmp_path / "in.npy", ball)
    program("reconstruct", tmp_path / "in.npy", "-o", tmp_path / "theirs.glb", "-q", "--compress")
    ours = written(tmp_path, "ours.glb", meniscus.reconstruct(ball, compress=True))
    assert ours == (tmp_path / "theirs.glb").read_bytes()


def test_attributes_have_the_programs_bytes(tmp_path: Path, program: Any, ball: Any) -> None:
    values = {"heat": np.abs(ball[:, 0]).astype(np.float32), "velocity": ball.astype(np.float32)}
    np.savez(tmp_path / "in.npz", positions=ball, **values)
    program("reconstruct", tmp_path / "in.npz", "-o", tmp_path / "theirs.ply", "-q", "--attributes", "velocity,heat")
    mesh = meniscus.reconstruct(ball, velocity=values["velocity"], attributes={"heat": values["heat"]})
    assert written(tmp_path, "ours.ply", mesh) == (tmp_path / "theirs.ply").read_bytes()


def test_previews_have_the_programs_bytes(tmp_path: Path, program: Any, ball: Any, dambreak: Path) -> None:
    np.save(tmp_path / "in.npy", ball)
    program("reconstruct", tmp_path / "in.npy", "-o", tmp_path / "theirs.ply", "-q", "--preview")
    meniscus.reconstruct(ball).write(tmp_path / "ours.ply", preview=True)
    assert (tmp_path / "ours.png").read_bytes() == (tmp_path / "theirs.png").read_bytes()
    # If the picture's file already exists, the call fails and writes no mesh either.
    (tmp_path / "kept.png").write_bytes(b"mine")
    with pytest.raises(meniscus.FileError, match=r"kept\.png: the file already exists"):
        meniscus.reconstruct(ball).write(tmp_path / "kept.ply", preview=True)
    assert (tmp_path / "kept.png").read_bytes() == b"mine" and not (tmp_path / "kept.ply").exists()

    frames = dambreak / "ParticleData_Fluid_{}.bgeo"
    program("reconstruct", frames, "-o", tmp_path / "theirs" / "water_{}.ply", "-q", "--preview", "--up", "z")
    simulation = meniscus.Simulation(frames, tmp_path / "ours" / "water_{}.ply", up="z", preview=True)
    assert simulation.run()[0].complete
    sheet = (tmp_path / "ours" / "water.png").read_bytes()
    assert sheet == (tmp_path / "theirs" / "water.png").read_bytes() and sheet[:4] == b"\x89PNG"
    for off in False, None:
        meniscus.Simulation(frames, tmp_path / f"plain_{off}" / "water_{}.ply", preview=off).run()
        assert not (tmp_path / f"plain_{off}" / "water.png").exists()


@pytest.mark.parametrize("by", ["read", "frame"])
def test_files_are_read_as_by_the_program(tmp_path: Path, program: Any, dambreak: Path, by: str) -> None:
    path = dambreak / "ParticleData_Fluid_20.bgeo"
    program("reconstruct", path, "-o", tmp_path / "theirs.ply", "-q", "--normals")
    if by == "read":
        particles = meniscus.read_particles(path)
        assert particles.spacing == 0.05 and particles.up == "y" and len(particles) == len(particles.positions) > 8000
        assert particles.velocity is not None and set(particles.attributes) >= {"id", "density"}
        mesh = meniscus.reconstruct(
            particles.positions, velocity=particles.velocity, spacing=particles.spacing, normals=True
        )
    else:
        mesh = meniscus.Frame.load(path, normals=True).surface()
    assert written(tmp_path, "ours.ply", mesh) == (tmp_path / "theirs.ply").read_bytes()

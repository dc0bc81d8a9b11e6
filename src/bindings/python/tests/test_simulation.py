"""Frames of simulations with one calibration, from memory and from files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import meniscus
from conftest import lattice


@pytest.fixture(scope="module")
def pool() -> Any:
    """Fluid that is deeper than the reach of the filters."""
    rng = np.random.default_rng(5)
    steps = np.arange(0.5, 30.0)
    points = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    return points + rng.uniform(-0.2, 0.2, points.shape)


def test_later_frames_keep_the_cells_of_the_first_frame(pool: Any) -> None:
    simulation = meniscus.Simulation()
    assert not simulation.settled
    first = simulation.frame(pool)
    assert simulation.settled
    # A single frame with twice the spacing would have cells of twice the size. In the simulation,
    # the size must not change.
    later = simulation.frame(2.0 * pool)
    assert later.report.cell_size == first.report.cell_size
    assert meniscus.reconstruct(2.0 * pool).report.cell_size > 1.5 * first.report.cell_size


def test_an_empty_frame_gives_an_empty_mesh(pool: Any, tmp_path: Path) -> None:
    simulation = meniscus.Simulation(spacing=1.0, normals=True)
    for _ in range(2):
        mesh = simulation.frame(np.zeros((0, 3), np.float32), velocity=np.zeros((0, 3), np.float32))
        assert mesh.vertices.shape == (0, 3) and mesh.triangles.shape == (0, 3) and mesh.volume == 0.0
        assert mesh.normals is not None and mesh.normals.shape == (0, 3) and mesh.attributes["velocity"].shape == (0, 3)
        assert mesh.check() and mesh.bounds is None
        assert mesh.write(tmp_path / "empty.ply", overwrite=True) > 0
        assert len(simulation.frame(pool).triangles) > 0


def test_attributes_must_be_named_in_the_constructor(pool: Any) -> None:
    simulation = meniscus.Simulation(spacing=1.0, attributes=["heat"])
    mesh = simulation.frame(pool, attributes={"heat": pool[:, 0]})
    assert set(mesh.attributes) == {"heat"}
    with pytest.raises(meniscus.InputError, match='"cold" was not named'):
        simulation.frame(pool, attributes={"heat": pool[:, 0], "cold": pool[:, 1]})
    with pytest.raises(meniscus.InputError, match='"velocity" was not named'):
        simulation.frame(pool, velocity=pool, attributes={"heat": pool[:, 0]})
    with pytest.raises(meniscus.InputError, match='no attribute "heat"'):
        simulation.frame(pool)
    with pytest.raises(TypeError, match="attributes: must be a list of names or paths, not str"):
        meniscus.Simulation(attributes="heat")
    assert set(meniscus.Simulation().frame(pool, velocity=pool).attributes) == {"velocity"}


def test_a_frame_that_fails_does_not_end_the_simulation(pool: Any) -> None:
    simulation = meniscus.Simulation(spacing=1.0)
    good = simulation.frame(pool)

    def stop(stage: str, done: float) -> None:
        raise ZeroDivisionError(stage)

    for _ in range(2):
        with pytest.raises(ZeroDivisionError):
            simulation.frame(pool, progress=stop)
        with pytest.raises(ValueError, match="not finite"):
            simulation.frame(pool * np.nan)
    assert np.array_equal(simulation.frame(pool).vertices, good.vertices)


def test_invalid_requests_are_errors(tmp_path: Path) -> None:
    for keywords in [{"spacing": -1.0}, {"sigma": 1.0}, {"start": 3}, {"resume": True}, {"format": "csv"}]:
        with pytest.raises(meniscus.InputError):
            meniscus.Simulation(**keywords)  # type: ignore[arg-type]
    with pytest.raises(meniscus.InputError, match="must be given together"):
        meniscus.Simulation("in_{}.bgeo")
    with pytest.raises(meniscus.InputError, match="frames: 3 is after 2"):
        meniscus.Simulation("in_{}.bgeo", tmp_path / "{}.ply", frames=(3, 2))
    with pytest.raises(meniscus.InputError, match="run"):
        meniscus.Simulation("in_{}.bgeo", tmp_path / "{}.ply").frame(np.zeros((1, 3)))
    with pytest.raises(meniscus.InputError, match="frame"):
        meniscus.Simulation().run()


def test_converted_files_equal_the_programs_files(tmp_path: Path, program: Any, dambreak: Path) -> None:
    inputs = dambreak / "ParticleData_Fluid_{}.bgeo"
    program("reconstruct", inputs, "-o", tmp_path / "theirs" / "{:03}.ply", "-q", "--normals")
    events: list[meniscus.Event] = []
    simulation = meniscus.Simulation(inputs, tmp_path / "ours" / "{:03}.ply", normals=True)
    (summary,) = simulation.run(progress=events.append)
    assert summary.complete and summary.made == 3 and summary.failed == 0 and summary.folder == tmp_path / "ours"
    for number in 1, 10, 20:
        ours, theirs = (tmp_path / by / f"{number:03}.ply" for by in ("ours", "theirs"))
        assert ours.read_bytes() == theirs.read_bytes()
    done = [event for event in events if event.kind == "done"]
    assert [event.frame for event in done] == [1, 10, 20] or {event.frame for event in done} == {1, 10, 20}
    assert done[-1].done == done[-1].total == 3 and done[-1].failed == 0
    assert {event.output for event in done} == {tmp_path / "ours" / f"{number:03}.ply" for number in (1, 10, 20)}
    assert str(done[0]) == done[0].message and "triangles" in done[0].message
    assert {"measured", "started", "stage", "ended"} <= {event.kind for event in events}
    # A second run with `resume` makes no frames, and a second run without it gives an error.
    (again,) = meniscus.Simulation(inputs, tmp_path / "ours" / "{:03}.ply", normals=True, resume=True).run()
    assert again.made == 0 and again.complete
    with pytest.raises(meniscus.FileError, match="already exists"):
        meniscus.Simulation(inputs, tmp_path / "ours" / "{:03}.ply", normals=True).run()
    assert meniscus.Simulation(inputs, tmp_path / "plan" / "{}.ply").plan() == [1, 10, 20]


def test_start_and_end_select_from_a_list_of_files(tmp_path: Path, dambreak: Path) -> None:
    inputs = [dambreak / f"ParticleData_Fluid_{number}.bgeo" for number in (1, 10, 20)]
    (summary,) = meniscus.Simulation(inputs, tmp_path / "{}.ply", start=5, end=15).run()
    assert summary.made == 1 and (tmp_path / "10.ply").exists()


def test_an_exception_in_a_callback_cancels_a_conversion(tmp_path: Path, dambreak: Path) -> None:
    simulation = meniscus.Simulation(dambreak / "ParticleData_Fluid_{}.bgeo", tmp_path / "{}.ply")

    def stop(event: meniscus.Event) -> None:
        raise ZeroDivisionError(event.kind)

    with pytest.raises(ZeroDivisionError):
        simulation.run(progress=stop)
    assert not list(tmp_path.glob("*.ply"))
    # The exception has not changed the simulation, which can still run to its end.
    (summary,) = simulation.run()
    assert summary.made == 3


def test_failed_frames_are_counted(tmp_path: Path, dambreak: Path) -> None:
    for number in 1, 2:
        (tmp_path / f"in_{number}.xyz").write_bytes(lattice(6.0).astype("<f4").tobytes())
    (tmp_path / "in_3.xyz").write_bytes(b"12345")
    events: list[meniscus.Event] = []
    (summary,) = meniscus.Simulation(tmp_path / "in_{}.xyz", tmp_path / "out_{}.ply").run(progress=events.append)
    assert (summary.made, summary.failed, summary.complete) == (2, 1, False)
    failed = [event for event in events if event.kind == "failed"]
    assert [event.frame for event in failed] == [3] and "in_3.xyz" in failed[0].message


def test_frames_are_listed_by_their_numbers(dambreak: Path, tmp_path: Path) -> None:
    listed = meniscus.list_frames(dambreak / "ParticleData_Fluid_{}.bgeo")
    assert listed == sorted(listed) and all(path == dambreak / f"ParticleData_Fluid_{number}.bgeo" for number, path in listed)
    assert meniscus.list_frames(str(dambreak / "*.bgeo")) == meniscus.list_frames([path for _, path in listed]) == listed
    with pytest.raises(meniscus.InputError, match="several simulations"):
        meniscus.list_frames(dambreak)
    with pytest.raises(meniscus.FileError, match="no frames found"):
        meniscus.list_frames(tmp_path)
    with pytest.raises(TypeError, match="must be a path or a list of paths"):
        meniscus.list_frames(7)  # type: ignore[arg-type]


@pytest.mark.parametrize("inputs", ["nope", "no/such/folder", "nope_{}.npz", "nope_1.npz", ["a_1.npz", "a_2.npz"], ["a.npz", "b.npz"], ""])
def test_frames_that_do_not_exist_are_not_listed(inputs: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FileNotFoundError) as of_list:
        meniscus.list_frames(inputs)
    with pytest.raises(FileNotFoundError) as of_conversion:
        meniscus.Simulation(inputs, "out/{}.ply").run()
    assert str(of_list.value) == str(of_conversion.value)
    with pytest.raises(meniscus.InputError, match="no input file"):
        meniscus.list_frames([])


def test_frame_numbers_can_be_negative(tmp_path: Path) -> None:
    points = lattice(6.0).astype("<f4")
    for number in -3, -2, 1:
        (tmp_path / f"in_{number}.xyz").write_bytes(points.tobytes())
    (tmp_path / "in_-1.xyz").write_bytes(b"12345")
    inputs = tmp_path / "in_{}.xyz"
    assert [number for number, _ in meniscus.list_frames(inputs)] == [-3, -2, -1, 1]
    assert meniscus.Simulation(inputs, tmp_path / "plan" / "{}.ply", end=-2).plan() == [-3, -2]
    events: list[meniscus.Event] = []
    (summary,) = meniscus.Simulation(inputs, tmp_path / "out" / "{}.ply", start=-3, end=np.int64(-1)).run(progress=events.append)
    assert (summary.made, summary.failed) == (2, 1) and list(summary.failures) == [-1]
    assert {event.frame for event in events if event.kind == "done"} == {-3, -2}
    assert [event.frame for event in events if event.kind == "failed"] == [-1]
    assert (tmp_path / "out" / "-3.ply").exists()
    (summary,) = meniscus.Simulation(inputs, tmp_path / "one" / "{}.ply", frames=(-2, -2)).run()
    assert summary.made == 1
    with pytest.raises(meniscus.InputError, match="start: .* is out of range"):
        meniscus.Simulation(inputs, tmp_path / "{}.ply", start=-(2**63) - 1)


def test_frames_of_several_inputs_are_joined(tmp_path: Path, program: Any) -> None:
    points = lattice(6.0)
    for number in 1, 2:
        for name, part in ("oil", points[:400]), ("water", points[400:]):
            np.save(tmp_path / f"{name}_{number}.npy", part)
    inputs = [tmp_path / f"{name}_{{}}.npy" for name in ("oil", "water")]
    (summary,) = meniscus.Simulation(inputs, tmp_path / "ours" / "{}.ply", together=True, spacing=1.0).run()
    assert summary.made == 2 and summary.complete
    program("reconstruct", *inputs, "-o", tmp_path / "theirs" / "{}.ply", "-q", "--together", "--spacing", 1)
    for number in 1, 2:
        ours, theirs = (tmp_path / by / f"{number}.ply" for by in ("ours", "theirs"))
        assert ours.read_bytes() == theirs.read_bytes()
    with pytest.raises(meniscus.InputError, match="together: works only if inputs and output are given"):
        meniscus.Simulation(together=True)

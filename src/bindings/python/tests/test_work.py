"""Long calls run without the interpreter's lock, can be cancelled at any time, and return their memory."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import meniscus
from conftest import lattice


@pytest.fixture(scope="module")
def long() -> Any:
    """Keywords of a reconstruction that takes long enough to be interrupted."""
    return {"positions": lattice(16.0), "spacing": 1.0, "cell": 0.1, "threads": 1}


def test_progress_is_reported_on_the_callers_thread_stage_by_stage(ball: Any) -> None:
    reports: list[tuple[str, float, int]] = []
    meniscus.reconstruct(ball, simplify=0.5, progress=lambda stage, done: reports.append((stage, done, threading.get_ident())))
    assert {thread for *_, thread in reports} == {threading.get_ident()}
    stages = list(dict.fromkeys(stage for stage, *_ in reports))
    assert stages == ["reading", "counting", "sampling", "meshing", "simplifying"]
    for stage in stages:
        shares = [done for name, done, _ in reports if name == stage]
        assert shares[0] == 0.0 and shares[-1] == 1.0 and shares == sorted(shares)


def test_an_exception_in_a_callback_cancels_the_work(long: Any) -> None:
    # Measure CPU time, because other processes may slow down this one.
    begin = time.process_time()
    meniscus.reconstruct(**long)
    whole = time.process_time() - begin

    def stop(stage: str, done: float) -> None:
        raise ZeroDivisionError(stage)

    begin = time.process_time()
    with pytest.raises(ZeroDivisionError, match="reading"):
        meniscus.reconstruct(**long, progress=stop)
    assert time.process_time() - begin < whole / 2


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Restores Python's handler of SIGINT, which a shell disables for background processes."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interruptible")
def test_ctrl_c_cancels_the_work(long: Any) -> None:
    begin = time.process_time()
    meniscus.reconstruct(**long)
    whole = time.process_time() - begin

    def press() -> None:
        while time.process_time() - begin < whole / 8:
            time.sleep(0.001)
        os.kill(os.getpid(), signal.SIGINT)

    begin = time.process_time()
    threading.Thread(target=press).start()
    with pytest.raises(KeyboardInterrupt):
        meniscus.reconstruct(**long)
    assert time.process_time() - begin < 0.75 * whole


def test_other_threads_keep_running(long: Any) -> None:
    ticks = 0
    stop = threading.Event()

    def count() -> None:
        nonlocal ticks
        while not stop.wait(0.002):
            ticks += 1

    thread = threading.Thread(target=count)
    thread.start()
    before = ticks
    begin = time.monotonic()
    meniscus.reconstruct(**long)
    seconds = time.monotonic() - begin
    counted = ticks - before
    stop.set()
    thread.join()
    assert counted > seconds / 0.002 / 20


def test_threads_can_share_the_module_but_not_a_simulation(long: Any, ball: Any) -> None:
    wanted = meniscus.reconstruct(ball).vertices
    results: list[Any] = []
    threads = [threading.Thread(target=lambda: results.append(meniscus.reconstruct(ball).vertices)) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(results) == 8 and all(np.array_equal(vertices, wanted) for vertices in results)

    simulation = meniscus.Simulation(**{name: value for name, value in long.items() if name != "positions"})
    busy = threading.Thread(target=simulation.frame, args=(long["positions"],))
    busy.start()
    errors = 0
    while busy.is_alive():
        try:
            simulation.frame(ball)
        except meniscus.Error as error:
            errors += "another thread" in str(error)
        time.sleep(0.01)
    assert errors > 0


def test_an_array_that_changes_meanwhile_gives_a_mesh_or_an_exception() -> None:
    calm = lattice(8.0)
    positions = calm.copy()
    stop = threading.Event()
    # Every 8th call holds this lock, so that the array does not change while the call reads it, and
    # the call returns a mesh.
    change_lock = threading.Lock()

    def keep_changing() -> None:
        rng = np.random.default_rng(1)
        while not stop.is_set():
            with change_lock:
                positions[rng.integers(len(calm), size=200)] = rng.choice([0.0, 1.0, -4.0, 1e30, np.nan, np.inf], (200, 3))
                positions[:] = calm
            time.sleep(0)

    thread = threading.Thread(target=keep_changing)
    thread.start()
    meshes = errors = 0
    try:
        for number in range(40):
            try:
                with change_lock if number % 8 == 7 else contextlib.nullcontext():
                    mesh = meniscus.reconstruct(positions, velocity=positions, spacing=1.0, cell=(0.2, 0.5)[number % 2], threads=2)
                meshes += bool(mesh.check())
            except meniscus.Error as error:
                assert "a bug" not in str(error)
                errors += 1
    finally:
        stop.set()
        thread.join()
    assert meshes + errors == 40 and meshes > 0


RESIDENT = """
import sys, numpy, meniscus
def resident():
    return int(open("/proc/self/statm").read().split()[1]) * 4096 / 2**20
count, calls = map(int, sys.argv[1:])
positions = numpy.random.default_rng(1).uniform(0, count ** (1 / 3), (count, 3)).astype(numpy.float32)
def call():
    mesh = meniscus.reconstruct(positions, velocity=positions, spacing=1.0, normals=True)
    return len(mesh.vertices) + len(mesh.triangles)
for _ in range(30):
    call()
before = resident()
for _ in range(calls):
    call()
print(before, resident(), len(meniscus.reconstruct(positions, spacing=1.0).triangles))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_memory_is_returned_after_each_call() -> None:
    command = [sys.executable, "-W", "ignore", "-c", RESIDENT, "5000", "60"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    before, after, _ = map(float, done.stdout.split())
    # A leak of one mesh per call would add 0.7 MiB per call. The 10 MiB allow for the allocator's
    # thread arenas.
    assert after < before + 10, f"{before} MiB grew to {after}"


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_calls_in_a_forked_child_give_the_parents_results(ball: Any, tmp_path: Path) -> None:
    # If a call in the child did not start its own threads, it would wait for threads that exist
    # only in the parent.
    mesh, csv = meniscus.reconstruct(ball), tmp_path / "in_1.csv"
    np.savetxt(csv, ball, delimiter=",", header="x,y,z", comments="")
    wall = tmp_path / "wall.ply"
    meniscus.reconstruct(lattice(4.0) + (20.0, 0.0, 0.0), spacing=1.0).write(wall)

    def work(output: Path) -> list[Any]:
        (summary,) = meniscus.Simulation(tmp_path / "in_{}.csv", output / "{}.ply", spacing=1.0).run()
        made = meniscus.reconstruct(ball, spacing=1.0, solid=[str(wall)])
        return [
            (made.volume, made.area, made.bounds, bool(made.check()), summary.made),
            (len(meniscus.read_particles(csv)), meniscus.list_frames(tmp_path / "in_{}.csv"), mesh.volume),
            (mesh.write(output / "mesh.ply", preview=True), len(meniscus.Frame.load(csv, spacing=1.0).surface().triangles)),
        ]

    expected = work(tmp_path / "parent")
    child = os.fork()
    if child == 0:
        signal.alarm(30)
        good = False
        try:
            good = work(tmp_path / "child") == expected
        finally:
            os._exit(0 if good else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_frames_and_simulations_cannot_be_used_in_a_forked_child(ball: Any) -> None:
    mesh, frame, simulation = meniscus.reconstruct(ball), meniscus.Frame(ball), meniscus.Simulation()
    simulation.frame(ball)
    child = os.fork()
    if child == 0:
        signal.alarm(30)
        try:
            good = len(meniscus.reconstruct(ball).triangles) == len(mesh.triangles)
            for call in frame.surface, lambda: simulation.frame(ball):
                try:
                    call()
                    good = False
                except meniscus.Error as error:
                    good = good and "another process" in str(error)
        finally:
            os._exit(0 if good else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0

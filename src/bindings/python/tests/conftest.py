"""Particles and the program, for all tests."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

ROOT = Path(__file__).resolve().parents[4]

Program = Callable[..., str]


@pytest.fixture(scope="session")
def program() -> Program:
    """A function that runs the program, and returns its output."""
    built = [path for kind in ("release", "debug") if (path := ROOT / "target" / kind / "meniscus").exists()]
    newest = max(built, key=lambda path: path.stat().st_mtime, default="")
    found = str(os.environ.get("MENISCUS", newest))
    if not found:
        pytest.fail("the program is not built; run `cargo build`, or set MENISCUS to its path")

    def run(*arguments: object) -> str:
        command = [found, *map(str, arguments)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{command}: {done.stderr}"
        return done.stdout

    return run


def lattice(radius: float, spacing: float = 1.0, jitter: float = 0.2) -> npt.NDArray[np.float64]:
    """A ball of jittered particles around the origin."""
    steps = np.arange(-radius, radius + spacing / 2, spacing)
    points = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    points = points[(points**2).sum(axis=1) < radius**2]
    return points + np.random.default_rng(3).uniform(-jitter, jitter, points.shape) * spacing


@pytest.fixture(scope="session")
def ball() -> npt.NDArray[np.float64]:
    """A ball of particles at spacing 1."""
    points = lattice(8.0)
    points.setflags(write=False)
    return points


@pytest.fixture(scope="session")
def dambreak() -> Path:
    """The folder of a dam break with three frames and a scene file."""
    return ROOT / "tests" / "data" / "dambreak_small"

"""Simulates a dam break with position-based dynamics in NumPy, and writes a mesh of each frame.

python dam_break.py FOLDER
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

import meniscus

SPACING, STEP, FRAMES, STEPS_PER_FRAME, PUSHES_PER_STEP = 0.05, 1 / 120, 36, 4, 6
TANK = np.array([[0.0, 0.0, 0.0], [1.6, 1.2, 0.4]])
GRAVITY = np.array([0.0, -9.81, 0.0])
Points: TypeAlias = npt.NDArray[np.float64]


def neighbours(points: Points) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Finds the pairs of particles in the same or in neighbouring cells."""
    cells = np.floor(points / SPACING).astype(np.int64) + 2
    size = cells.max(axis=0) + 3
    strides = np.array([size[1] * size[2], size[2], 1])
    keys = cells @ strides
    order = np.argsort(keys, kind="stable")
    around = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3), axis=-1).reshape(-1, 3) @ strides
    wanted = keys[:, None] + around
    first = np.searchsorted(keys[order], wanted, "left").ravel()
    counts = np.searchsorted(keys[order], wanted, "right").ravel() - first
    one = np.repeat(np.arange(len(points)), counts.reshape(wanted.shape).sum(axis=1))
    return one, order[np.repeat(first - np.cumsum(counts) + counts, counts) + np.arange(counts.sum())]


def advance(points: Points, velocity: Points) -> tuple[Points, Points]:
    """Advances the particles by a time step, pushes close particles apart, and keeps all particles in the tank."""
    moved = points + STEP * (velocity + STEP * GRAVITY)
    for _ in range(PUSHES_PER_STEP):
        one, other = neighbours(moved)
        apart = moved[one] - moved[other]
        length = np.linalg.norm(apart, axis=1)
        push = apart * np.where((0 < length) & (length < SPACING), 0.3 * (SPACING / np.maximum(length, 1e-9) - 1), 0)[:, None]
        moved += np.stack([np.bincount(one, push[:, axis], len(moved)) for axis in range(3)], axis=-1)
        moved = np.clip(moved, TANK[0] + SPACING / 2, TANK[1] - SPACING / 2)
    return moved, (moved - points) / STEP


if __name__ == "__main__":
    steps = [np.arange(SPACING / 2, end, SPACING) for end in (0.6, 0.9, 0.4)]
    water = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 3)
    water += np.random.default_rng(1).uniform(-0.1, 0.1, water.shape) * SPACING
    velocity = np.zeros_like(water)
    simulation = meniscus.Simulation(spacing=SPACING, domain=TANK, smooth=2.0)
    for frame in range(FRAMES):
        for _ in range(STEPS_PER_FRAME):
            water, velocity = advance(water, velocity)
        mesh = simulation.frame(water, velocity=velocity)
        mesh.write(Path(sys.argv[1]) / f"water_{frame:03}.ply", overwrite=True)
        print(f"frame {frame}: {len(mesh.triangles)} triangles; mesh volume {mesh.volume:.4f}, fluid volume {len(water) * SPACING**3:.4f}")

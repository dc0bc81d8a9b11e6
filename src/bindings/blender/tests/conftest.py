"""Makes the modules that do not need Blender importable, and writes a sequence of frames."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "extension"))
sys.path.insert(0, str(HERE.parents[3] / "tools" / "bindings"))


@pytest.fixture()
def sequence(tmp_path: Path) -> Path:
    """A folder with frames 2, 3 and 6 of a growing ball."""
    for number in (2, 3, 6):
        steps = np.arange(-3.0 - number, 4.0 + number)
        points = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
        np.save(tmp_path / f"ball_{number:03}.npy", points[(points**2).sum(axis=1) < (3 + number) ** 2])
    return tmp_path

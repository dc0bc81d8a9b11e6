"""Installs the extension from its zip in a fresh Blender, and generates frames."""

from __future__ import annotations

import argparse
import types
from pathlib import Path
from typing import Any

import bpy
import numpy as np

ROOT = Path(__file__).resolve().parents[5]
DAM = ROOT / "tests" / "data" / "dambreak_small"


def arguments() -> argparse.Namespace:
    """Parses the command line: the extension's zip, and a folder for outputs."""
    parser = argparse.ArgumentParser()
    parser.add_argument("zip", type=Path)
    parser.add_argument("folder", type=Path)
    return parser.parse_args()


def installed(zipped: Path) -> types.ModuleType:
    """Installs the extension as a user does, and enables it."""
    assert bpy.ops.extensions.package_install_files(filepath=str(zipped), repo="user_default", enable_on_install=True) == {"FINISHED"}
    import bl_ext.user_default.meniscus_surfaces as extension
    import meniscus

    # The imported module must come from the zip, not from elsewhere in the Python path.
    assert "extensions" in meniscus.__file__, meniscus.__file__
    return extension


def emptied() -> bpy.types.Scene:
    """Resets Blender to an empty scene."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=False)
    return bpy.context.scene


def sizes(mesh: bpy.types.Mesh) -> tuple[int, int]:
    """The numbers of vertices and triangles."""
    return len(mesh.vertices), len(mesh.polygons)


def positions(mesh: bpy.types.Mesh) -> np.ndarray[Any, Any]:
    """The vertices' positions, as an array of shape (N, 3)."""
    values = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.attributes["position"].data.foreach_get("vector", values)
    return values.reshape(-1, 3)


def block(count: int, spacing: float = 0.1) -> np.ndarray[Any, Any]:
    """A cube of about `count` jittered particles."""
    side = round(count ** (1 / 3))
    steps = np.arange(side) * spacing
    points = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    return (points + np.random.default_rng(4).uniform(-0.2, 0.2, points.shape) * spacing).astype(np.float32)

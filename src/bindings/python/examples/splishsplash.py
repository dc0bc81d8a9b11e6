"""An exporter for pySPlisHSPlasH that meshes each frame during the simulation: python splishsplash.py SCENE.json FOLDER

This script needs pySPlisHSPlasH. On a machine without a screen, the wheel of pySPlisHSPlasH may
need the system's libGLX in LD_PRELOAD.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pysplishsplash as sph  # type: ignore[import-not-found, unused-ignore]

import meniscus


class MeshExporter(sph.ExporterBase):  # type: ignore[misc, unused-ignore]
    """Writes the surface of the first fluid, with one `meniscus.Simulation` for all frames."""

    def __init__(self, base: Any, folder: Path) -> None:
        super().__init__(base)
        self.folder = folder
        self.simulation: meniscus.Simulation | None = None

    def step(self, frame: int) -> None:
        """Called by the simulator for each exported frame."""
        now = sph.Simulation.getCurrent()
        model, radius = now.getFluidModel(0), now.getParticleRadius()
        if self.simulation is None:
            self.simulation = meniscus.Simulation(radius=radius)
        # Each buffer is a view of the simulator's memory, with rows for the maximum number of
        # particles. Only the first `count` rows are in use.
        count = model.numActiveParticles()
        positions, velocity = (np.asarray(model.getFieldBuffer(name))[:count] for name in ("position", "velocity"))
        mesh = self.simulation.frame(positions, velocity=velocity)
        mesh.write(self.folder / f"fluid_{frame:04}.ply", overwrite=True)
        print(f"frame {frame}: {count} particles, {mesh}")

    def reset(self) -> None:
        """Called when the simulation is restarted."""
        self.simulation = None


if __name__ == "__main__":
    base = sph.Exec.SimulatorBase()
    base.init(sceneFile=str(Path(sys.argv[1]).resolve()), useGui=False, stopAt=0.5, outputDir=str(Path(sys.argv[2]).resolve()))
    exporter = MeshExporter(base, Path(sys.argv[2]))
    base.addParticleExporter("enableMesh", "Mesh exporter", "Makes a mesh of each frame", exporter)
    base.activateExporter("Mesh exporter", True)
    base.run()
    sys.stdout.flush()
    # Exit without cleaning up, because the simulator has already deleted the exporter, and Python
    # would delete it again.
    os._exit(0)

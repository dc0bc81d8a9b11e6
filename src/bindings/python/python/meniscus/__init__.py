"""Watertight surface meshes from particle fluids (SPH, PBD, FLIP, MPM).

>>> import numpy, meniscus
>>> steps = numpy.arange(-6.0, 7.0)
>>> lattice = numpy.stack(numpy.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
>>> ball = lattice[(lattice**2).sum(axis=1) < 36.0]
>>> mesh = meniscus.reconstruct(ball, spacing=1.0)
>>> bool(mesh.check())
True

``reconstruct`` makes a mesh from arrays. ``Simulation`` makes the meshes of a simulation's frames.
``Frame`` samples particles once for several surfaces. ``read_particles`` and ``list_frames`` read
files. ``meniscus.compat.pysplashsurf`` provides the interface of pysplashsurf.
"""

import warnings as _warnings

from . import _conflict
from ._errors import DeviceError, Error, FileError, InputError, MeshWarning
from ._meniscus import (
    Check,
    Event,
    Frame,
    Mesh,
    Particles,
    Report,
    Simulation,
    Summary,
    Volume,
    __version__,
    list_frames,
    read_particles,
    reconstruct,
)

if _other := _conflict.other_package():
    _warnings.warn(_other, RuntimeWarning, stacklevel=2)

__all__ = [
    "Check",
    "DeviceError",
    "Error",
    "Event",
    "FileError",
    "Frame",
    "InputError",
    "Mesh",
    "MeshWarning",
    "Particles",
    "Report",
    "Simulation",
    "Summary",
    "Volume",
    "__version__",
    "list_frames",
    "read_particles",
    "reconstruct",
]

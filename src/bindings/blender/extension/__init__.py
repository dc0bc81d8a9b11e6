"""Live watertight surfaces of particle fluids, computed by the library meniscus, which this extension contains."""

import warnings

import bpy  # noqa: F401  (first, so that an import without Blender fails with a clear error)
import meniscus

from . import live, operators, panels, settings


def register() -> None:
    # Python need not print warnings about meshes, because panels show them.
    warnings.filterwarnings("ignore", category=meniscus.MeshWarning)
    settings.register()
    operators.register()
    panels.register()
    live.register()


def unregister() -> None:
    live.unregister()
    panels.unregister()
    operators.unregister()
    settings.unregister()

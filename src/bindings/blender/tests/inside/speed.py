"""Measures the time of a frame change relative to the library's time, and the memory after many changes. Run by tools/bindings/blender speed.

usage: speed.py ZIP FOLDER PARTICLES-A PARTICLES-B
"""

from __future__ import annotations

import statistics
import sys
import time
from pathlib import Path

import bpy
from common import emptied, installed

zipped, folder, first, second = map(Path, sys.argv[1:])
extension = installed(zipped)
live, meshes, Arrays = extension.live, extension.meshes, extension.surfaces.arrays.Arrays
import meniscus  # noqa: E402  (of the extension)

ROUNDS, CHANGES = 7, 200


def resident() -> float:
    """The resident memory of the process in MiB."""
    status = Path("/proc/self/status").read_text()
    return int(next(line for line in status.splitlines() if line.startswith("VmRSS")).split()[1]) / 1024


def clock(act) -> float:
    began = time.perf_counter()
    act()
    return time.perf_counter() - began


def measure_with_cell_size(cell: float) -> None:
    scene = emptied()
    live._state.reset()
    bpy.ops.meniscus.add_files(filepath=str(first))
    shown = bpy.context.object
    settings = shown.data.meniscus
    settings.cell_viewport = cell
    numbers = [extension.surfaces.sequence.number_of(str(path)) for path in (first, second)]
    frames = [number - settings.first + settings.start for number in numbers]
    keywords = {"spacing": live.rounded_as_typed(settings.spacing), "cell": cell}
    bare = bpy.data.meshes.new("bare")
    other = bpy.data.objects.new("bare", bare)
    scene.collection.objects.link(other)
    found: dict[str, list[float]] = {"change": [], "library": [], "bare": [], "again": []}
    for turn in range(ROUNDS):
        path, frame, before = ((first, second)[turn % 2], frames[turn % 2], frames[1 - turn % 2])
        scene.frame_set(before)
        live._state.cache.clear()
        live._state.makers.clear()
        found["change"].append(clock(lambda: scene.frame_set(frame)))
        scene.frame_set(before)
        found["again"].append(clock(lambda: scene.frame_set(frame)))
        assert not live.status_of(shown.data).error
        made: list[meniscus.Mesh] = []

        def library() -> None:
            mesh = meniscus.Frame.load(path, **keywords).surface()
            mesh.vertices, mesh.triangles, mesh.attributes
            made.append(mesh)

        found["library"].append(clock(library))
        arrays = Arrays.of(made[0])

        def bare_update() -> None:
            meshes.fill(bare, arrays, 1.0)
            bpy.context.view_layer.update()

        found["bare"].append(clock(bare_update))
    medians = {name: statistics.median(values) for name, values in found.items()}
    bound = medians["library"] + 1.5 * medians["bare"]
    print(
        f"cells of {cell}: {made[0].report.particles} particles, {len(shown.data.polygons)} triangles; frame change {medians['change']:.3f} s, "
        f"library {medians['library']:.3f} s, bare update {medians['bare']:.3f} s; frame change / (library + 1.5 bare updates): {medians['change'] / bound:.2f}; "
        f"cached frame {medians['again']:.3f} s",
        flush=True,
    )


def memory() -> None:
    scene = emptied()
    live._state.reset()
    live.set_cache_limit(32)
    bpy.ops.meniscus.add_files(filepath=str(first))
    shown = bpy.context.object
    settings = shown.data.meniscus
    numbers = [extension.surfaces.sequence.number_of(str(path)) for path in (first, second)]
    frames = [number - settings.first + settings.start for number in numbers]
    before = []
    for change in range(CHANGES + 1):
        # A new smoothing width requires a new surface, which cannot be in the cache.
        settings.smooth = 1.5 + change * 1e-3
        scene.frame_set(frames[change % 2])
        if change in (0, 10, 25, 50, 100, 150, CHANGES):
            before.append(f"{change}: {resident():.0f}")
    kept, size = live.cached()
    print(f"resident MiB after changes {', '.join(before)}; {kept} cached surfaces use {size / 2**20:.1f} MiB, the limit is 32", flush=True)


for cell in (1.0, 0.5):
    measure_with_cell_size(cell)
memory()

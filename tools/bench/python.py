"""Measures how long a Python call takes from NumPy arrays to NumPy arrays.

Compares the time with the library's own stage times, and with pysplashsurf.

usage: python tools/bench/python.py PARTICLES [RUNS]

Needs the wheel, and pysplashsurf 0.14 (PyPI). The programs run alternately on 2 threads. Prints
medians.
"""

import statistics
import sys
import time

import meniscus
import numpy as np
import pysplashsurf
from meniscus.compat import pysplashsurf as compat

THREADS = 2
GENESIS = dict(
    cube_size=0.8, iso_surface_threshold=0.6, mesh_smoothing_weights=True, mesh_smoothing_iters=25,
    normals_smoothing_iters=10, mesh_cleanup=True, compute_normals=True,
)


def taken(call):
    begin = time.perf_counter()
    result = call()
    return time.perf_counter() - begin, result


def main():
    path, runs = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 9
    particles = meniscus.read_particles(path)
    spacing = meniscus.reconstruct(particles.positions, threads=THREADS).report.spacing
    print("| NumPy to NumPy | the library's stages | the call | ratio |\n|---|---|---|---|")
    for dtype in np.float32, np.float64:
        positions = np.ascontiguousarray(particles.positions, dtype)
        calls, stages = [], []
        for _ in range(runs):
            seconds, mesh = taken(lambda: meniscus.reconstruct(positions, spacing=spacing, threads=THREADS))
            assert len(mesh.vertices) and len(mesh.triangles)
            calls.append(seconds)
            stages.append(sum(mesh.report.seconds.values()))
        call, own = statistics.median(calls), statistics.median(stages)
        print(f"| {len(positions)} particles, {np.dtype(dtype).name} | {own:.3f} | {call:.3f} | {call / own:.3f} |")

    positions = np.ascontiguousarray(particles.positions, np.float32)
    print("\n| pysplashsurf's call | meniscus | pysplashsurf | ratio |\n|---|---|---|---|")
    for name, options in [("`cube_size=1.0`, no other options", dict(cube_size=1.0)), ("Genesis' call", GENESIS)]:
        options = dict(particle_radius=spacing / 2, smoothing_length=2.0, multi_threading=True, **options)
        ours, theirs = [], []
        for _ in range(max(1, runs // 3)):
            ours.append(taken(lambda: compat.reconstruction_pipeline(positions, **options))[0])
            theirs.append(taken(lambda: pysplashsurf.reconstruction_pipeline(positions, **options))[0])
        ours, theirs = statistics.median(ours), statistics.median(theirs)
        print(f"| {name} | {ours:.2f} | {theirs:.2f} | {theirs / ours:.0f} |")


main()

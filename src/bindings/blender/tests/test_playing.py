"""A converted stage and converted volumes show each frame when the live surface shows it."""

from __future__ import annotations

import json
from math import floor
from pathlib import Path

import pytest
from surfaces.playing import read_time_mapping, volume_offset
from surfaces.sequence import Timing, shown_at


def listing(folder: Path, frames: list[tuple[int, float]]) -> Path:
    """A list of frames with their numbers and time codes."""
    path = folder / "pool.usdc.json"
    path.write_text(json.dumps({"frames": [{"frame": number, "time_code": code} for number, code in frames]}))
    return path


def test_one_file_per_frame_needs_only_an_offset(tmp_path: Path) -> None:
    read = read_time_mapping(listing(tmp_path, [(3, 3.0), (10, 10.0), (20, 20.0)]), Timing(start=1, first=3))
    # Frame 1 shows file 3, whose time code is 3.
    assert read.offset == 1 - 3


def test_other_rates_and_steps_need_an_expression(tmp_path: Path) -> None:
    # The simulation has ten files per second, the scene has 25 frames per second, and each scene
    # frame advances by two files.
    read = read_time_mapping(listing(tmp_path, [(0, 25.0), (5, 37.5)]), Timing(start=11, first=1, step=2.0))
    assert read.offset is None
    code = eval(read.expression, {"frame": 13})
    # Frame 13 shows file 5.
    assert code == pytest.approx(37.5)


def test_a_single_frame_needs_only_an_offset(tmp_path: Path) -> None:
    assert read_time_mapping(listing(tmp_path, [(7, 7.0)]), Timing(start=1, first=7)).offset == 1 - 7


@pytest.mark.parametrize("timing", [Timing(), Timing(start=10, first=3), Timing(start=5, first=8, step=2.0), Timing(start=-4, first=2, step=0.3)])
def test_a_volume_shows_the_file_of_the_live_surface(timing: Timing) -> None:
    first, last = 2, 17
    frames = [(number, Path(f"water_{number}.vdb")) for number in range(first, last + 1)]
    expression = volume_offset(timing, first, last)
    for frame in range(-20, 60):
        offset = eval(expression, {"frame": frame, "floor": floor, "max": max, "min": min})
        # Blender computes the file number of a Volume with this formula.
        shown = max(frame - timing.start + 1, 1) + offset
        assert shown == shown_at(frames, timing, frame).number, frame

"""Times at which Blender plays converted meshes or volumes, so that they match the live surface."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from .sequence import Timing


@dataclass(frozen=True)
class TimeMapping:
    """Maps scene frames to the time codes of a stage.

    The time code is `code_at_start` at frame `start`, and increases by `codes_per_frame` per scene frame.
    """

    start: int
    code_at_start: float
    codes_per_frame: float

    @property
    def offset(self) -> float | None:
        """The number to subtract from a frame to get its time code; None if the rates differ."""
        return self.start - self.code_at_start if abs(self.codes_per_frame - 1.0) < 1e-4 else None

    @property
    def expression(self) -> str:
        """The time code of `frame`, as a driver expression."""
        return f"{self.code_at_start:.9g} + ({self.codes_per_frame:.9g}) * (frame - {self.start})"


def read_time_mapping(listing: Path, timing: Timing) -> TimeMapping:
    """Reads the time codes in a conversion's JSON file, and returns how scene frames map to them."""
    listed = json.loads(listing.read_text())
    first, last = listed["frames"][0], listed["frames"][-1]
    numbers = last["frame"] - first["frame"]
    codes = (last["time_code"] - first["time_code"]) / numbers if numbers else 1.0
    code_at_start = first["time_code"] + codes * (timing.first - first["frame"])
    return TimeMapping(timing.start, code_at_start, codes * timing.step)


def volume_offset(timing: Timing, first: int, last: int) -> str:
    """The driver expression for the frame offset of a Volume that plays the files `first` to `last`.

    Blender plays the file whose number is this offset plus a count, which is 1 up to the start
    frame, 2 at the next frame, and so on.
    """
    number = f"{timing.first} + floor((frame - {timing.start}) * {timing.step:.9g} + 1e-6)"
    return f"max({first}, min({last}, {number})) - max(frame - {timing.start} + 1, 1)"

"""When a conversion's stage is read, so that it shows what the live surface would."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from .sequence import Timing


@dataclass(frozen=True)
class Reading:
    """Time codes of a stage by the scene's frames: `at_start` at the frame `start`, and so many more for `each`."""

    start: int
    at_start: float
    each: float

    @property
    def offset(self) -> float | None:
        """What is to be taken off a frame to get its time code, if that is all there is to do."""
        return self.start - self.at_start if abs(self.each - 1.0) < 1e-4 else None

    @property
    def expression(self) -> str:
        """The time code of `frame`, as drivers have it."""
        return f"{self.at_start:.9g} + ({self.each:.9g}) * (frame - {self.start})"


def reading(listing: Path, timing: Timing) -> Reading:
    """Reads how times follow from numbers in what the library lists of a conversion, whose stage has `fps` time codes a second."""
    listed = json.loads(listing.read_text())
    first, last, fps = listed["frames"][0], listed["frames"][-1], listed["fps"]
    numbers = last["frame"] - first["frame"]
    codes = (last["time"] - first["time"]) * fps / numbers if numbers else 1.0
    at_start = first["time"] * fps + codes * (timing.first - first["frame"])
    return Reading(timing.start, at_start, codes * timing.step)

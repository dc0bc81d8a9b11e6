"""Finds the file of a sequence for a frame of the scene.

The library lists the frames of a name, a folder or a file with several steps. This module selects
one of these frames for each frame of the scene.
"""

from __future__ import annotations

import bisect
import math
import os
import re
from dataclasses import dataclass
from pathlib import Path

import meniscus

#: Extensions of particle files, lists of particle files, packed frames, and compressed files.
EXTENSIONS = (
    ".bgeo", ".bhclassic", ".bi4", ".csv", ".dat", ".dump", ".extxyz", ".geo", ".h5", ".h5md", ".h5part", ".hdf",
    ".hdf5", ".json", ".lammpstrj", ".mnf", ".npy", ".npz", ".ply", ".pvd", ".pvtp", ".pvtu", ".sc", ".series", ".txt",
    ".vtk", ".vtkhdf", ".vtm", ".vtp", ".vtpc", ".vtpd", ".vtu", ".xyz",
    ".gz", ".xz", ".zst",
)
#: Finds the frame number: the last digits before the extensions. A dash before them counts as a
#: minus sign only after a separator, because otherwise it belongs to the name.
_NUMBER = re.compile(r"^(.*?)((?:(?<![^_. \-=(\[])-)?\d+)(\D*|\.\w+|\.\w+\.(?:gz|xz|zst))$")

Stamp = tuple[int, int]


@dataclass(frozen=True)
class Shown:
    """The file for a frame of the scene."""

    number: int
    path: str
    #: The number that the timing gives. It differs from `number` if the file with that number is
    #: missing.
    wanted: int

    @property
    def is_gap(self) -> bool:
        """Whether the file is an earlier one, because the wanted file is missing."""
        return self.number < self.wanted


@dataclass(frozen=True)
class Timing:
    """Timing of a sequence: file number `first` at scene frame `start`, then `step` numbers per frame."""

    start: int = 1
    first: int = 0
    step: float = 1.0

    def number(self, frame: int) -> int:
        """The file number for a frame of the scene."""
        return self.first + math.floor((frame - self.start) * self.step + 1e-6)


def sequence_of(path: str) -> str:
    """The name of the sequence that contains a file, with {} for the number.

    A folder, a file with several steps and a name without a number are returned unchanged.
    """
    folder, name = os.path.split(path)
    if "#" in name or "{" in name or os.path.isdir(path):
        return path
    if os.path.isfile(path):
        try:
            steps = meniscus.list_frames(path)
        except meniscus.Error:
            # Ignore the error here, because reading the file will report it.
            steps = []
        if any("#" in file.name for _, file in steps):
            return path
    found = _NUMBER.match(name)
    return os.path.join(folder, f"{found[1]}{{}}{found[3]}") if found else path


def number_of(path: str) -> int | None:
    """The number in a file's name."""
    found = _NUMBER.match(os.path.basename(path))
    return int(found[2]) if found else None


def shown_at(frames: list[tuple[int, Path]], timing: Timing, frame: int) -> Shown:
    """The file to show at a frame of the scene.

    Frames before the first file show the first file, frames after the last file show the last file,
    and frames in a gap show the previous file.
    """
    wanted = timing.number(frame)
    at = max(bisect.bisect_right(frames, wanted, key=lambda known: known[0]) - 1, 0)
    number, path = frames[at]
    is_after = at == len(frames) - 1
    return Shown(number, str(path), number if is_after or wanted < number else wanted)


def stamp_of(path: str) -> Stamp | None:
    """A file's size and modification time, to detect changes; None if the file does not exist."""
    name, step = os.path.split(path)[1], path.rsplit("#", 1)
    try:
        found = os.stat(step[0] if "#" in name else path)
    except OSError:
        return None
    return found.st_size, found.st_mtime_ns


class Listings:
    """Lists the frames of sequences, and caches each list until its folder or file changes."""

    def __init__(self) -> None:
        self._known: dict[str, tuple[Stamp | None, list[tuple[int, Path]]]] = {}

    def frames(self, inputs: str) -> list[tuple[int, Path]]:
        """The numbers and files of the frames that `meniscus.list_frames` finds for `inputs`.

        Raises the same errors as `meniscus.list_frames`.
        """
        stamp = stamp_of(inputs if os.path.exists(inputs) else os.path.dirname(inputs) or ".")
        known = self._known.get(inputs)
        if known is None or known[0] != stamp or stamp is None:
            known = stamp, meniscus.list_frames(inputs)
            self._known[inputs] = known
        return known[1]

    def clear(self) -> None:
        """Discards all lists, so that they are read again."""
        self._known.clear()

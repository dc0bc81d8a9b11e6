"""Volume objects that play the .vdb files of a conversion."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import bpy

from .surfaces.playing import volume_offset
from .surfaces.sequence import Timing, number_of

#: The largest number of frames that Blender accepts for a Volume.
_LONGEST = 1048574


def files_of(output: str) -> Mapping[int, Path]:
    """The files of a conversion, by their numbers. `output` is the files' name with {:04} for the number."""
    found = Path(output)
    files = {number_of(str(file)): file for file in found.parent.glob(found.name.replace("{:04}", "*"))}
    return {number: files[number] for number in sorted(number for number in files if number is not None)}


def add(context: bpy.types.Context, name: str, files: Mapping[int, Path], timing: Timing) -> bpy.types.Object:
    """Adds a Volume that shows the file of each frame of the scene."""
    first, last = min(files), max(files)
    volume = bpy.data.volumes.new(name)
    volume.filepath = str(files[first])
    volume.is_sequence = True
    volume.sequence_mode = "EXTEND"
    volume.frame_start, volume.frame_duration = timing.start, _LONGEST
    volume.driver_add("frame_offset").driver.expression = volume_offset(timing, first, last)
    added = bpy.data.objects.new(name, volume)
    context.collection.objects.link(added)
    return added

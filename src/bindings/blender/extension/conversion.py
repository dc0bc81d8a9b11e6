"""Converts a sequence to meshes or volumes on disk, on a separate thread, with settings that are independent of Blender once it runs."""

from __future__ import annotations

import atexit
import os
import threading
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import meniscus

from .surfaces.request import Filters, Sampling


@dataclass(frozen=True)
class Order:
    """The input, the output and the settings of a conversion."""

    inputs: str
    output: str
    #: The file that plays all meshes; None for volumes, which Blender plays by their names.
    stage: str | None
    fps: float
    particles_up: str | None
    sampling: Sampling
    filters: Filters
    #: The files of the solids, with {} for the frame's number, and their distance from the fluid.
    solids: tuple[str, ...] = ()
    solid_offset: float | None = None

    def keywords(self) -> dict[str, Any]:
        """The keywords of the library's conversion: finished frames are kept if their settings are the same, and made again otherwise."""
        of = [(each.name, getattr(part, each.name)) for part in (self.sampling, self.filters) for each in fields(part)]
        solids = {"solid": self.solids, "solid_offset": self.solid_offset} if self.solids else {}
        return {name: value for name, value in of if value is not None} | solids | {
            "fps": self.fps,
            "up": "z",
            "particles_up": self.particles_up,
            "resume": True,
            "overwrite": True,
        }


class Ended(Exception):
    """Raised in the progress callback to cancel the work."""


class Conversion:
    """A conversion that is running, or has ended."""

    def __init__(self, order: Order) -> None:
        self.order = order
        self.done, self.total = 0, 0
        self.message = "Calibrating the frames"
        self.error = ""
        self.problems: list[str] = []
        self._end = threading.Event()
        # Python waits for all other threads before it calls exit handlers.
        self._thread = threading.Thread(target=self._run, name="meniscus conversion", daemon=True)
        atexit.register(self._leave)

    def start(self) -> None:
        """Starts the thread."""
        self._thread.start()

    @property
    def runs(self) -> bool:
        """Whether it is running."""
        return self._thread.is_alive()

    @property
    def is_complete(self) -> bool:
        """Whether all meshes are finished."""
        return not self.runs and not self.error and not self._end.is_set()

    def cancel(self) -> None:
        """Cancels it after the frames in progress. Finished frames are kept, and are not made again."""
        self._end.set()

    def _leave(self) -> None:
        """Ends with Blender: otherwise the thread would continue in an interpreter that is shut down."""
        self.cancel()
        if self.runs:
            self.join()

    def join(self) -> None:
        """Waits until it has ended."""
        self._thread.join()

    def _hear(self, event: meniscus.Event) -> None:
        if self._end.is_set():
            raise Ended
        if event.total is not None:
            self.total = event.total
        if event.kind == "done" and event.done is not None:
            self.done = event.done
        elif event.kind == "failed":
            self.problems.append(event.message)
        self.message = event.message

    def _run(self) -> None:
        try:
            os.makedirs(Path(self.order.output).parent, exist_ok=True)
            simulation = meniscus.Simulation(self.order.inputs, self.order.output, **self.order.keywords())
            simulation.run(progress=self._hear)
        except Ended:
            self.message = "Cancelled: finished frames are kept"
        except (meniscus.Error, OSError, MemoryError) as error:
            self.error = str(error) or "Out of memory"
        finally:
            atexit.unregister(self._leave)

"""Converts a sequence to mesh or volume files on a separate thread.

The thread does not access Blender, because an `Order` holds copies of all settings.
"""

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
    #: The USD file that plays all meshes; None for volumes, which Blender finds by their file
    #: names.
    stage: str | None
    fps: float
    #: All fields are None for packed frames, which were sampled before they were packed.
    sampling: Sampling
    filters: Filters
    #: The solids' files, with {} for the frame number; `solid_offset` is the distance between
    #: solids and fluid.
    solids: tuple[str, ...] = ()
    solid_offset: float | None = None

    def keywords(self) -> dict[str, Any]:
        """The keywords for `meniscus.Simulation`.

        With these keywords, the simulation keeps finished frames if the settings are unchanged, and
        otherwise makes them again. The files keep the axes of the particles, as the live surface
        does, so the same object transform places both.
        """
        of = [(each.name, getattr(part, each.name)) for part in (self.sampling, self.filters) for each in fields(part)]
        solids = {"solid": self.solids, "solid_offset": self.solid_offset} if self.solids else {}
        return {name: value for name, value in of if value is not None} | solids | {
            "fps": self.fps,
            "resume": True,
            "overwrite": True,
        }


class Cancelled(Exception):
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
        # The thread is a daemon, because at exit Python waits for all threads that are not daemons
        # before it calls `_stop_at_exit`, which cancels the conversion.
        self._thread = threading.Thread(target=self._run, name="meniscus conversion", daemon=True)
        atexit.register(self._stop_at_exit)

    def start(self) -> None:
        """Starts the conversion on its thread."""
        self._thread.start()

    @property
    def runs(self) -> bool:
        """Whether the conversion is running."""
        return self._thread.is_alive()

    @property
    def is_complete(self) -> bool:
        """Whether the conversion ended without an error and was not cancelled."""
        return not self.runs and not self.error and not self._end.is_set()

    def cancel(self) -> None:
        """Cancels the conversion after the frames in progress; finished frames are kept."""
        self._end.set()

    def _stop_at_exit(self) -> None:
        """Ends the conversion when Blender exits, because its thread must not outlive the interpreter."""
        self.cancel()
        if self.runs:
            self.join()

    def join(self) -> None:
        """Waits until the conversion has ended."""
        self._thread.join()

    def _on_event(self, event: meniscus.Event) -> None:
        if self._end.is_set():
            raise Cancelled
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
            simulation.run(progress=self._on_event)
        except Cancelled:
            self.message = "Cancelled: finished frames are kept"
        except (meniscus.Error, OSError, MemoryError) as error:
            self.error = str(error) or "Out of memory"
        finally:
            atexit.unregister(self._stop_at_exit)

"""A sequence on disk to meshes on disk, on a thread of its own, by settings that are Blender's no more once it runs."""

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
    """What is to be converted, and how."""

    inputs: str
    output: str
    stage: str
    fps: float
    particles_up: str | None
    sampling: Sampling
    filters: Filters

    def keywords(self) -> dict[str, Any]:
        """The keywords of the library's conversion: what was done before by the same settings is kept, and anew by others."""
        of = [(each.name, getattr(part, each.name)) for part in (self.sampling, self.filters) for each in fields(part)]
        return {name: value for name, value in of if value is not None} | {
            "fps": self.fps,
            "up": "z",
            "particles_up": self.particles_up,
            "resume": True,
            "overwrite": True,
        }


class Ended(Exception):
    """Raised where the library tells of progress, to end its work."""


class Conversion:
    """A conversion that runs, or has ended."""

    def __init__(self, order: Order) -> None:
        self.order = order
        self.done, self.total = 0, 0
        self.message = "Measuring what the frames have in common"
        self.error = ""
        self.problems: list[str] = []
        self._end = threading.Event()
        # Python waits for whatever is no daemon before it tells anybody that it ends.
        self._thread = threading.Thread(target=self._run, name="meniscus conversion", daemon=True)
        atexit.register(self._leave)

    def start(self) -> None:
        """Begins."""
        self._thread.start()

    @property
    def runs(self) -> bool:
        """Whether it is at work."""
        return self._thread.is_alive()

    @property
    def is_complete(self) -> bool:
        """Whether all meshes are there."""
        return not self.runs and not self.error and not self._end.is_set()

    def cancel(self) -> None:
        """Ends it after the frames that are at work; what is done stays, and is not done again."""
        self._end.set()

    def _leave(self) -> None:
        """Ends with Blender: a thread that is left behind would wake up in an interpreter that is gone."""
        self.cancel()
        if self.runs:
            self.join()

    def join(self) -> None:
        """Waits for its end."""
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
            self.message = "Ended: what is done is kept"
        except (meniscus.Error, OSError, MemoryError) as error:
            self.error = str(error) or "The memory does not suffice"
        finally:
            atexit.unregister(self._leave)

"""The inputs and settings of a surface, which are its key in the cache."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Hashable
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import meniscus
import numpy as np
import numpy.typing as npt

from .arrays import Arrays
from .sequence import stamp_of
from .solids import Solids

#: Packed frames have their own cells and spacing, and no attributes.
PACKED = ".mnf"


@dataclass(frozen=True)
class Sampling:
    """Settings of the sampling. None is the library's default."""

    spacing: float | None = None
    cell: float | None = None
    attributes: tuple[str, ...] | None = None
    where: str | None = None
    #: The lowest and highest corner of a tank.
    domain: tuple[float, ...] | None = None


@dataclass(frozen=True)
class Filters:
    """Settings of a surface that need only samples, not particles."""

    smooth: float | None = None
    smallest_drop: int | None = None
    simplify: float | None = None


def _given(of: Sampling | Filters) -> dict[str, Any]:
    values = {each.name: getattr(of, each.name) for each in fields(of)}
    return {name: value for name, value in values.items() if value is not None}


@dataclass(frozen=True)
class FromFile:
    """A particle file or a packed frame."""

    path: str
    sampling: Sampling

    @property
    def is_packed(self) -> bool:
        return self.path.lower().endswith(PACKED)

    @property
    def key(self) -> Hashable:
        """Changes if the samples would change."""
        stamp = stamp_of(self.path)
        return self.path, stamp, None if self.is_packed else self.sampling

    def sample(self) -> meniscus.Frame:
        return meniscus.Frame.load(self.path, **({} if self.is_packed else _given(self.sampling)))


@dataclass(frozen=True)
class FromPoints:
    """Particles in memory."""

    positions: npt.NDArray[np.float32]
    velocity: npt.NDArray[np.float32] | None
    sampling: Sampling
    digest: bytes = field(init=False)

    def __post_init__(self) -> None:
        digest = hashlib.blake2b(self.positions.data, digest_size=16)
        if self.velocity is not None:
            digest.update(self.velocity.data)
        object.__setattr__(self, "digest", digest.digest())

    @property
    def key(self) -> Hashable:
        """Changes if the samples would change."""
        return self.digest, len(self.positions), self._asked

    def sample(self) -> meniscus.Frame:
        return meniscus.Frame(self.positions, velocity=self.velocity, **_given(self._asked))

    @property
    def _asked(self) -> Sampling:
        """Settings of files do not apply to particles in memory."""
        return replace(self.sampling, attributes=None, where=None)


@dataclass(frozen=True)
class Request:
    """A request for a surface."""

    source: FromFile | FromPoints
    filters: Filters
    solids: Solids = Solids()

    @property
    def key(self) -> Hashable:
        """Changes if the surface would change."""
        key = self.source.key, self.filters
        # Surfaces without solids keep the names that older versions gave them.
        return (*key, self.solids.key) if self.solids.meshes else key

    @property
    def name(self) -> str:
        """A short form of the key, to be stored with a mesh."""
        return hashlib.blake2b(repr(self.key).encode(), digest_size=16).hexdigest()


class Maker:
    """Makes surfaces, and keeps the last samples, so that other filters need no particles."""

    def __init__(self) -> None:
        self._key: Hashable = None
        self._frame: meniscus.Frame | None = None

    def make(self, request: Request) -> Arrays:
        """The arrays of a surface.

        Raises what the library raises, with its sentences.
        """
        key = request.source.key
        if self._frame is None or key != self._key:
            # Frees the memory of the last samples first.
            self._frame = None
            self._frame, self._key = request.source.sample(), key
        if not request.solids.meshes:
            return Arrays.of(self._frame.surface(**_given(request.filters)))
        with tempfile.TemporaryDirectory(prefix="meniscus-") as folder:
            solid = request.solids.written(Path(folder))
            return Arrays.of(self._frame.surface(**_given(request.filters), solid=solid, solid_offset=request.solids.offset))

    @property
    def particles_up(self) -> str | None:
        """The axis that points up in the last sampled particles."""
        return self._frame.particles_up if self._frame else None

    def forget(self) -> None:
        """Frees the memory of the samples."""
        self._frame, self._key = None, None

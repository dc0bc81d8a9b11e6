"""Requests for surfaces: their inputs and settings, from which the cache keys are computed."""

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

#: The extension of packed frames, which define their cells and spacing and have no attributes.
PACKED = ".mnf"


@dataclass(frozen=True)
class Sampling:
    """Settings of the sampling; None stands for the library's default."""

    spacing: float | None = None
    cell: float | None = None
    attributes: tuple[str, ...] | None = None
    where: str | None = None
    #: The lowest and the highest corner of a tank: six coordinates.
    domain: tuple[float, ...] | None = None


@dataclass(frozen=True)
class Filters:
    """Settings that apply to sampled particles: changing them does not require sampling again."""

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
        """A key for the cache: sources with different samples have different keys."""
        stamp = stamp_of(self.path)
        return self.path, stamp, None if self.is_packed else self.sampling

    def sample(self) -> meniscus.Frame:
        return meniscus.Frame.load(self.path, **_given(self.used_sampling))

    @property
    def used_sampling(self) -> Sampling:
        """The settings of the sampling; no values are set for a packed frame, which accepts none."""
        return Sampling() if self.is_packed else self.sampling


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
        """A key for the cache: sources with different samples have different keys."""
        return self.digest, len(self.positions), self._used_sampling

    def sample(self) -> meniscus.Frame:
        return meniscus.Frame(self.positions, velocity=self.velocity, **_given(self._used_sampling))

    @property
    def _used_sampling(self) -> Sampling:
        """The settings of the sampling, without settings that apply only to files."""
        return replace(self.sampling, attributes=None, where=None)


@dataclass(frozen=True)
class Request:
    """A request for a surface: the particles, the filters and the solids."""

    source: FromFile | FromPoints
    filters: Filters
    solids: Solids = Solids()

    @property
    def key(self) -> Hashable:
        """A key for the cache: different surfaces have different keys."""
        key = self.source.key, self.filters
        # Without solids, the key must be the same as in older versions, because .blend files store
        # a hash of the key.
        return (*key, self.solids.key) if self.solids.meshes else key

    @property
    def name(self) -> str:
        """A hash of the key, which is stored with the mesh."""
        return hashlib.blake2b(repr(self.key).encode(), digest_size=16).hexdigest()


class Maker:
    """Computes surfaces. Keeps the last sampled frame, so that changed filters do not require sampling again."""

    def __init__(self) -> None:
        self._key: Hashable = None
        self._frame: meniscus.Frame | None = None

    def make(self, request: Request) -> Arrays:
        """Computes the requested surface, and returns its arrays.

        Raises the library's errors.
        """
        key = request.source.key
        if self._frame is None or key != self._key:
            # Free the memory of the last sampled frame before a new one is sampled.
            self._frame = None
            self._frame, self._key = request.source.sample(), key
        up = self._frame.particles_up
        if not request.solids.meshes:
            return Arrays.of(self._frame.surface(**_given(request.filters)), up)
        with tempfile.TemporaryDirectory(prefix="meniscus-") as folder:
            solid = request.solids.written(Path(folder))
            return Arrays.of(self._frame.surface(**_given(request.filters), solid=solid, solid_offset=request.solids.offset), up)

    def forget(self) -> None:
        """Frees the memory of the sampled frame."""
        self._frame, self._key = None, None

"""What a surface depends on: what it is made of and how, which is the key that it is kept by."""

from __future__ import annotations

import hashlib
from collections.abc import Hashable
from dataclasses import dataclass, field, fields, replace
from typing import Any

import meniscus
import numpy as np
import numpy.typing as npt

from .arrays import Arrays
from .sequence import stamp_of

#: Packed frames have cells and a spacing of their own, and no attributes.
PACKED = ".mnf"


@dataclass(frozen=True)
class Sampling:
    """How particles are sampled. What is None is the library's choice."""

    spacing: float | None = None
    cell: float | None = None
    attributes: tuple[str, ...] | None = None
    where: str | None = None
    #: The lowest and the highest corner of a tank.
    domain: tuple[float, ...] | None = None


@dataclass(frozen=True)
class Filters:
    """How a surface is drawn of samples, for which the particles are not needed again."""

    smooth: float | None = None
    smallest_drop: int | None = None
    simplify: float | None = None


def _given(of: Sampling | Filters) -> dict[str, Any]:
    values = {each.name: getattr(of, each.name) for each in fields(of)}
    return {name: value for name, value in values.items() if value is not None}


@dataclass(frozen=True)
class FromFile:
    """The particles of a file, or a packed frame."""

    path: str
    sampling: Sampling

    @property
    def is_packed(self) -> bool:
        return self.path.lower().endswith(PACKED)

    @property
    def key(self) -> Hashable:
        """Changes where the samples would."""
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
        """Changes where the samples would."""
        return self.digest, len(self.positions), self._asked

    def sample(self) -> meniscus.Frame:
        return meniscus.Frame(self.positions, velocity=self.velocity, **_given(self._asked))

    @property
    def _asked(self) -> Sampling:
        """What is of files says nothing of these."""
        return replace(self.sampling, attributes=None, where=None)


@dataclass(frozen=True)
class Request:
    """A surface that is asked for."""

    source: FromFile | FromPoints
    filters: Filters

    @property
    def key(self) -> Hashable:
        """Changes where the surface would."""
        return self.source.key, self.filters

    @property
    def name(self) -> str:
        """The key in few letters, to be kept beside a mesh."""
        return hashlib.blake2b(repr(self.key).encode(), digest_size=16).hexdigest()


class Maker:
    """Makes surfaces, and keeps the samples of the last one, so that other filters need no particles."""

    def __init__(self) -> None:
        self._key: Hashable = None
        self._frame: meniscus.Frame | None = None

    def make(self, request: Request) -> Arrays:
        """The arrays of a surface.

        Raises what the library raises, with its sentences.
        """
        key = request.source.key
        if self._frame is None or key != self._key:
            # The one before makes room first.
            self._frame = None
            self._frame, self._key = request.source.sample(), key
        return Arrays.of(self._frame.surface(**_given(request.filters)))

    @property
    def particles_up(self) -> str | None:
        """The axis that points up in the particles that were sampled last."""
        return self._frame.particles_up if self._frame else None

    def forget(self) -> None:
        """Gives the samples' memory back."""
        self._frame, self._key = None, None

"""Exceptions and warnings: a kind of error each, with the library's sentence."""

from __future__ import annotations

import re

_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


class Error(Exception):
    """Anything that goes wrong between particles and a mesh."""


class InputError(Error, ValueError):
    """A request that makes no sense, or particles that have no surface."""


class FileError(Error, OSError):
    """A file that cannot be read or written."""


class DeviceError(Error, RuntimeError):
    """A device that was asked for, and cannot be used."""


class _Sentence(str):
    """A sentence that equals others which differ from it in numbers only."""

    __slots__ = ()

    def _kind(self) -> str:
        return _NUMBER.sub("#", str.__str__(self))

    def __eq__(self, other: object) -> bool:
        if isinstance(other, _Sentence):
            return self._kind() == other._kind()
        return str.__eq__(self, other)

    def __ne__(self, other: object) -> bool:
        return not self == other

    def __hash__(self) -> int:
        return hash(self._kind())


class MeshWarning(UserWarning):
    """A doubt about a mesh, although there is one.

    By default Python shows a warning once for each line of a program. Warnings of a loop over frames that differ in numbers only are the
    same warning. ``figures`` are those numbers, in their order.
    """

    @property
    def figures(self) -> tuple[float, ...]:
        return tuple(float(number) for number in _NUMBER.findall(super().__str__()))

    def __str__(self) -> str:
        return _Sentence(super().__str__())


for _kind in (Error, InputError, FileError, DeviceError, MeshWarning):
    _kind.__module__ = "meniscus"

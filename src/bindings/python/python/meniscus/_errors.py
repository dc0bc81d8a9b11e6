"""Exceptions and warnings by kind of error, with the library's messages."""

from __future__ import annotations

import re

_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


class Error(Exception):
    """Anything that goes wrong between particles and a mesh."""


class InputError(Error, ValueError):
    """An invalid request, or particles without a surface."""


class FileError(Error, OSError):
    """A file that cannot be read or written."""


class DeviceError(Error, RuntimeError):
    """A requested device that cannot be used."""


class _Sentence(str):
    """A message that equals messages with other numbers."""

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
    """A warning about a mesh.

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

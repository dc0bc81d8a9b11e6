"""Exceptions and warnings, with the library's messages. Each kind of error has a class."""

from __future__ import annotations

import re

_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


class Error(Exception):
    """The base class of all errors of this package."""


class InputError(Error, ValueError):
    """An invalid request, or particles without a surface."""


class FileError(Error, OSError):
    """A file that cannot be read or written."""


class DeviceError(Error, RuntimeError):
    """A requested device that cannot be used."""


class _Sentence(str):
    """A message that compares equal to messages that differ from it only in numbers."""

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

    By default, Python shows equal warnings from the same line of a program only once. In a loop
    over frames, warnings often differ only in their numbers, so these warnings count as equal.
    ``figures`` are the numbers in the message.
    """

    @property
    def figures(self) -> tuple[float, ...]:
        return tuple(float(number) for number in _NUMBER.findall(super().__str__()))

    def __str__(self) -> str:
        return _Sentence(super().__str__())


for _kind in (Error, InputError, FileError, DeviceError, MeshWarning):
    _kind.__module__ = "meniscus"

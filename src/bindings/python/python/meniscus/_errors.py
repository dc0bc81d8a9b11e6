"""Exceptions and warnings, with the library's messages. Each kind of error has a class."""

from __future__ import annotations

import os
import re
from typing import Any, cast

_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


class Error(Exception):
    """The base class of all errors of this package."""


class InputError(Error, ValueError):
    """An invalid request, or particles without a surface."""


class FileError(Error, OSError):
    """A file that cannot be read or written.

    If the operating system reports an error, if an output already exists, or if inputs are missing,
    ``errno`` and ``strerror`` describe the error, and the exception is also an instance of Python's
    class for it, such as ``FileNotFoundError``, ``PermissionError`` or ``FileExistsError``.
    Otherwise, ``errno`` and ``strerror`` are None. ``filename`` is the file or the folder, or None.
    """

    def __str__(self) -> str:
        # OSError.__str__ would return errno, strerror and filename instead of the message.
        return str(self.args[0]) if self.args else ""

    def __reduce__(self) -> tuple[Any, ...]:
        return file_error, (str(self), self.errno, self.filename)


def file_error(message: str, errno: int | None, filename: str | os.PathLike[str] | None) -> FileError:
    """Creates a FileError that is also an instance of Python's class for the system error ``errno``."""
    error = _class_of(OSError if errno is None else type(OSError(errno, "")))(message)
    error.filename = None if filename is None else os.fspath(filename)
    if errno is not None:
        error.errno, error.strerror = errno, os.strerror(errno)
    return error


#: For each class of OSError, the FileError class that also inherits from it.
_classes: dict[type[OSError], type[FileError]] = {OSError: FileError}


def _class_of(of_system: type[OSError]) -> type[FileError]:
    if of_system not in _classes:
        made = type("FileError", (FileError, of_system), {"__module__": "meniscus", "__doc__": FileError.__doc__})
        _classes[of_system] = cast("type[FileError]", made)
    return _classes[of_system]


class DeviceError(Error, RuntimeError):
    """A requested device that cannot be used."""


class _Message(str):
    """A message that compares equal to messages that differ from it only in numbers."""

    __slots__ = ()

    def _kind(self) -> str:
        return _NUMBER.sub("#", str.__str__(self))

    def __eq__(self, other: object) -> bool:
        if isinstance(other, _Message):
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
        return _Message(super().__str__())


for _kind in (Error, InputError, FileError, DeviceError, MeshWarning):
    _kind.__module__ = "meniscus"

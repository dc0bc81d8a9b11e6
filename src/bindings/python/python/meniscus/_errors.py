"""Exceptions and warnings: a kind of error each, with the library's sentence."""


class Error(Exception):
    """Anything that goes wrong between particles and a mesh."""


class InputError(Error, ValueError):
    """A request that makes no sense, or particles that have no surface."""


class FileError(Error, OSError):
    """A file that cannot be read or written."""


class DeviceError(Error, RuntimeError):
    """A device that was asked for, and cannot be used."""


class MeshWarning(UserWarning):
    """A doubt about a mesh, although there is one."""


for _kind in (Error, InputError, FileError, DeviceError, MeshWarning):
    _kind.__module__ = "meniscus"

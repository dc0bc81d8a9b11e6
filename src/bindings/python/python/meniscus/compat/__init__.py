"""Modules with the interfaces of other packages."""

from .. import _conflict

_conflict.require_own_package()

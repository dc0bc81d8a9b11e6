"""Doors for those who call other packages."""

from .. import _conflict

_conflict.require_own_package()

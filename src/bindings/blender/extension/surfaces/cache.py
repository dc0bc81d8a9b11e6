"""A cache with a memory limit, for values that take a long time to compute."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable
from typing import Generic, Protocol, TypeVar


class Sized(Protocol):
    """A value with a known size in memory."""

    @property
    def nbytes(self) -> int: ...


V = TypeVar("V", bound=Sized)


class Cache(Generic[V]):
    """Keeps the most recently used values, up to `bound` bytes. A larger value is never kept."""

    def __init__(self, bound: int) -> None:
        self._values: OrderedDict[Hashable, V] = OrderedDict()
        self._bound = bound
        self.nbytes = 0

    def __len__(self) -> int:
        return len(self._values)

    @property
    def bound(self) -> int:
        return self._bound

    @bound.setter
    def bound(self, to: int) -> None:
        self._bound = to
        self._shrink()

    def get(self, key: Hashable) -> V | None:
        """Returns the value of a key, or None. The value becomes the most recently used one."""
        value = self._values.get(key)
        if value is not None:
            self._values.move_to_end(key)
        return value

    def put(self, key: Hashable, value: V) -> None:
        """Adds a value, and removes the least recently used values until the limit is met."""
        self.drop(key)
        # A value larger than the limit would remove all other values, and then also be removed.
        if value.nbytes <= self._bound:
            self._values[key] = value
            self.nbytes += value.nbytes
            self._shrink()

    def drop(self, key: Hashable) -> None:
        """Removes a value, if it exists."""
        value = self._values.pop(key, None)
        if value is not None:
            self.nbytes -= value.nbytes

    def clear(self) -> None:
        """Removes all values."""
        self._values.clear()
        self.nbytes = 0

    def _shrink(self) -> None:
        while self.nbytes > self._bound:
            _, value = self._values.popitem(last=False)
            self.nbytes -= value.nbytes

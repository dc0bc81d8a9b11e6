"""Values that took long to make, as many as a bound of memory allows."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable
from typing import Generic, Protocol, TypeVar


class Sized(Protocol):
    """Whatever says how much memory it takes."""

    @property
    def nbytes(self) -> int: ...


V = TypeVar("V", bound=Sized)


class Cache(Generic[V]):
    """What was used last, up to so many bytes; a value that alone is larger is not kept."""

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
        """The value, which counts as used."""
        value = self._values.get(key)
        if value is not None:
            self._values.move_to_end(key)
        return value

    def put(self, key: Hashable, value: V) -> None:
        """Keeps a value, in the place of those that were not used for longest."""
        self.drop(key)
        # What does not fit would drive out all others, for nothing.
        if value.nbytes <= self._bound:
            self._values[key] = value
            self.nbytes += value.nbytes
            self._shrink()

    def drop(self, key: Hashable) -> None:
        """Forgets a value, if it is there."""
        value = self._values.pop(key, None)
        if value is not None:
            self.nbytes -= value.nbytes

    def clear(self) -> None:
        """Forgets all."""
        self._values.clear()
        self.nbytes = 0

    def _shrink(self) -> None:
        while self.nbytes > self._bound:
            _, value = self._values.popitem(last=False)
            self.nbytes -= value.nbytes

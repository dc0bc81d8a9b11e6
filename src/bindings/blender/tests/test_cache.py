"""The cache keeps its limit, and removes the least recently used values."""

from __future__ import annotations

import numpy as np
from surfaces.cache import Cache


def kib(count: int) -> np.ndarray:
    return np.zeros(1024 * count, np.uint8)


def test_the_least_recently_used_value_is_removed_first() -> None:
    cache: Cache[np.ndarray] = Cache(3 * 1024)
    for name in "abc":
        cache.put(name, kib(1))
    assert cache.get("a") is not None
    cache.put("d", kib(1))
    assert cache.get("b") is None
    assert all(cache.get(name) is not None for name in "acd")
    assert cache.nbytes == 3 * 1024


def test_a_value_larger_than_the_limit_removes_no_other_value() -> None:
    cache: Cache[np.ndarray] = Cache(2 * 1024)
    cache.put("a", kib(1))
    cache.put("b", kib(3))
    assert cache.get("a") is not None and cache.get("b") is None
    # A value that is too large also removes the old value with the same key.
    cache.put("a", kib(3))
    assert cache.get("a") is None and cache.nbytes == 0


def test_a_replaced_value_counts_once() -> None:
    cache: Cache[np.ndarray] = Cache(10 * 1024)
    cache.put("a", kib(4))
    cache.put("a", kib(5))
    assert (len(cache), cache.nbytes) == (1, 5 * 1024)


def test_a_smaller_limit_applies_immediately() -> None:
    cache: Cache[np.ndarray] = Cache(10 * 1024)
    for name in "abcde":
        cache.put(name, kib(2))
    cache.bound = 5 * 1024
    assert cache.nbytes == 4 * 1024 and cache.get("e") is not None and cache.get("c") is None
    cache.clear()
    assert (len(cache), cache.nbytes) == (0, 0)

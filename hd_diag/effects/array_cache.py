"""Cache of arrays that are slow to compute."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, TypeVar

import numpy.typing as npt

Array = TypeVar("Array", bound=npt.NDArray[Any])


class ArrayCache:
    """Cache that keeps the most recently used arrays, up to `most` bytes."""

    def __init__(self, most: int) -> None:
        self._most, self._size = most, 0
        self._arrays: dict[Hashable, Any] = {}

    def get(self, key: Hashable, compute: Callable[[], Array]) -> Array:
        """Array of this key, computed and stored if it is missing."""
        found: Array
        if key in self._arrays:
            self._arrays[key] = found = self._arrays.pop(key)
            return found
        self._arrays[key] = found = compute()
        self._size += found.nbytes
        while self._size > self._most and len(self._arrays) > 1:
            self._size -= self._arrays.pop(next(iter(self._arrays))).nbytes
        return found

"""Contents of messages side by side, and the records that they make."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Bytes, Integers


class Rows:
    """Messages one after the other.

    Parameters
    ----------
    sizes : ndarray of int64, shape (n,)
        Size of each [byte].
    data : ndarray of uint8
        All of them, as one row; (n, size) where they have one size.
    """

    def __init__(self, sizes: Integers, data: Bytes) -> None:
        self.sizes = sizes
        self._data = data

    @classmethod
    def of(cls, messages: Bytes | Sequence[bytes | bytearray | memoryview]) -> Rows:
        """From an array of shape (n, size), or messages of any size."""
        if isinstance(messages, np.ndarray):
            return cls(np.full(len(messages), messages.shape[1], np.int64), messages)
        sizes = np.fromiter(map(len, messages), np.int64, len(messages))
        data = np.frombuffer(b"".join(messages), np.uint8)
        is_even = bool(sizes.size and sizes[0] and (sizes == sizes[0]).all())
        return cls(sizes, data.reshape(len(sizes), -1) if is_even else data)

    def part(self, begin: int, end: int) -> Rows:
        """Messages from `begin` to before `end`."""
        if self._data.ndim == 2:
            return Rows(self.sizes[begin:end], self._data[begin:end])
        first, last = int(self.sizes[:begin].sum()), int(self.sizes[:end].sum())
        return Rows(self.sizes[begin:end], self._data[first:last])

    def room(self, left: int, head: int) -> int:
        """How many messages with heads of that size fill what is left of a chunk [byte], at least 1."""
        if self._data.ndim == 2:
            return max(1, -(-left // (int(self._data.shape[1]) + head)))
        return 1 + int(np.searchsorted(np.cumsum(self.sizes + head), left))

    def places(self, head: int) -> Integers:
        """Where each begins, with heads of that size before them [byte]."""
        if self._data.ndim == 2:
            return (int(self._data.shape[1]) + head) * np.arange(len(self.sizes), dtype=np.int64)
        ends: Integers = np.cumsum(self.sizes + head)
        return ends - self.sizes - head

    def behind(self, head: np.dtype[Any], fields: Mapping[str, Any]) -> memoryview:
        """Each message behind its head, of which every field has a value for each or one for all."""
        if self._data.ndim == 2:
            block = np.empty(len(self.sizes), _with_data(head, self._data.shape[1]))
            block["data"] = self._data
            _fill(block, fields)
            return memoryview(block.view(np.uint8))
        heads = np.empty(len(self.sizes), head)
        _fill(heads, fields)
        lengths = np.stack((np.full(heads.size, head.itemsize), self.sizes), axis=1).reshape(-1)
        is_head = np.repeat(np.tile([True, False], heads.size), lengths)
        records = np.empty(is_head.size, np.uint8)
        records[is_head], records[~is_head] = heads.view(np.uint8), self._data
        return memoryview(records)


def _fill(block: npt.NDArray[np.void], fields: Mapping[str, Any]) -> None:
    for name, values in fields.items():
        block[name] = values


@functools.lru_cache(maxsize=256)
def _with_data(head: np.dtype[Any], size: int) -> np.dtype[Any]:
    return np.dtype([*head.descr, ("data", "u1", (size,))])

"""Messages side by side in one buffer, their heads as columns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Bytes
from hd_diag.bag.mcap_file import HEAD, MESSAGE


@dataclass(frozen=True)
class Block:
    """Messages in one buffer.

    Attributes
    ----------
    data : ndarray of uint8
        The buffer.
    offset, size : ndarray of int64, shape (n,)
        Place of each message's content in it [byte].
    channel : ndarray of int64, shape (n,)
        Channel numbers.
    log_time, publish_time : ndarray of int64, shape (n,)
        Times [ns].
    """

    data: Bytes
    offset: npt.NDArray[np.int64]
    size: npt.NDArray[np.int64]
    channel: npt.NDArray[np.int64]
    log_time: npt.NDArray[np.int64]
    publish_time: npt.NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.offset)

    def __getitem__(self, rows: Any) -> Block:
        return Block(
            self.data,
            self.offset[rows],
            self.size[rows],
            self.channel[rows],
            self.log_time[rows],
            self.publish_time[rows],
        )


def messages_at(content: bytes, offset: npt.NDArray[np.int64]) -> Block:
    """Messages whose records begin at the offsets.

    Raises
    ------
    ValueError
        Where a record is not a message.
    """
    data = np.frombuffer(content, np.uint8)
    if len(offset) and offset[-1] + MESSAGE.size > len(data):
        raise ValueError("a message has no room for its times")
    heads = np.ascontiguousarray(gather(data, offset, MESSAGE.size)).view(HEAD)[:, 0]
    if len(offset) and int(heads["length"].min()) < MESSAGE.size - 9:
        raise ValueError("a message is too short for its times")
    if len(offset) and max(int(heads["log_time"].max()), int(heads["publish_time"].max())) >= 1 << 63:
        raise ValueError("a message has a time beyond the year 2262")
    return Block(
        data,
        offset + MESSAGE.size,
        heads["length"].astype(np.int64) - (MESSAGE.size - 9),
        heads["channel"].astype(np.int64),
        heads["log_time"].astype(np.int64),
        heads["publish_time"].astype(np.int64),
    )


def gather(data: Bytes, offset: npt.NDArray[np.int64], size: int) -> Bytes:
    """Rows of `size` bytes that begin at the offsets, shape (n, size); a view where evenly spaced."""
    if size == 0 or len(offset) == 0:
        return np.empty((len(offset), size), np.uint8)
    windows = np.lib.stride_tricks.sliding_window_view(data, size)
    step = int(offset[1] - offset[0]) if len(offset) > 1 else 1
    if step > 0 and (np.diff(offset) == step).all():
        return windows[offset[0] : offset[-1] + 1 : step]
    return np.asarray(windows[offset])

"""Finds where a recorder's clock was set back, from the order of messages in a file."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from hd_diag.arrays import Integers, Times
from hd_diag.bag.block import Block

SET_BACK = 300_000_000
"""Least step back of a channel that means the clock [ns]; threads that write out of turn cause less."""

# More steps back in one block mean disorder instead of a clock; the messages are then sorted.
_MOST = 100


class RecorderClock:
    """Detects steps back of the clock in the messages of a file, given in file order.

    A recorder writes the messages of a channel as they arrive. Messages of several channels may be swapped,
    and threads may write blocks of some milliseconds out of turn. If a channel goes back by more than
    `SET_BACK`, the clock was set back. Later messages are then not sorted among earlier ones.
    """

    def __init__(self) -> None:
        self._reach: dict[int, int] = {}  # greatest log time of each channel [ns]

    def stretches(self, block: Block) -> Iterator[Block]:
        """Split a block, which is in file order, at each step back of the clock."""
        bounds = [0, *self.set_back(block.channel, block.log_time), len(block)]
        if len(bounds) == 2:
            yield block
            return
        for begin, end in itertools.pairwise(bounds):
            yield block[begin:end]

    def set_back(self, channel: Integers, log_time: Times) -> list[int]:
        """Rows where the clock was set back, given channels and log times [ns] (n,) in file order."""
        found: list[int] = []
        begin = 0
        while (
            begin < len(channel) and (late := self._first_late(channel[begin:], log_time[begin:])) is not None
        ):
            if len(found) == _MOST:
                return []
            begin += late
            found.append(begin)
            self._reach.clear()
        return found

    def _first_late(self, channel: Integers, log_time: Times) -> int | None:
        """Row of the first message after a step back, or None; updates each channel's greatest log time."""
        first, before = None, dict(self._reach)
        for number in np.unique(channel).tolist():
            rows = np.flatnonzero(channel == number)
            reach = np.maximum.accumulate(log_time[rows])
            reach = np.maximum(reach, self._reach.get(number, reach[0]))
            self._reach[number] = int(reach[-1])
            back = np.flatnonzero(log_time[rows] < reach - SET_BACK)
            if back.size and (first is None or rows[back[0]] < first):
                first = int(rows[back[0]])
        if first is None:
            return None
        # Messages of other channels from after the step may stand right before this row.
        known = max([*before.values(), int(log_time[0])])
        reach = np.maximum(np.maximum.accumulate(log_time[: first + 1]), known)
        early = np.flatnonzero(log_time[: first + 1] >= reach - SET_BACK)
        return int(early[-1]) + 1 if early.size else 0

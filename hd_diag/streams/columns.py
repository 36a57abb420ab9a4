"""Columns of the joint states that arrive. Times: int64 [ns]."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from hd_diag.arrays import Floats, Times

LARGEST_ANGLE = 1e10
"""Beyond it a double does not resolve a microradian, and no joint gets there in a lifetime [rad]."""

LARGEST_TORQUE = 1e6
"""A hundred times what the largest harmonic drives bear [N m]: a larger value is the sender's error."""

BLOCKS = "position", "velocity", "effort"
"""Arrays of a JointState message, with a value for each joint."""

LARGEST_TEMPERATURE = 1e4
"""Greatest magnitude of a measured temperature [degree Celsius]."""


class JointStates(NamedTuple):
    """Messages with the same k joints; n >= 1 rows, one while live.

    `row` (n,) are positions of the messages in their batch, `stamp` (n,) the times of their headers [ns],
    `names` (k,) the joints. Position [rad] or [m], velocity [rad/s] or [m/s] and effort [N m] or [N] are each
    (n, k), or None if the messages have none. A block of another width cannot be assigned to the names.
    `signals` (n, m) are values mapped to joints in other ways, in SI and degree Celsius; their m `keys` are
    those of `hd_diag.streams.signals.key`. `unstamped` if the headers have a stamp of zero.
    """

    row: Times
    stamp: Times
    names: tuple[str, ...]
    frame_id: str
    position: Floats | None
    velocity: Floats | None
    effort: Floats | None
    signals: Floats | None = None
    keys: tuple[str, ...] = ()
    unstamped: bool = False

    @property
    def blocks(self) -> tuple[Floats | None, ...]:
        """Position, velocity, effort, signals."""
        return self[4:8]

    def between(self, low: int, high: int) -> JointStates:
        """Rows at positions from `low` to before `high`, their positions counted from there."""
        rows = slice(*np.searchsorted(self.row, (low, high)).tolist())
        values = [None if column is None else column[rows] for column in self.blocks]
        head = self.row[rows] - low, self.stamp[rows], self.names, self.frame_id
        return JointStates(*head, values[0], values[1], values[2], values[3], self.keys, self.unstamped)

    def misfit(self, number: int) -> str:
        """What is wrong with one of `BLOCKS` if its values do not match the names; empty otherwise."""
        block, count = self.blocks[number], len(self.names)
        if block is None or block.shape[1] == count:
            return ""
        return f"has {block.shape[1]} values of {BLOCKS[number]} for {count} names"

    def stamped(self, received: Times, always: bool) -> list[JointStates]:
        """The messages with times of reception in their batch [ns] for stamps of zero, or for all stamps."""
        if always:
            return [self._replace(stamp=received[self.row])]
        if self.stamp.all():
            return [self]
        missing, found = self.stamp == 0, []
        for rows, is_missing in ((~missing, False), (missing, True)):
            if rows.any():
                values = (None if column is None else column[rows] for column in self.blocks)
                stamp = received[self.row[rows]] if is_missing else self.stamp[rows]
                changed: Any = dict(zip((*BLOCKS, "signals"), values, strict=True))
                found.append(self._replace(row=self.row[rows], stamp=stamp, unstamped=is_missing, **changed))
        return found

"""What arrives and what leaves: columns of joint states and what is computed of them. Times: int64 [ns]."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hd_diag.arrays import Floats, Times

if TYPE_CHECKING:
    from hd_diag.drive import Drive


LARGEST_ANGLE = 1e10
"""Beyond it a double tells no angle to a microradian, and no joint gets there in a lifetime [rad]."""

LARGEST_TORQUE = 1e6
"""A hundred times what the largest harmonic drives bear [N m]: more is a fault of who reports it."""


class JointStates(NamedTuple):
    """Messages with the same joints; n >= 1 rows, one while live.

    Attributes
    ----------
    row : ndarray of int64, shape (n,)
        Positions of the messages in the batch they come from.
    stamp : ndarray of int64, shape (n,)
        Time of the header [ns].
    names : tuple of str
        The k joints.
    frame_id : str
    position, velocity, effort : ndarray, shape (n, k), or None
        [rad] or [m], [rad/s] or [m/s], [N m] or [N]; None where the messages have none.
    """

    row: Times
    stamp: Times
    names: tuple[str, ...]
    frame_id: str
    position: Floats | None
    velocity: Floats | None
    effort: Floats | None

    def part(self, rows: slice) -> JointStates:
        """Some of the rows."""
        values = [None if column is None else column[rows] for column in self[4:]]
        return JointStates(self.row[rows], self.stamp[rows], self.names, self.frame_id, *values)

    def between(self, low: int, high: int) -> JointStates:
        """Rows at positions from `low` to before `high`, their positions counted from there."""
        first, last = np.searchsorted(self.row, (low, high))
        part = self.part(slice(first, last))
        return part._replace(row=part.row - low)


class Angles(NamedTuple):
    """Angles to publish: topic, time of the cause [ns] (n,), stamp [ns] (n,), names (k), values (n, k)."""

    topic: str
    received: Times
    stamp: Times
    names: tuple[str, ...]
    position: Floats
    effort: Floats | None


class Teeth(NamedTuple):
    """Per-tooth values to publish: topic, time of the cause [ns] (n,), values (n, 2, Z_R), flanks (+, -)."""

    topic: str
    received: Times
    values: Floats


class Drawings(NamedTuple):
    """Gears to draw: topic, time of the cause [ns] (n,), and what a drawing shows.

    Attributes
    ----------
    stamp : ndarray of int64, shape (n,)
        [ns]
    joint : str
    drive : Drive
    input_angle : ndarray, shape (n,)
        As reported [rad].
    load : ndarray, shape (n, 2, Z_R)
        Forces on the flanks [N].
    torsion : ndarray, shape (n,)
        [rad]
    full_scale : float
        Force that has the last colour [N].
    """

    topic: str
    received: Times
    stamp: Times
    joint: str
    drive: Drive
    input_angle: Floats
    load: Floats
    torsion: Floats
    full_scale: float


class Status(NamedTuple):
    """Diagnostics of one joint: level 0 (OK), 1 (WARN), 2 (ERROR), one line of text, and stable keys."""

    joint: str
    level: int
    message: str
    values: dict[str, str]

    @property
    def name(self) -> str:
        """As diagnostics call it."""
        return f"hd_diag: {self.joint}"


class Report(NamedTuple):
    """Diagnostics of all joints: topic, time of the cause [ns], header stamp [ns]."""

    topic: str
    received: int
    stamp: int
    statuses: tuple[Status, ...]


Publication = Angles | Teeth | Drawings | Report

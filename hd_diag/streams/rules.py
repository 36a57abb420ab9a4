"""Limits of `alignment`'s rules, and the state of each joint between calls."""

from __future__ import annotations

from enum import IntEnum, IntFlag
from typing import Any

import numpy as np

CLOCK_JUMP = 1_000_000_000
"""A stamp this far behind the last one is a clock set back, not a late sample [ns]."""

PAIRING_GAP = 50_000_000
"""An input angle is interpolated over at most this time [ns]."""

LONGEST_HOLD = 200_000_000
"""A reported torque stands for at most this time [ns]."""

REMEMBERED = 256
"""Input samples kept for output angles that arrive later, and output angles that may wait for an input."""

DRIFT_TIME = 30.0
"""Time after which an integrated velocity has forgotten what it was off its output by [s]."""

NEVER = -(2**62)
"""Before every stamp [ns]."""


class Given(IntFlag):
    """What a row of a joint gives; `NAMED` if the message names the joint, `REFUSED` if it is unreadable.

    `OTHER` is a signal that is not aligned, such as a temperature. `UNSTAMPED` is a row whose stamp was zero:
    the time of reception stands for it.
    """

    INPUT = 1
    OUTPUT = 2
    TORQUE = 4
    SPEED = 8
    NAMED = 16
    REFUSED = 32
    OTHER = 64
    UNSTAMPED = 128


class Reason(IntEnum):
    """Why a row is refused; `OTHER` has a text of its own."""

    OTHER = 0
    NAMELESS = 1
    INPUT = 2
    OUTPUT = 3
    TORQUE = 4
    LATE_INPUT = 5
    LATE_OUTPUT = 6
    UNREADABLE = 7


JOINT = np.dtype(
    [
        *((name, np.int64) for name in ("input_stamp", "output_stamp", "torque_stamp", "heard", "stretch")),
        *((name, np.int64) for name in ("inputs", "first", "waiting", "output_seen")),
        *((name, np.int64) for name in ("samples", "rejected", "unpaired", "clock_jumps", "unstamped")),
        ("by_reception", np.int64),
        *((name, np.int64) for name in ("reason", "reason_late")),
        *((name, np.float64) for name in ("reason_value", "torque", "assumed_torque", "input_factor")),
        *((name, np.float64) for name in ("least_torque", "most_torque")),
        *((name, np.float64) for name in ("angle", "load")),
        ("followed", np.int64),
        *((name, np.float64) for name in ("velocity_ratio", "own", "away", "drift", "rate")),
        *((name, np.float64) for name in ("input_counter", "output_counter")),
    ]
)
"""State of one joint: stamps [ns], when an input was last heard [ns], number of its stream, places in
rings, counters, whether the last stamp is a time of reception, the last refusal, torque reported and
assumed [N m]; factor on reported inputs; least and most of all torques reported [N m]; input
angle and torque of the last sample. Where the input is a velocity: whether the output is known, the ratio
(else 0), output times ratio, how far the integral is off it and how far that drifted [rad], last velocity
[rad/s]. What 16 bits of counts are of input and output, 0 where they do not count [rad]."""

ENCODER = np.dtype(
    [("stretch", np.int64), *((name, np.float64) for name in ("angle", "low", "high", "turns"))]
)
"""An angle as it is reported: in which stream, the last one, least and greatest [rad], whole turns to add."""


def unseen(count: int = 1) -> Any:
    """So many encoders, nothing known about them yet."""
    encoders = np.zeros(count, ENCODER)
    encoders["stretch"] = -1
    return encoders


INPUT = np.dtype([("stamp", np.int64), ("angle", np.float64)])
OUTPUT = np.dtype(
    [("stamp", np.int64), ("torque_stamp", np.int64), ("angle", np.float64), ("torque", np.float64)]
)

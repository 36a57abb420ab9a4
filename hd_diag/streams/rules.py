"""Limits of `alignment`'s rules, and the state of each joint between calls."""

from __future__ import annotations

from enum import IntEnum, IntFlag
from typing import Any

import numpy as np

CLOCK_JUMP = 1_000_000_000
"""A stamp further behind the last one means a clock set back, not a late sample [ns]."""

PAIRING_GAP = 50_000_000
"""An input angle is interpolated over at most this time [ns]."""

LONGEST_HOLD = 200_000_000
"""A reported torque holds for at most this time [ns]."""

REMEMBERED = 256
"""Number of input samples kept for later output angles, and of output angles that may wait for an input."""

DRIFT_TIME = 30.0
"""Time constant with which an integrated velocity returns to its output angle [s]."""

NEVER = -(2**62)
"""Before every stamp [ns]."""


class Given(IntFlag):
    """Values that a row gives of a joint; `NAMED` if the message names it, `REFUSED` if it is unreadable.

    `OTHER` is a signal that is not aligned, such as a temperature. `UNSTAMPED` is a row whose stamp was zero
    and is now the time of reception.
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
    """Why a row is refused; `OTHER` has a text in `Alignment.texts`."""

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
"""State of one joint: last stamps [ns], arrival of the last input (`heard`) [ns], number of its stream,
places in rings, counters, whether the last stamp is a time of reception, the last refusal, reported and
assumed torque [N m], factor on reported inputs, least and greatest reported torque [N m]; input angle [rad]
and torque (`load`) [N m] of the last sample. If the input is a velocity: whether the output is known
(`followed`), the ratio (else 0), output times ratio (`own`), the integral less that (`away`) and its low-pass
that is removed (`drift`) [rad], last velocity [rad/s]. Angle of 16 bits of counts, 0 if not counted [rad]."""

ENCODER = np.dtype(
    [("stretch", np.int64), *((name, np.float64) for name in ("angle", "low", "high", "turns"))]
)
"""State of one encoder: number of its stream, last, least and greatest angle [rad], whole turns to add."""


def unseen(count: int = 1) -> Any:
    """States of `count` encoders of which nothing is known yet."""
    encoders = np.zeros(count, ENCODER)
    encoders["stretch"] = -1
    return encoders


INPUT = np.dtype([("stamp", np.int64), ("angle", np.float64)])
OUTPUT = np.dtype(
    [("stamp", np.int64), ("torque_stamp", np.int64), ("angle", np.float64), ("torque", np.float64)]
)

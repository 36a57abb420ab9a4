"""How good a record is: rate, jitter, gaps, what was taken out, how far it goes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hd_diag.arrays import Floats, Integers
from hd_diag.formatting import number

_GAP_STEPS = 5.5  # a step this many times the usual one is a gap, as the diagnosis takes it
_TURN = 2.0 * np.pi


class Fact(NamedTuple):
    """A name and a value with its unit, in words."""

    name: str
    value: str


def facts(
    time: Floats, input_angle: Floats, torque: Floats | None, ratio: float, bag: Integers
) -> list[Fact]:
    """What stamps [s], angles [rad] and torque [N m], if measured, of a record say, shape (n,) each.

    `bag` says which recording each sample comes from; a step between two of them counts for nothing.
    """
    step = np.diff(time)[np.diff(bag) == 0]
    usual = float(np.median(step))
    near = step[step <= _GAP_STEPS * usual]
    gaps = step[step > _GAP_STEPS * usual]
    off = 1e6 * np.abs(near - usual)
    moved = np.diff(input_angle)[np.diff(bag) == 0]
    way, reach = float(np.abs(moved).sum()), float(np.ptp(input_angle)) / _TURN
    forwards = 100.0 * float(moved[moved > 0.0].sum()) / max(way, 1e-300)
    speed = np.abs(moved[step > 0.0] / step[step > 0.0]) / _TURN
    return [
        Fact("Samples used", f"{time.size:d}"),
        Fact("Sample rate", f"{number(1.0 / usual)} Hz"),
        Fact("Jitter of the stamps", f"{off.mean():.0f} µs mean, {np.percentile(off, 99):.0f} µs at 99 %"),
        Fact("Gaps", f"{gaps.size}, {number(float(gaps.sum()))} s in all" if gaps.size else "none"),
        Fact("Input turns", f"{number(way / _TURN)} in all, over a range of {number(reach)}"),
        Fact("Output range", f"{number(reach / abs(ratio))} turns"),
        Fact("Input speed", f"up to {number(float(np.percentile(speed, 99)))} turns per second"),
        Fact("Ways turned", f"{forwards:.0f} % forwards, {100.0 - forwards:.0f} % back"),
        Fact("Torque", "not measured" if torque is None else _range(torque)),
    ]


def _range(torque: Floats) -> str:
    return f"{number(float(torque.min()))} to {number(float(torque.max()))} N m"

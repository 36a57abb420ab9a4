"""How good a record is: rate, jitter, gaps, what was taken out, how far it goes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Floats
from hd_diag.formatting import number

_GAP_STEPS = 5.5  # a step this many times the usual one is a gap, as the diagnosis takes it
_TURN = 2.0 * np.pi


class Fact(NamedTuple):
    """A name and a value with its unit, in words."""

    name: str
    value: str


def facts(
    time: Floats, input_angle: Floats, torque: Floats | None, ratio: float, bag: npt.NDArray[np.int64]
) -> list[Fact]:
    """What stamps, angles and torque say about a record.

    Parameters
    ----------
    time, input_angle : ndarray, shape (n,)
        [s], [rad], in the order of the record.
    torque : ndarray, shape (n,), or None
        [N m]; None where it was not measured.
    ratio : float
        [-]
    bag : ndarray of int64, shape (n,)
        Which recording each sample comes from.

    Returns
    -------
    list of Fact
    """
    step = np.diff(time)[np.diff(bag) == 0]
    usual = float(np.median(step))
    near = step[step <= _GAP_STEPS * usual]
    gaps = step[step > _GAP_STEPS * usual]
    off = 1e6 * np.abs(near - usual)
    output = input_angle / ratio
    moved = np.diff(input_angle)[np.diff(bag) == 0]
    way, reach = float(np.abs(moved).sum()), float(np.ptp(input_angle))
    speed = np.abs(moved[step > 0.0] / step[step > 0.0]) / _TURN
    return [
        Fact("Samples used", f"{time.size:d}"),
        Fact("Sample rate", f"{number(1.0 / usual)} Hz"),
        Fact("Jitter of the stamps", f"{off.mean():.0f} µs mean, {np.percentile(off, 99):.0f} µs at 99 %"),
        Fact("Gaps", f"{gaps.size}, {number(float(gaps.sum()))} s in all" if gaps.size else "none"),
        Fact("Input turns", f"{number(way / _TURN)} in all, over a range of {number(reach / _TURN)}"),
        Fact("Output range", f"{number(float(np.ptp(output)) / _TURN)} turns"),
        Fact("Input speed", f"up to {number(float(np.percentile(speed, 99)))} turns per second"),
        Fact("Ways turned", _ways(moved)),
        Fact("Torque", "not measured" if torque is None else _range(torque, "N m")),
    ]


def _ways(moved: Floats) -> str:
    """Shares of the way that go forwards and back."""
    share = float(moved[moved > 0.0].sum() / max(float(np.abs(moved).sum()), 1e-300))
    return f"{100.0 * share:.0f} % forwards, {100.0 - 100.0 * share:.0f} % back"


def _range(values: Floats, unit: str) -> str:
    ends = np.array([values.min(), values.max()])
    step = 10.0 ** (
        np.floor(np.log10(max(float(np.abs(ends).max()), 1e-300))) - 2.0
    )  # three digits of the larger
    low, high = (number(float(end)) for end in np.round(ends / step) * step)
    return f"{low} to {high} {unit}"

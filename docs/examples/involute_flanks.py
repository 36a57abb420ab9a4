"""A parameter file of the example drive with involute flanks, given by points.

python docs/examples/involute_flanks.py involute.yaml
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from hd_diag.arrays import Floats

BASE, PITCH = 28.8e-3, 30.8777e-3  # radii [m]: a pressure angle of 21 degrees where teeth and slots meet
LONG_AXIS, DATUM = 30.2584e-3, 29.868e-3  # radii from which heights of tooth and slot are measured [m]


def involute(half_width: float, origin: float, heights: Floats) -> Floats:
    """Half widths (n,) [m] at heights above an origin, from the half width at the pitch radius."""

    def turned(radius: Floats | float) -> Floats:
        pressure = np.arccos(BASE / np.asarray(radius))
        return np.asarray(np.tan(pressure) - pressure)

    angle = np.zeros(heights.size)
    for _ in range(20):
        radius = (origin + heights) / np.cos(angle)
        angle = half_width / PITCH + turned(PITCH) - turned(radius)
    return np.asarray(radius * np.sin(angle))


def points(half_width: float, origin: float, low: float, high: float, count: int) -> list[float]:
    """The x and y of points from root to tip, one after the other [m]."""
    heights = np.linspace(low, high, count)
    return np.stack((heights, involute(half_width, origin, heights)), axis=1).ravel().tolist()


def flanks(count: int = 60) -> dict[str, list[float]]:
    """Points of tooth and slot by their parameters' names."""
    return {
        "flexspline_tooth.points": points(0.150e-3, LONG_AXIS, 0.4e-3, 0.8519e-3, count),
        "circular_spline_slot.points": points(0.153e-3, DATUM, 0.8e-3, 1.3e-3, count),
    }


if __name__ == "__main__":
    lines = ["hd_diag:", "  ros__parameters:", "    joints: [joint_1]", "    joint_1:"]
    lines += [
        f"      {name}: [{', '.join(f'{value:.9g}' for value in own)}]" for name, own in flanks().items()
    ]
    Path(sys.argv[1]).write_text("\n".join(lines) + "\n")

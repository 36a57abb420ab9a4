"""What sensors make of an angle: discs off their shaft, uneven quadrature signals."""

from __future__ import annotations

import numpy as np

from challenge.clearances import Array


def off_centre(angle: Array, eccentricity: float, direction: float) -> Array:
    """Reading [rad] of one head over a disc whose centre is off the shaft, a fraction of the head's radius.

    The head sees the disc's angle at its own place: that of the line from the disc's centre to the head.
    """
    centre = angle + direction
    line = np.arctan2(-eccentricity * np.sin(centre), 1 - eccentricity * np.cos(centre))
    return np.asarray(angle - line, dtype=np.float64)


def quadrature(angle: Array, lines: int, offset: float, phase: float, gain: float = 0.0) -> Array:
    """Reading [rad] from sine and cosine tracks with offsets and unequal gains (fractions of a track)."""
    electrical = lines * angle
    c = (1 + gain) * np.cos(electrical) + offset * np.cos(phase)
    s = np.sin(electrical) + offset * np.sin(phase)
    return np.asarray(angle + np.angle((c + 1j * s) * np.exp(-1j * electrical)) / lines, dtype=np.float64)


def swung_arm(angle: Array, offset: float, direction: float) -> Array:
    """Angle [rad] of an arm whose pivot circles with the shaft by an offset, as a fraction of its length."""
    return np.asarray(angle + np.arcsin(offset * np.sin(angle - direction)), dtype=np.float64)

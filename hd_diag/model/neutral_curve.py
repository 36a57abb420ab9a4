"""Neutral layer of the flexspline on an elliptical wave generator: inextensible, known by its arc length."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from hd_diag.arrays import Floats

# Series over a turn converge like (1 - b / a)^k or faster; 64 samples leave them at rounding error for
# semi-axes up to 20 % apart, far more than a flexspline bears.
_SAMPLES = 64
_U = np.pi * np.arange(_SAMPLES) / _SAMPLES
_STEPS = 6  # each squares an error that begins below 0.06 rad
_ROUNDING = 2e-16  # [rad]; smaller harmonics are rounding error of the transform


@dataclass(frozen=True)
class NeutralCurve:
    """Ellipse with exact arc length, in the wave generator's frame (x along the long axis).

    Attributes
    ----------
    semi_major, semi_minor : float
        Semi-axes [m].
    radius : float
        R_b, radius of the circle with the same perimeter [m].
    harmonics : ndarray, shape (k,)
        Coefficients c_k of ``t(u) = u + sum c_k sin 2ku``, t the ellipse's parameter, u = arc length / R_b;
        read-only, for curves are kept and shared.

    Notes
    -----
    Inextensible layer: Dong et al. (2019), eq. (1), ``l_F = l_f``.
    """

    semi_major: float
    semi_minor: float
    radius: float
    harmonics: Floats


@functools.lru_cache(maxsize=64)
def neutral_curve(semi_major: float, semi_minor: float) -> NeutralCurve:
    """Neutral curve on an ellipse of semi-axes semi_major >= semi_minor > 0 [m].

    Raises ValueError if the axes are not in this order, or more than 20 % apart.
    """
    if not semi_major >= semi_minor > 0.8 * semi_major:
        raise ValueError(
            f"neutral curve: semi_major ({semi_major:.6g} m) must be at least semi_minor "
            f"({semi_minor:.6g} m), and by no more than 20 %"
        )
    multiples = 2.0 * np.arange(1, _SAMPLES // 2)
    speed = _speed(semi_major, semi_minor)
    radius = float(speed[0])
    arcs = 2.0 * speed[1:-1] / (radius * multiples)  # of the arc length over R_b: t + sum arcs sin 2kt
    t = _U.copy()
    for _ in range(_STEPS):  # Newton
        angles = np.multiply.outer(t, multiples)
        t -= (t - _U + np.sin(angles) @ arcs) / (1.0 + np.cos(angles) @ (multiples * arcs))
    spectrum = -np.fft.rfft(t - _U).imag[1:] * 2.0 / _SAMPLES
    kept = int(np.max(np.nonzero(np.abs(spectrum) > _ROUNDING)[0], initial=0)) + 1
    harmonics = spectrum[:kept].copy()
    harmonics.flags.writeable = False
    return NeutralCurve(semi_major, semi_minor, radius, harmonics)


def mean_radius(semi_major: float, semi_minor: float) -> float:
    """R_b of an ellipse [m], as in its `NeutralCurve`."""
    return float(_speed(semi_major, semi_minor)[0])


def _speed(semi_major: float, semi_minor: float) -> Floats:
    """Harmonics of the arc length's change with the ellipse's parameter [m]; the first is its mean."""
    speed = np.hypot(semi_major * np.sin(_U), semi_minor * np.cos(_U))
    return np.asarray(np.fft.rfft(speed).real / _SAMPLES)


def tooth_axes(curve: NeutralCurve, u: Floats) -> tuple[Floats, Floats, Floats]:
    """Direction of the tooth axes (the curve's normals) and the curve's centre seen from the teeth.

    Parameters
    ----------
    curve : NeutralCurve
    u : ndarray
        Arc length from the long axis over R_b [rad].

    Returns
    -------
    angle : ndarray
        Direction of the tooth axis from the long axis [rad], same turn as u.
    height, offset : ndarray
        Components of the foot point along the axis and counter-clockwise across it [m].
    """
    a, b = curve.semi_major, curve.semi_minor
    cosine, later, last = 2.0 * np.cos(2.0 * u), np.zeros_like(u), np.zeros_like(u)
    for coefficient in curve.harmonics[::-1]:  # Clenshaw's recurrence
        later, last = last, coefficient + cosine * last - later
    t = u + last * np.sin(2.0 * u)  # the ellipse's parameter
    cos_t, sin_t = np.cos(t), np.sin(t)
    normal_x, normal_y = b * cos_t, a * sin_t
    length = np.sqrt(normal_x * normal_x + normal_y * normal_y)
    # t and the normal's angle differ by less than a quarter turn: this difference keeps t's own turn.
    angle = t + np.arctan2((a - b) * sin_t * cos_t, b * cos_t * cos_t + a * sin_t * sin_t)
    return angle, a * b / length, -(a * a - b * b) * sin_t * cos_t / length

"""Neutral layer of the flexspline: an inextensible convex curve with two lobes, given by its arc length.

The support function p(mu) defines a convex curve: it is the distance of the tangent with normal direction mu.
With two equal lobes ``p(mu) = R_b + sum c_k cos 2k mu``. The axis of a tooth is the normal. The foot of the
tooth is at ``h = p(mu)`` along this axis and at ``q = p'(mu)`` across it. The arc from the long axis is
``s(mu) = R_b mu + sum c_k (1 - 4k^2) / (2k) sin 2k mu``. The perimeter is 2 pi R_b for any c_k.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np

from hd_diag.arrays import Floats

MOST_HARMONICS = 32
"""Most harmonics of a curve. At ends of the cam's forces c_k ~ k^-4, and the rest turns no tooth 1e-6 rad."""

_SAMPLES = 256  # over half a turn
_U = np.pi * np.arange(_SAMPLES) / _SAMPLES
_STEPS = 40  # most Newton iterations; a gear needs four
_ROUNDING = 2e-15  # [rad] or share of the radius; smaller harmonics are rounding error of the transform
_MOST_TURNED = 0.2  # rotation of a tooth axis from a circle's [rad]: limit of the kernels' sine series


@dataclass(frozen=True)
class NeutralCurve:
    """Curve in the wave generator's frame (x along the long axis).

    Attributes
    ----------
    radius : float
        R_b, radius of the circle with the same perimeter [m].
    harmonics : tuple of float
        c_1, c_2, ... of the support function [m].
    series : ndarray, shape (3, k)
        Fourier series in the arc u = s / R_b, k from 0. Rows: ``mu - u`` in sin 2ku [rad], q in sin 2ku [m],
        h in cos 2ku [m]. Read-only, because curves are cached and shared.

    Notes
    -----
    Inextensible layer: Dong et al. (2019), eq. (1), ``l_F = l_f``.
    """

    radius: float
    harmonics: tuple[float, ...]
    series: Floats

    @property
    def semi_major(self) -> float:
        """Distance from the centre to the curve along the long axis [m]."""
        return self.radius + math.fsum(self.harmonics)

    @property
    def semi_minor(self) -> float:
        """Distance from the centre to the curve along the short axis [m]."""
        return self.radius + math.fsum((-1) ** k * c for k, c in enumerate(self.harmonics, 1))

    def deformed(self, factor: float) -> NeutralCurve:
        """The same layer with its deformation multiplied by `factor`, to first order."""
        return neutral_curve(self.radius, tuple(factor * c for c in self.harmonics))


@functools.lru_cache(maxsize=256)
def neutral_curve(radius: float, harmonics: tuple[float, ...]) -> NeutralCurve:
    """Neutral curve of a radius R_b [m] and the harmonics c_1, c_2, ... of its support function [m].

    Raises ValueError if the curve is not convex, is shorter along its long axis than across it, or is far
    from a circle.
    """
    c: Floats = np.array(harmonics) / radius
    order: Floats = 2.0 * np.arange(1, len(harmonics) + 1, dtype=np.float64)
    cosines, sines = (wave(np.multiply.outer(_U, order)) for wave in (np.cos, np.sin))
    bend = 1.0 + cosines @ (c * (1.0 - order**2))
    if not bend.min() > 0.0:
        where = math.degrees(_U[np.argmin(bend)])
        raise ValueError(
            f"neutral curve: not convex; its radius of curvature is {radius * bend.min():.3g} m at "
            f"{where:.0f} degrees from the long axis: deform it less"
        )
    if not c[::2].sum() >= -_ROUNDING:
        raise ValueError("neutral curve: shorter along its long axis than across it")
    arcs = c * (1.0 - order**2) / order
    if not np.abs(sines @ arcs).max() < _MOST_TURNED:
        raise ValueError(
            f"neutral curve: it turns tooth axes by {np.abs(sines @ arcs).max():.3g} rad against those of a "
            f"circle, {_MOST_TURNED} or more: deform it less"
        )
    return NeutralCurve(radius, harmonics, _series(radius, c, order, arcs))


def _series(radius: float, c: Floats, order: Floats, arcs: Floats) -> Floats:
    """Series of a `NeutralCurve`; harmonics `c` and `arcs` are over R_b [-]."""
    mu = _U.copy()
    for _ in range(_STEPS):  # the curve is convex, so the slope is never zero
        angles = np.multiply.outer(mu, order)
        step = (mu - _U + np.sin(angles) @ arcs) / (1.0 + np.cos(angles) @ (arcs * order))
        mu -= step
        if np.abs(step).max() < _ROUNDING:
            break
    angles = np.multiply.outer(mu, order)
    values = np.stack((mu - _U, -np.sin(angles) @ (order * c), np.cos(angles) @ c))
    spectrum = np.fft.rfft(values)[:, : MOST_HARMONICS + 1] * (2.0 / _SAMPLES)
    found = np.vstack((-spectrum[:2].imag, spectrum[2].real))
    found[2, 0] *= 0.5
    used = np.flatnonzero((np.abs(found) > _ROUNDING).any(axis=0))
    found = found[:, : int(used[-1]) + 1 if used.size else 2].copy()
    found[2, 0] += 1.0
    found[1:] *= radius
    found.flags.writeable = False
    return found


def tooth_axes(curve: NeutralCurve, u: Floats) -> tuple[Floats, Floats, Floats]:
    """Direction of the tooth axes (the curve's normals), and the foot points of the teeth.

    Parameters
    ----------
    curve : NeutralCurve
    u : ndarray
        Arc length from the long axis over R_b [rad].

    Returns
    -------
    angle : ndarray
        Direction of the tooth axis from the long axis [rad], in the same turn as u.
    height, offset : ndarray
        Components of the foot point along the axis and counter-clockwise across it [m].
    """
    cosine = 2.0 * np.cos(2.0 * u)
    later, last = np.zeros((2, 3, *np.shape(u)))
    for coefficients in curve.series[:, :0:-1].T:  # Clenshaw's recurrence
        later, last = last, coefficients.reshape(3, *[1] * np.ndim(u)) + cosine * last - later
    sine = np.sin(2.0 * u)
    return u + last[0] * sine, curve.series[2, 0] + 0.5 * cosine * last[2] - later[2], last[1] * sine

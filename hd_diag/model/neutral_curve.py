"""Neutral layer of the flexspline, a convex curve with two lobes, inextensible: known by its arc length.

A convex curve is its support function p(mu), the distance of the tangent whose normal has the direction mu.
With two equal lobes ``p(mu) = R_b + sum c_k cos 2k mu``. The foot of a tooth is at ``h = p(mu)`` along its
axis, which is the normal, and at ``q = p'(mu)`` across it; the arc from the long axis is ``s(mu) = R_b mu +
sum c_k (1 - 4k^2) / (2k) sin 2k mu``. Whatever the c_k, the perimeter is 2 pi R_b.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np

from hd_diag.arrays import Floats

MOST_HARMONICS = 32
"""Of a curve. Where a cam's forces end, c_k falls like k^-4: those beyond turn no tooth by 1e-6 rad."""

_SAMPLES = 256  # of half a turn
_U = np.pi * np.arange(_SAMPLES) / _SAMPLES
_STEPS = 40  # of Newton's iteration; of a gear it needs four
_ROUNDING = 2e-15  # [rad], or of the radius; smaller harmonics are rounding error of the transform
_MOST_TURNED = 0.2  # tooth axis from where a circle has it [rad]; kernels have their sine by a short series


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
        Of the arc u = s / R_b: ``mu - u`` = sum of the first times sin 2ku [rad], q of the second times sin
        2ku, h of the third times cos 2ku [m], k from 0; read-only, for curves are kept and shared.

    Notes
    -----
    Inextensible layer: Dong et al. (2019), eq. (1), ``l_F = l_f``.
    """

    radius: float
    harmonics: tuple[float, ...]
    series: Floats

    @property
    def semi_major(self) -> float:
        """Where the curve meets its long axis, from its centre [m]."""
        return self.radius + math.fsum(self.harmonics)

    @property
    def semi_minor(self) -> float:
        """Where the curve meets its short axis, from its centre [m]."""
        return self.radius + math.fsum((-1) ** k * c for k, c in enumerate(self.harmonics, 1))

    def deformed(self, factor: float) -> NeutralCurve:
        """The same layer deformed so many times as far, to first order."""
        return neutral_curve(self.radius, tuple(factor * c for c in self.harmonics))


@functools.lru_cache(maxsize=256)
def neutral_curve(radius: float, harmonics: tuple[float, ...]) -> NeutralCurve:
    """Neutral curve of a radius R_b [m] and the harmonics c_1, c_2, ... of its support function [m].

    Raises ValueError if it is not convex, not longest along its long axis, or far from a circle.
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
    """As of `NeutralCurve`, from harmonics and arcs over R_b."""
    mu = _U.copy()
    for _ in range(_STEPS):  # the slope is never zero, for the curve is convex
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
    cosine = 2.0 * np.cos(2.0 * u)
    later, last = np.zeros((2, 3, *np.shape(u)))
    for coefficients in curve.series[:, :0:-1].T:  # Clenshaw's recurrence
        later, last = last, coefficients.reshape(3, *[1] * np.ndim(u)) + cosine * last - later
    sine = np.sin(2.0 * u)
    return u + last[0] * sine, curve.series[2, 0] + 0.5 * cosine * last[2] - later[2], last[1] * sine

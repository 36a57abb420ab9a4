"""Cams of wave generators: each gives the neutral curve's radius and the harmonics of its support function.

Some cams are given by the radial displacement w(phi) of a ring. The ring does not stretch, so its points
also move tangentially by v, with ``v' = -w``. The displaced points give the normals and the support function.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.model.neutral_curve import MOST_HARMONICS, NeutralCurve, neutral_curve

_SAMPLES = 1024  # over half a turn
_PHI = np.pi * np.arange(_SAMPLES) / _SAMPLES
_LEAST = 1e-17  # [m]; smaller harmonics are rounding error
_MOST_FLAT = 0.8  # least ratio of short to long axis of an ellipse [-]
_CONTACT = (1e-6, 1.56)  # bounds of the angle where a disc's contact ends [rad]
_HALVINGS = 60
_FORCES = 200  # harmonics of the four forces' displacement; they fall like n^-4
_FITTED = 10  # most harmonics fitted to a measured cam
_PER_HARMONIC = 4  # least number of points per harmonic
_FIT_STEPS = 30
_CLOSE = 1e-15  # step at which the fit has converged [m]


@dataclass(frozen=True)
class Ellipse:
    """The neutral layer is an ellipse of semi-axes [m]."""

    semi_major: float
    semi_minor: float

    def support(self) -> tuple[float, Floats]:
        """R_b and c_1, c_2, ... [m]; ValueError unless 0.8 semi_major < semi_minor <= semi_major."""
        if not self.semi_major >= self.semi_minor > _MOST_FLAT * self.semi_major:
            raise ValueError(
                f"neutral curve: semi_major ({self.semi_major:.6g} m) must be at least semi_minor "
                f"({self.semi_minor:.6g} m), and by no more than 20 %"
            )
        return _harmonics(np.hypot(self.semi_major * np.cos(_PHI), self.semi_minor * np.sin(_PHI)))


@dataclass(frozen=True)
class Cosine:
    """A ring of given radius, displaced radially by ``w = w0 cos 2 phi``; w0 is the deformation [m]."""

    radius: float
    deformation: float

    def support(self) -> tuple[float, Floats]:
        """R_b and c_1, c_2, ... [m]."""
        return _of_ring(self.radius, self.deformation, np.array([1.0]))


@dataclass(frozen=True)
class FourForces:
    """Four radial forces bend a ring; they act at plus and minus `angle` from the long axis [rad].

    The deformation is w on the long axis [m].

    Notes
    -----
    ``w ~ sum cos(n angle) cos(n phi) / (n^2 - 1)^2`` over even n.
    """

    radius: float
    deformation: float
    angle: float

    def support(self) -> tuple[float, Floats]:
        """R_b and c_1, c_2, ... [m]."""
        if not 0.0 <= self.angle < 0.25 * np.pi:
            raise ValueError(
                f"neutral curve: angle ({self.angle:g} rad) must be from 0 to less than pi / 4, where four "
                "forces no longer press the lobes out"
            )
        n = 2.0 * np.arange(1, _FORCES + 1)
        return _of_ring(self.radius, self.deformation, np.cos(n * self.angle) / (n**2 - 1.0) ** 2)


@dataclass(frozen=True)
class TwoDiscs:
    """A ring on two discs, whose centres lie `disc_offset` from the middle; it is free between them [m].

    `disc_radius` is the radius of the neutral layer where it lies on a disc.

    Notes
    -----
    The radius of curvature is p + p''. On a disc it is the disc's; the free ring is bent by one force and has
    ``C + D cos(pi / 2 - mu)``. p, p' and p'' are continuous where the contact ends. The mean of p is R_b.
    """

    radius: float
    disc_radius: float
    disc_offset: float

    def support(self) -> tuple[float, Floats]:
        """R_b and c_1, c_2, ... [m]."""
        if not 0.0 < self.disc_radius < self.radius < self.disc_radius + self.disc_offset:
            raise ValueError(
                f"neutral curve: disc_radius ({self.disc_radius:.6g} m) must be less than radius "
                f"({self.radius:.6g} m), and with disc_offset ({self.disc_offset:.6g} m) more"
            )
        end, last = _CONTACT
        if self._excess(end)[0] * self._excess(last)[0] > 0.0:
            raise ValueError(
                f"neutral curve: discs of disc_radius {self.disc_radius:.6g} m at disc_offset "
                f"{self.disc_offset:.6g} m do not bear a ring of radius {self.radius:.6g} m along an arc"
            )
        side = self._excess(end)[0]
        for _ in range(_HALVINGS):
            trial = 0.5 * (end + last)
            end, last = (trial, last) if self._excess(trial)[0] * side > 0.0 else (end, trial)
        c, d, f = self._excess(end)[1]
        lean = np.abs(0.5 * np.pi - _PHI)  # angle from the short axis
        free = c + 0.5 * d * lean * np.sin(lean) + f * np.cos(lean)
        on_disc = self.disc_radius + self.disc_offset * np.sin(lean)
        return self.radius, _harmonics(np.where(lean > 0.5 * np.pi - end, on_disc, free))[1]

    def _excess(self, end: float) -> tuple[float, Floats]:
        """Mean p less the radius if discs bear up to angle `end`, and C, D, F of the free part [m]."""
        lean = 0.5 * np.pi - end
        sine, cosine = math.sin(lean), math.cos(lean)
        rows = np.array(
            [
                [1.0, 0.5 * lean * sine, cosine],
                [0.0, 0.5 * (sine + lean * cosine), -sine],
                [1.0, cosine, 0.0],
            ]
        )
        given = [self.disc_radius + self.disc_offset * sine, self.disc_offset * cosine, self.disc_radius]
        c, d, f = np.linalg.solve(rows, np.array(given))
        arc = self.disc_radius * end + self.disc_offset * math.sin(end)
        free = c * lean + 0.5 * d * (sine - lean * cosine) + f * sine
        return float((arc + free) / (0.5 * np.pi) - self.radius), np.array([c, d, f])


@dataclass(frozen=True)
class Points:
    """Points of the cam or a parallel layer: alternately angle from the long axis [rad] and radius [m].

    The neutral layer lies `offset` further out [m].
    """

    points: tuple[float, ...]
    offset: float = 0.0

    def support(self) -> tuple[float, Floats]:
        """R_b and c_1, c_2, ... [m] of the best fit."""
        radius, harmonics, _ = self._fitted()
        return radius + self.offset, harmonics

    @property
    def residual(self) -> tuple[float, float]:
        """Distance of the points from the fitted curve: rms and largest [m]."""
        away = self._fitted()[2]
        return float(np.sqrt(np.mean(away**2))), float(np.abs(away).max())

    def _fitted(self) -> tuple[float, Floats, Floats]:
        """R_b of the points' curve and its harmonics [m], and the points' distances from it [m].

        Notes
        -----
        A point's distance from a convex curve is ``P . n(mu) - p(mu)`` at the mu where it is stationary. Its
        derivative by c_k is ``-cos 2k mu``. The fit also moves the points' centre to that of the curve.
        """
        angle, distance = self._checked()
        orders = 2.0 * np.arange(min(_FITTED, angle.size // _PER_HARMONIC) + 1)
        values, center = np.zeros(orders.size), 0.0j
        values[0], mu = distance.mean(), angle.copy()
        for _ in range(_FIT_STEPS):
            point = distance * np.exp(1j * angle) - center
            seen = point * np.exp(-1j * mu)
            waves, sines = np.cos(np.multiply.outer(mu, orders)), np.sin(np.multiply.outer(mu, orders))
            slope = seen.imag + sines @ (orders * values)
            mu = mu + slope / (seen.real - waves @ (orders**2 * values))
            away = (point * np.exp(-1j * mu)).real - np.cos(np.multiply.outer(mu, orders)) @ values
            columns = np.column_stack((np.cos(np.multiply.outer(mu, orders)), np.cos(mu), np.sin(mu)))
            step = np.linalg.lstsq(columns, away, rcond=None)[0]
            values, center = values + step[:-2], center + complex(*step[-2:])
            if np.abs(step).max() < _CLOSE:
                break
        return float(values[0]), values[1:], away

    def _checked(self) -> tuple[Floats, Floats]:
        given = np.array(self.points)
        if given.size % 2 or given.size < 4 * _PER_HARMONIC or not np.isfinite(given).all():
            raise ValueError(
                f"neutral curve: points must be {2 * _PER_HARMONIC} pairs of angle [rad] and radius [m] or "
                f"more, not {given.size} numbers"
            )
        angle, distance = given[::2], given[1::2]
        around = np.sort(np.mod(angle, np.pi))
        gap = float(np.diff(around, append=around[0] + np.pi).max())
        if not (distance > 0.0).all():
            raise ValueError("neutral curve: every radius of points must be positive [m]")
        if gap > 0.25 * np.pi:
            raise ValueError(
                f"neutral curve: points leave {gap:.3g} rad of half a turn empty; they must go around it"
            )
        return angle, distance


Cam = Ellipse | Cosine | FourForces | TwoDiscs | Points
"""All cam shapes."""

CAMS: dict[str, type[Cam]] = {
    "ellipse": Ellipse,
    "cosine": Cosine,
    "four_forces": FourForces,
    "two_discs": TwoDiscs,
    "points": Points,
}
"""Cams by their names in parameter files."""


@functools.lru_cache(maxsize=64)
def curve_on(cam: Cam) -> NeutralCurve:
    """Neutral curve on a cam; raises ValueError with a one-line reason if there is none."""
    radius, harmonics = cam.support()
    if not (np.isfinite(radius) and radius > 0.0 and np.isfinite(harmonics).all()):
        raise ValueError(f"neutral curve: radius ({radius:g} m) must be positive, and every length finite")
    return neutral_curve(float(radius), tuple(harmonics.tolist()))


def _of_ring(radius: float, deformation: float, shape: Floats) -> tuple[float, Floats]:
    """R_b and harmonics of a ring displaced by ``sum shape cos n phi``, n even, with w(0) = deformation."""
    if not (radius > 0.0 and 0.0 <= deformation < radius):
        raise ValueError(
            f"neutral curve: deformation ({deformation:g} m) must be from 0 to less than radius "
            f"({radius:g} m)"
        )
    n, size = 2.0 * np.arange(1, shape.size + 1), deformation / shape.sum() * shape
    angles = np.multiply.outer(_PHI, n)
    cosines, sines = np.cos(angles), np.sin(angles)
    point = radius + cosines @ size - 1j * (sines @ (size / n))  # frame of phi: w + R radial, v tangential
    # Derivative in the same frame: the tangent; the normal is a quarter turn behind it.
    along = 1j * point - sines @ (n * size) - 1j * (cosines @ size)
    normal = -1j * along / np.abs(along)
    mu, p = _PHI + np.angle(normal), (point * np.conj(normal)).real
    order = 2.0 * np.arange(1, MOST_HARMONICS + 1)
    waves = np.cos(np.multiply.outer(mu, order)) * (1.0 + _slope(mu - _PHI))[:, None]
    return radius, _kept(2.0 * (p @ waves) / _SAMPLES)


def _slope(values: Floats) -> Floats:
    """Derivative by phi of values sampled over half a turn, which is their period."""
    spectrum = np.fft.rfft(values)
    return np.asarray(np.fft.irfft(2j * np.arange(spectrum.size) * spectrum, values.size))


def _harmonics(p: Floats) -> tuple[float, Floats]:
    """R_b and c_1, c_2, ... of a support function sampled at the directions `_PHI` [m]."""
    spectrum = np.fft.rfft(p).real / _SAMPLES
    return float(spectrum[0]), _kept(2.0 * spectrum[1 : MOST_HARMONICS + 1])


def _kept(harmonics: Floats) -> Floats:
    used = np.flatnonzero(np.abs(harmonics) > _LEAST)
    return harmonics[: int(used[-1]) + 1 if used.size else 1]

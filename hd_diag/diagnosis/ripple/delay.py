"""Delay of the torque against the angle, which shifts a line's phase in proportion to order and speed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import special

from hd_diag.arrays import Complexes, Floats, Integers
from hd_diag.diagnosis.noise import bounds
from hd_diag.diagnosis.record import GAP_STEPS, segments
from hd_diag.diagnosis.ripple.lines import BESIDE, FALSE_ALARM
from hd_diag.diagnosis.ripple.windows import TURN, TURNS, Windows

LONGEST = 0.05
"""Largest delay in the search, of either sign [s]."""

_PHASE = 0.25  # step of the search at the highest order and speed [rad]
_MOST_WINDOWS = 1000  # in the search
_STANDS_OUT = 3.0  # least mean of a line in the median part, in deviations
_STDS = 3.0  # least delay, in standard deviations


class Delay(NamedTuple):
    """Delay of the torque, positive if late, and its standard deviation [s]."""

    value: float
    std: float


class _Wave(NamedTuple):
    """Amplitudes (s,) of windows at an order per turn of the input; their speeds [rad/s] and part numbers."""

    order: float
    values: Complexes
    speed: Floats
    part: Integers

    def turned(self, delay: float) -> Complexes:
        """Amplitudes without the delay (s,)."""
        return np.asarray(self.values * np.exp(1j * self.order * self.speed * delay))

    def mean(self, delay: float) -> Complexes:
        """Mean of the turned amplitudes in each window's direction (s,)."""
        turned, ahead = self.turned(delay), self.speed > 0.0
        each = [turned[ahead == way].mean() if (ahead == way).any() else 0.0 for way in (False, True)]
        return np.where(ahead, each[1], each[0])

    def likelihood(self, delay: float) -> float:
        """Log likelihood, up to a constant, of one line in all windows, with one phase per direction."""
        rest = self.turned(delay) - self.mean(delay)
        return -self.values.size * float(np.log(np.mean(np.abs(rest) ** 2) + 1e-300))


def found_delay(at: Windows, multiples: Sequence[float], shift: float) -> Delay | None:
    """Delay from all lines and recordings together; None if there is none, or if it is not proved.

    The lines are at multiples of the input's turn, as seen from the housing and, with a shift per multiple,
    from the output. A delay is proved if it raises the likelihood of the windows enough, and if it aligns
    more phases than a single number could by chance. The phases are those of recordings, or of the runs of
    a single recording.
    """
    waves = [wave for one in multiples for wave in _waves(at, one, shift) if wave.values.size > 2]
    if not waves:
        return None
    speeds = np.concatenate([wave.speed for wave in waves])
    highest = max(wave.order for wave in waves)
    grid = np.arange(-LONGEST, LONGEST, _PHASE / (highest * np.abs(speeds).max()))
    trials = 1.0 + 2.0 * LONGEST * highest * float(np.ptp(np.abs(speeds))) / TURN
    pairs = [waves[i : i + 2] for i in range(0, len(waves), 2)]

    def likelihood(delay: float) -> float:
        return sum(max(wave.likelihood(delay) for wave in pair) for pair in pairs)

    best = grid[int(np.argmax([likelihood(one) for one in grid]))]
    fine = best + np.linspace(-1.0, 1.0, 81) * (grid[1] - grid[0])
    value = float(fine[int(np.argmax([likelihood(one) for one in fine]))])
    asked = likelihood(value) - likelihood(0.0) > np.log(trials / FALSE_ALARM)
    kept = [max(pair, key=lambda wave: wave.likelihood(value)) for pair in pairs]
    chance, std = _chance([wave for wave in kept if _stands_out(wave, value)], value)
    proved = asked and trials * chance < FALSE_ALARM and abs(value) > _STDS * std
    return Delay(value, std) if proved else None


def late(time: Floats, angle: Floats, record: Integers, delay: float) -> Floats:
    """The angle a `delay` [s] before each sample (n,), within stretches without a gap."""
    found = angle.copy()
    for begin, end in bounds(segments(time, record, GAP_STEPS)):
        own = slice(begin, end)
        found[own] = np.interp(time[own] - delay, time[own], angle[own])
    return found


def _waves(at: Windows, multiple: float, shift: float) -> list[_Wave]:
    """Two waves at a multiple of the input's turn: one seen from the housing, one from the output."""
    at = at.select(at.highest >= multiple + BESIDE[1] / TURNS)
    at = at.select(
        np.unique(np.linspace(0, max(at.size - 1, 0), min(at.size, _MOST_WINDOWS)).astype(np.int64))
    )
    part = at.run if np.unique(at.record).size < 2 else 2 * at.record + (at.direction > 0.0)
    values = at.amplitudes(np.array([multiple]))[:, 0]
    moved = np.exp(-1j * multiple * shift * at.middle)
    return [_Wave(multiple, one, at.speed, part) for one in (values, values * moved)]


def _means(wave: _Wave, delay: float) -> tuple[Complexes, Complexes, Floats]:
    """Mean amplitude of each part (p,), mean amplitude of its direction, and its mean speed."""
    turned, usual = wave.turned(delay), wave.mean(delay)
    rows = [np.flatnonzero(wave.part == one) for one in np.unique(wave.part)]
    return (
        np.array([turned[own].mean() for own in rows]),
        np.array([usual[own][0] for own in rows]),
        np.array([wave.speed[own].mean() for own in rows]),
    )


def _stands_out(wave: _Wave, delay: float) -> bool:
    """Whether the median part has a line."""
    turned = wave.turned(delay)
    means = _means(wave, delay)[0]
    own = means[np.searchsorted(np.unique(wave.part), wave.part)]
    freedom = max(wave.values.size - means.size, 1)
    scatter = np.sqrt(np.sum(np.abs(turned - own) ** 2) / freedom / (wave.values.size / means.size))
    return bool(np.median(np.abs(means)) > _STANDS_OUT * scatter)


def _chance(waves: Sequence[_Wave], delay: float) -> tuple[float, float]:
    """Chance that random phases of the parts agree as well, and the delay's standard deviation [s].

    It is the volume of a ball with the radius of the phase residuals, over that of the cube of side 2 pi.
    """
    squares = freedom = lever = 0.0
    for wave in waves:
        mean, usual, speed = _means(wave, delay)
        rest = np.angle(mean * np.conj(usual))
        squares += float(rest @ rest)
        for way in (False, True):
            own = wave.order * speed[(speed > 0.0) == way]
            freedom += max(own.size - 1, 0)
            lever += float(np.sum((own - own.mean()) ** 2)) if own.size else 0.0
    freedom -= 1.0
    if freedom < 1.0 or lever == 0.0:
        return 1.0, np.inf
    ball = 0.5 * freedom * np.log(np.pi * squares) - special.gammaln(0.5 * freedom + 1.0)
    chance = float(np.exp(min(ball - freedom * np.log(TURN), 0.0)))
    return chance, float(np.sqrt(squares / freedom / lever))

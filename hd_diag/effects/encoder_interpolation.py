"""Division error of an encoder: as many periods per turn as it has lines or pole pairs, and twice as many."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Starts, Values
from hd_diag.effects.excitation import Verdict, enough_input_turns, sample_interval, torque_known
from hd_diag.effects.harmonic import Harmonic
from hd_diag.effects.order_spectrum import integer_orders, peaks
from hd_diag.effects.quantity import Quantity, amplitude, direction
from hd_diag.effects.signals import Signals
from hd_diag.formatting import ARCSEC

_USUAL = (4, 5, 8, 12, 16, 32, 64, 128, 256, 512, 1024, 2048, 4096)
_CANDIDATES = 4
_ROUND = 2**12 * 3**6 * 5**4  # products of 2, 3 and 5 up to 4096 divide it, except for 2187 and 3125
_ABOVE_MESH = 8  # lowest order above those of two eccentric lobes under load
_SLOW = 0.25  # share of the moving samples that must be slow enough


@dataclass(frozen=True, kw_only=True)
class EncoderInterpolation(Harmonic):
    """The encoder reads ``a cos(L theta - d) + b cos(2 L theta - e)`` too far.

    Its number of lines per turn L is from `least` to `most`, and a multiple of `multiple`. If `multiple` is
    not 1, L has only the prime factors 2, 3 and 5, as circles are divided.
    """

    least: int
    most: int
    multiple: int = 1
    orders: tuple[float, ...] = (1.0, 2.0)

    def starts(self, signals: Signals, residual: Floats | None = None) -> Starts:
        """Strongest whole orders of a residual over the angle; without a residual, usual line numbers."""
        least, highest = self.least, self.highest(signals)
        if self.angle == "input_angle" and not torque_known(signals)[0]:
            least = _ABOVE_MESH  # if the load is unknown, the gear's own orders look like lines
        trials = max(1, highest - least + 1)
        if residual is None:
            return Starts([(float(lines),) for lines in _USUAL if least <= lines <= highest], trials)
        if highest < least:
            return Starts([], trials)
        strength = self._strength(signals, residual, highest)
        strength[:least] = 0.0
        best = self._lines(signals, strength)[:_CANDIDATES]
        return Starts([(float(order),) for order in best], trials)

    def shown(self, signals: Signals, columns: Floats, nonlinear: Values) -> Floats:
        """Columns (n, k), zero where a period has fewer than two samples; see :meth:`Effect.shown`."""
        lines = np.repeat(self.orders, 2) * nonlinear[0]
        return columns * (self._phase_step(signals)[:, None] * lines < np.pi)

    def _strength(self, signals: Signals, residual: Floats, highest: int) -> Floats:
        """Amplitudes of the whole orders 0 to `highest` [rad], by the samples that resolve each octave."""
        angle, step = getattr(signals, self.angle), self._phase_step(signals)
        strength, high = np.zeros(highest + 1), highest
        while high:
            rows = step * high < np.pi
            low = high // 2 if not rows.all() else 0
            if rows.any():
                own = integer_orders(angle[rows], residual[rows], high)
                strength[low + 1 : high + 1] = np.sqrt(rows.mean()) * own[low + 1 :]
            high = low
        return strength

    def _phase_step(self, signals: Signals) -> Floats:
        """Change of the angle between samples (n,) [rad]."""
        return np.asarray(np.abs(signals.speed) * (sample_interval(signals) / self._gear(signals)))

    def _lines(self, signals: Signals, strength: Floats) -> list[int]:
        """Orders that can be lines, the strongest first, without the side lobes of stronger orders.

        At the output, whole orders of the input's turn are left out: they are the gear's or input encoder's.
        """
        order, gear = np.arange(strength.size), self._gear(signals)
        can = self.divides(order) & ((gear == 1.0) | (order % gear != 0.0))
        return [int(one) for one in peaks(strength, self.multiple - 1) if can[one]]

    def divides(self, number: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
        """Whether an encoder's circle may be divided by each number, shape (n,)."""
        divided = number % self.multiple == 0
        if self.multiple > 1:
            divided &= is_round(number)
        return np.asarray(divided, np.bool_)

    def testable(self, signals: Signals) -> Verdict:
        """As :meth:`Effect.testable`, and whether the least number of lines does not alias."""
        if self.highest(signals) >= self.least:
            return super().testable(signals)
        limit = np.pi / (self.least * sample_interval(signals)) * self._gear(signals)
        return False, f"the input is too fast for the sampling: repeat the motion below {limit:.3g} rad/s"

    def highest(self, signals: Signals) -> int:
        """Greatest order of the angle that does not alias in the slower part of the record."""
        speed = np.abs(signals.speed) / self._gear(signals)
        moving = speed[speed > 1e-3 / self._gear(signals)]
        if not moving.size:
            return 0
        step = float(np.quantile(moving, _SLOW)) * sample_interval(signals)
        return int(min(self.most, np.pi / step)) if step > 0.0 else self.most

    def _gear(self, signals: Signals) -> float:
        """Speed of the input over that of the angle [-]."""
        return 1.0 if self.angle == "input_angle" else abs(signals.ratio)


def is_round(number: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
    """Whether numbers (n,) divide `_ROUND`: their only prime factors are 2, 3 and 5."""
    return np.asarray(_ROUND % np.maximum(number, 1) == 0)


def line_quantities(usual: float, least: int, most: int, at: str) -> tuple[Quantity, ...]:
    """Amplitudes of usual size `usual` [rad], phases and lines per turn, `at` the input or output."""
    return (
        amplitude("amplitude", "rad", 0.1, usual, f"a, reading error at the {at}"),
        direction("phase", f"of the error at {at} angle zero"),
        amplitude("second_amplitude", "rad", 0.1, 0.5 * usual, "b, twice per line"),
        direction("second_phase", f"of that at {at} angle zero"),
        Quantity(
            "lines", "-", least, most, 64.0, "L, lines or pole pairs per turn", linear=False, discrete=True
        ),
    )


_LEAST, _MOST = 4, 4096

EFFECT = EncoderInterpolation(
    name="encoder_interpolation",
    formula=(
        "The input reads ``a cos(L theta_in - d) + b cos(2 L theta_in - e)`` too far, so the output seems to "
        "lag by that over N."
    ),
    cause="The input encoder divides its lines or pole pairs unevenly.",
    kind="sensor",
    frame="input",
    needs=("output_angle", "speed", "time"),
    angle="input_angle",
    least=_LEAST,
    most=_MOST,
    excitation=(partial(enough_input_turns, turns=3.0),),
    quantities=line_quantities(200.0 * ARCSEC, _LEAST, _MOST, "input"),
    confused_with=(
        "circular_spline_form",
        "circular_spline_pitch",
        "bearing_passage",
        "tooth_damage",
        "output_encoder_interpolation",
    ),
    source="Heidenhain, Rotary Encoders (brochure): position error within one signal period",
    inspect=(
        "Number of lines or pole pairs in the motor's data sheet: it must be the order found, or a quarter "
        "or half of it. Then the encoder's signals on an oscilloscope: offsets give one, unequal amplitudes "
        "two periods per line. It must not change with torque or direction."
    ),
)

"""Division error of the input encoder: as many periods per turn as it has lines or pole pairs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Starts
from hd_diag.effects.excitation import Verdict, enough_input_turns, sample_interval, torque_known
from hd_diag.effects.harmonic import Harmonic
from hd_diag.effects.order_spectrum import integer_orders
from hd_diag.effects.quantity import Quantity, amplitude, direction
from hd_diag.effects.signals import Signals
from hd_diag.formatting import ARCSEC

_LEAST, _MOST = 4, 4096
_USUAL = (4, 5, 8, 12, 16, 32, 64, 128, 256, 512, 1024, 2048, 4096)
_CANDIDATES = 4
_ABOVE_MESH = 8  # first order beyond those that two eccentric lobes give under load
_SLOW = 0.25  # share of the moving samples that must be slow enough


@dataclass(frozen=True, kw_only=True)
class EncoderInterpolation(Harmonic):
    """The input reads ``a cos(L theta_in - d)`` too far, so the output seems to lag by that over N."""

    def starts(self, signals: Signals, residual: Floats | None = None) -> Starts:
        """Strongest whole orders of a residual over the input angle; without one the usual line numbers."""
        least, highest = _lowest(signals), _highest(signals)
        trials = max(1, highest - least + 1)
        if residual is None:
            return Starts([(float(lines),) for lines in _USUAL if least <= lines <= highest], trials)
        if highest < least:
            return Starts([], trials)
        strength = integer_orders(signals.input_angle, residual, highest)
        strength[:least] = 0.0
        best = np.argsort(strength)[::-1][:_CANDIDATES]
        return Starts([(float(order),) for order in best if order >= least], trials)


def _slow_enough(signals: Signals) -> Verdict:
    """Whether the least number of lines does not alias."""
    limit = np.pi / (_LEAST * sample_interval(signals))
    slow = _highest(signals) >= _LEAST
    text = f"the input is too fast for the sampling: repeat the motion below {limit:.3g} rad/s"
    return slow, "" if slow else text


def _lowest(signals: Signals) -> int:
    """Least number of lines: under a load that is not known, the gear's own orders look like lines."""
    return _LEAST if torque_known(signals)[0] else _ABOVE_MESH


def _highest(signals: Signals) -> int:
    """Greatest order of the input that does not alias in the slower part of the record."""
    speed = np.abs(signals.speed)
    moving = speed[speed > 1e-3]
    if not moving.size:
        return 0
    step = float(np.quantile(moving, _SLOW)) * sample_interval(signals)
    return int(min(_MOST, np.pi / step)) if step > 0.0 else _MOST


EFFECT = EncoderInterpolation(
    name="encoder_interpolation",
    cause="The input encoder divides its lines or pole pairs unevenly.",
    kind="sensor",
    frame="input",
    needs=("output_angle", "speed", "time"),
    angle="input_angle",
    excitation=(_slow_enough, partial(enough_input_turns, turns=3.0)),
    quantities=(
        amplitude("amplitude", "rad", 0.1, 200.0 * ARCSEC, "a, reading error at the input"),
        direction("phase", "of the error at input angle zero"),
        Quantity(
            "lines", "-", _LEAST, _MOST, 64.0, "L, lines or pole pairs per turn", linear=False, discrete=True
        ),
    ),
    confused_with=("circular_spline_form", "circular_spline_pitch", "bearing_passage", "tooth_damage"),
    source="Heidenhain, Rotary Encoders (brochure): position error within one signal period",
    inspect=(
        "Number of lines or pole pairs in the motor's data sheet: it must be the order found, or a quarter "
        "or half of it. Then the encoder's signals on an oscilloscope: offsets give one, unequal amplitudes "
        "two periods per line. It must not change with torque or direction."
    ),
)

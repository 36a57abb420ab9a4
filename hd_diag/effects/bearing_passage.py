"""The wave generator bearing: orders of its cage and its balls, which are not whole numbers."""

from __future__ import annotations

from functools import partial

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Starts, Values
from hd_diag.effects.excitation import enough_input_turns, input_turns
from hd_diag.effects.harmonic import Harmonic
from hd_diag.effects.order_spectrum import line_width, peaks, spectrum
from hd_diag.effects.quantity import Quantity, amplitude, direction, switch
from hd_diag.effects.signals import Signals
from hd_diag.formatting import ARCSEC

BALLS = 23
"""Assumed number of balls in the wave generator's thin bearing; lines of others stay unexplained."""

CAGE = (0.40, 0.48)
"""Turns of the cage per turn of the wave generator: ``(1 - ball diameter / pitch diameter) / 2``."""

BANDS = (
    CAGE,
    (BALLS * CAGE[0], BALLS * CAGE[1]),
    (BALLS * (1.0 - CAGE[1]), BALLS * (1.0 - CAGE[0])),
)
"""Ranges of the orders of the cage, of balls passing the outer ring, and of balls passing the inner ring."""

_CANDIDATES = 4
_HIGHEST, _LOWEST = 40.0, 0.2  # range of orders in the spectrum
_LEADING = 0.8  # least strength of a line that slips, over the strongest line
_LEAK = 0.1  # side lobe of a whole order, over its line, that a candidate tolerates


class BearingPassage(Harmonic):
    """``a cos(kappa theta_W - d)``. A fit may let the phase slip, because rolling bearings slip."""

    def starts(self, signals: Signals, residual: Floats | None = None) -> Starts:
        """Strongest lines of a residual's order spectrum inside the bands; without one the bands' middles.

        A line may slip only if no line is clearly stronger, in the residual or in the residual times torque.
        Otherwise it could follow leakage or aliases of the stronger line.
        """
        width = sum(high - low for low, high in BANDS)
        trials = 2 * max(len(BANDS), int(2.0 * width * input_turns(signals)))
        if residual is None:
            return Starts(
                [(0.5 * (low + high), slips) for low, high in BANDS for slips in (0.0, 1.0)], trials
            )
        order, strength = spectrum(signals.wave_generator_angle, residual, _HIGHEST)
        load = signals.torque / max(float(np.sqrt(np.mean(signals.torque**2))), 1e-9)
        _, loaded = spectrum(signals.wave_generator_angle, residual * load, _HIGHEST)
        most = _LEADING * float(np.max(np.maximum(strength, loaded)[order > _LOWEST], initial=0.0))
        found = peaks(strength, 1)
        best = found[_allowed(order, signals)[found]][:_CANDIDATES]
        steady: list[Values] = [(float(order[index]), 0.0) for index in best]
        slipping: list[Values] = [(float(order[index]), 1.0) for index in best if strength[index] >= most]
        return Starts(steady + slipping, trials)


def _allowed(order: Floats, signals: Signals) -> npt.NDArray[np.bool_]:
    """Which orders are in the bands and not near whole ones; those of the flexspline's teeth lie outside."""
    inside = np.any([(order >= low) & (order <= high) for low, high in BANDS], axis=0)
    reach = line_width(signals.wave_generator_angle, _LEAK)
    return np.asarray(inside & (np.abs(order - np.rint(order)) > reach))


EFFECT = BearingPassage(
    name="bearing_passage",
    cause=(
        "A ball or a race of the wave generator's bearing is worn or out of size: it passes the lobes again "
        "and again."
    ),
    kind="kinematic",
    frame="input",
    needs=("wave_generator_angle",),
    angle="wave_generator_angle",
    # Its orders are close to whole numbers; `starts` leaves out those that a record cannot resolve.
    excitation=(partial(enough_input_turns, turns=10.0),),
    wanders_by="slips",
    quantities=(
        amplitude("amplitude", "rad", 1e-3, 1.5 * ARCSEC, "amplitude at the output"),
        direction("phase", "of the order at wave generator angle zero"),
        Quantity("order", "-", CAGE[0], BANDS[-1][1], 0.02, "kappa, periods per wave generator turn", False),
        switch("slips", "1: the phase slips over the record, and its mean is all that a model can predict"),
    ),
    confused_with=("encoder_interpolation", "circular_spline_form"),
    source=(
        "passage orders: Harris and Kotzalas, Essential Concepts of Bearing Technology, 5th ed., CRC 2006, "
        "ch. 1"
    ),
    inspect=(
        "Wave generator bearing: noise, grease, cage and races. Order 0.40-0.48 is the cage (one ball larger "
        f"than the rest); with {BALLS} balls {BANDS[1][0]:.1f}-{BANDS[1][1]:.1f} is the outer race and "
        f"{BANDS[2][0]:.1f}-{BANDS[2][1]:.1f} the inner. An acceleration sensor on the housing must show the "
        "same order; it slips slowly against the wave generator."
    ),
)

"""The output angle arrives late against the input angle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hd_diag.effects.effect import Effect, Quantity, Values
from hd_diag.effects.excitation import speed_beyond
from hd_diag.effects.signals import Signals

Floats = npt.NDArray[np.float64]

_SPEED = 20.0  # [rad/s] of the input: 50 us read a hundredth of an arcmin there at ratio 100


@dataclass(frozen=True)
class StreamDelay(Effect):
    """``-dt (omega_o + dTE/dt)``, first order of the delay."""

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """What the output moves in a second; see :meth:`Effect.columns`."""
        return -(signals.speed / signals.ratio + signals.predicted_rate)[:, None]

    def testable(self, signals: Signals) -> tuple[bool, str]:
        """High speed."""
        return speed_beyond(signals, _SPEED, "run the joint fast, with its ripple")


EFFECT = StreamDelay(
    name="stream_delay",
    cause="The output angle is stamped later than it was measured, compared with the input angle.",
    kind="sensor",
    frame="time",
    needs=("speed", "predicted_rate"),
    quantities=(
        Quantity(
            "delay", "s", -0.05, 0.05, 1e-4, "dt, age of the output angle at its stamp beyond the input's"
        ),
    ),
    confused_with=("viscous_windup", "coulomb_windup", "resonance"),
    source="first order of theta_out(t - dt); clocks of two streams in one message",
    inspect=(
        "Where the two angles get their stamps: bus cycles, filters of the encoders, message filters. 10 us "
        "read 2.6 arcsec at 20 turns per second of the input and ratio 100. Same distance in time at all "
        "speeds; a filter's delay is that of its group. Swap the order in which the encoders are read: it "
        "must change."
    ),
)

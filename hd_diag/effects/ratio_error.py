"""A declared ratio that is not the real one: the error grows with the output angle."""

from __future__ import annotations

from functools import partial

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Effect, Values
from hd_diag.effects.excitation import both_directions, enough_output_turns, torque_known
from hd_diag.effects.quantity import Quantity
from hd_diag.effects.signals import Signals


class RatioError(Effect):
    """``e theta_in / N``, with ``e = N / N' - 1`` and N' the real ratio."""

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """Nominal output angle; see :meth:`Effect.columns`."""
        return signals.output_angle[:, None]


EFFECT = RatioError(
    name="ratio_error",
    cause="The ratio between the reported angles is not the declared one: a wrong gear, or a belt before it.",
    kind="kinematic",
    frame="output",
    needs=("output_angle",),
    # A ramp may also be a wave over a small part of a turn, a drift while the joint runs one way, or torsion.
    excitation=(partial(enough_output_turns, turns=0.4), both_directions, torque_known),
    quantities=(Quantity("relative_error", "-", -1.0, 1e3, 1e-4, "declared over real ratio, less one"),),
    confused_with=("output_runout", "thermal_drift", "tooth_skip"),
    source="definition of the transmission error",
    inspect=(
        "Type plate of the gear and every stage between the encoders, belts too. Turn the output by exactly "
        "one turn and count the input's: it must be the declared ratio. A ratio of whole teeth cannot be "
        "wrong by little: a small error is a slipping belt, a hub or a scale of the angle."
    ),
)

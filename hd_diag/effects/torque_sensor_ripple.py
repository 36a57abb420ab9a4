"""A torque sensor in the gear reports a ripple when the wave generator passes."""

from __future__ import annotations

from functools import partial

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Values
from hd_diag.effects.excitation import enough_input_turns, torque_known, torque_varies
from hd_diag.effects.mesh_torque import MeshTorque
from hd_diag.effects.quantity import Quantity, amplitude, direction, switch, turning
from hd_diag.effects.signals import Signals

ORDERS = (2, 1, 4)
"""Orders of the wave generator's turn: its two lobes give 2, inequalities give the others."""


def _ripple(signals: Signals, nonlinear: Values) -> Floats:
    turns, others = nonlinear
    angle = signals.seen_from(turns)
    kept = [turning(k * angle) * (1.0 if k == ORDERS[0] else others) for k in ORDERS]
    return np.concatenate([part for w in kept for part in (signals.torque[:, None] * w, w)], axis=1)


def _quantities(order: int) -> tuple[Quantity, ...]:
    return (
        amplitude(f"share_{order}", "-", 0.5, 0.02, f"a, of the torque, {order} per wave generator turn"),
        direction(f"share_direction_{order}", "angle theta of the greatest share", order),
        amplitude(f"torque_{order}", "N m", 1e2, 0.3, f"b, under any torque, {order} per turn"),
        direction(f"torque_direction_{order}", "angle theta of the greatest torque", order),
    )


EFFECT = MeshTorque(
    name="torque_sensor_ripple",
    cause="Strain gauges on the flexspline feel its lobes: the torque is reported with a ripple.",
    formula="``T' = T + sum [T a_k cos k (theta - d_k) + b_k cos k (theta - e_k)]``.",
    kind="sensor",
    frame="input",
    needs=("wave_generator_angle", "torque"),
    excitation=(torque_known, torque_varies, partial(enough_input_turns, turns=3.0)),
    reported=True,
    shape=_ripple,
    grid=((0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)),
    quantities=(
        *(quantity for order in ORDERS for quantity in _quantities(order)),
        switch("turns", "0: the gauges stand in the housing, 1: they turn with the flexspline"),
        switch("others", "1: orders 1 and 4 too"),
    ),
    confused_with=("circular_spline_pitch", "circular_spline_form", "coupling_misalignment"),
    source="Hashimoto, Shibata, Kosuge, Joint torque sensory feedback, ICRA 1993: built-in sensing",
    inspect=(
        "The reported torque alone, over the input angle, at constant load: lines at 2 per turn of the wave "
        "generator that no load has. Another pair of gauges, a quarter turn apart, takes them away. It must "
        "grow with load; a pitch error falls."
    ),
)

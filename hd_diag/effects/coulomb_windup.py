"""Dry friction behind the gear: torque in the mesh that opposes the motion, and grows at low speed."""

from __future__ import annotations

from functools import partial

import numpy as np

from hd_diag.effects.effect import Stepped, Values
from hd_diag.effects.excitation import both_directions, enough_input_turns
from hd_diag.effects.mesh_torque import MeshTorque
from hd_diag.effects.quantity import Quantity
from hd_diag.effects.recursions import lag
from hd_diag.effects.signals import Signals

# Time [s] and input angle [rad] of the last sample, None before the first; state z of the bristle.
State = tuple[tuple[float, float] | None, float]


class CoulombWindup(MeshTorque):
    """``T' = T + a [1 + b exp(-(omega / omega_s)^2)] z`` with a bristle z from -1 to 1, which motion bends.

    ``x_0 dz/dt = omega - (|omega| + omega_0) z``. With ``omega_0 = 0`` the bristle stays bent at rest (Dahl).
    Otherwise it straightens at rest, and if x_0 is small, z depends on the speed alone.
    """

    def start(self, nonlinear: Values) -> State:
        """No sample yet; the bristle is straight."""
        return None, 0.0

    def torque_step(self, state: State, signals: Signals, nonlinear: Values) -> Stepped:
        """Advance the bristle, exactly for constant speed; see :meth:`MeshTorque.torque_step`."""
        way, creep, share, slow = nonlinear
        if not signals.size:
            return np.empty((0, 1)), state
        time, angle = signals.time, signals.input_angle * np.sign(signals.ratio)
        before, z = state
        step, moved = (
            np.diff(values, prepend=values[0] if before is None else before[index])
            for index, values in enumerate((time, angle))
        )
        bent = np.abs(moved) + creep * np.maximum(step, 0.0)
        left = np.exp(-bent / way)
        aim = moved / np.where(bent > 0.0, bent, 1.0)
        bend = lag(z, left, (1.0 - left) * aim)
        more = 1.0 + share * np.exp(-((signals.speed / slow) ** 2))
        return (more * bend)[:, None], ((float(time[-1]), float(angle[-1])), float(bend[-1]))


EFFECT = CoulombWindup(
    name="coulomb_windup",
    cause="Dry friction between gear and torque sensor (seal, output bearing, cable): the mesh bears it too.",
    kind="friction",
    frame="torque",
    needs=("time", "wave_generator_angle", "torque", "speed", "run"),
    excitation=(both_directions, partial(enough_input_turns, turns=1.0)),
    remembers=True,
    broadband=True,
    grid=((0.003, 0.1, 0.0, 10.0), (0.003, 0.3, 0.5, 3.0), (0.3, 0.0, 0.0, 3.0), (0.05, 0.0, 0.5, 10.0)),
    quantities=(
        Quantity("friction", "N m", 0.0, 1e3, 1.0, "a, while the joint moves", strict=True),
        Quantity("way", "rad", 1e-4, 30.0, 0.1, "x_0, of the input, over which it builds up", False),
        Quantity(
            "creep_speed",
            "rad/s",
            0.0,
            3.0,
            0.1,
            "omega_0, of the input; 0: kept at rest",
            linear=False,
            shape=True,
            most=0.3,  # with faster creep, z is only a function of the speed
        ),
        Quantity(
            "stribeck",
            "-",
            0.0,
            2.0,
            0.5,
            "b, share of it that is more at low speed",
            linear=False,
            shape=True,
            most=1.0,  # chosen: at rest not more than twice the friction
        ),
        Quantity(
            "stribeck_speed", "rad/s", 0.5, 20.0, 5.0, "omega_s, of the input", linear=False, shape=True
        ),
    ),
    confused_with=("viscous_windup", "stream_delay", "hysteresis", "torque_offset"),
    source=(
        "Dahl: AIAA Journal 14(12), 1976; Stribeck: Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica "
        "30(7), 1994, pp. 1083-1138"
    ),
    inspect=(
        "Seal and output bearing: turn the link by hand with the motor off, then measure the torque to move "
        "it: it must be a. Drive the same stretch slowly both ways, loaded and not: half the distance of the "
        "two curves is a times the compliance there."
    ),
)

"""Torque from the motor's current: its constant is uncertain, and the motor's friction and inertia add."""

from __future__ import annotations

from functools import partial

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Stepped, Values
from hd_diag.effects.excitation import enough_input_turns, torque_known
from hd_diag.effects.mesh_torque import MeshTorque
from hd_diag.effects.quantity import Quantity
from hd_diag.effects.recursions import lag
from hd_diag.effects.signals import Signals

REFERENCE = 100.0
"""Speed of the input at which viscous friction is given [rad/s]."""

_POWER = 0.85  # exponent of the speed: friction of grease has 0.7 to 1

_SMOOTH = 0.03  # time constant of the speed before its derivative [s]: encoders count in steps

FRICTION = slice(1, 4)
"""Columns of friction: dry, loaded and viscous."""

_DRY, _LOADED = 1, 2  # columns of friction: of 1 N m, and of 1 N m for every N m of torque

# Time [s] of the last sample and the smoothed speed of the input there [rad/s]; None before the first.
State = tuple[float, float] | None


class MotorCurrent(MeshTorque):
    """``T' = M - m |M| s``, ``M = T + a T - f s - c sgn(omega) |omega / 100 rad/s|^0.85 - j domega/dt``.

    The sign s changes smoothly over omega_0: ``s = omega / sqrt(omega^2 + omega_0^2)``.
    """

    def more(self, columns: Floats, coefficients: Floats) -> Floats:
        """Loaded friction grows with the torque after the motor's own losses; see :meth:`MeshTorque.more`."""
        own = columns @ np.where(np.arange(self.size) == _LOADED, 0.0, coefficients)
        return np.asarray(own + coefficients[_LOADED] * columns[:, _DRY] * np.abs(columns[:, 0] + own))

    def changes(self, columns: Floats, coefficients: Floats) -> Floats:
        """Derivatives of `more`; see :meth:`MeshTorque.changes`."""
        own = columns @ np.where(np.arange(self.size) == _LOADED, 0.0, coefficients)
        behind, dry = columns[:, 0] + own, columns[:, _DRY]
        found = columns * (1.0 + coefficients[_LOADED] * dry * np.sign(behind))[:, None]
        found[:, _LOADED] = dry * np.abs(behind)
        return np.asarray(found)

    def by_factor(self, coefficients: Floats) -> Floats:
        """Derivative of the coefficients by a common factor of all torque in the mesh, shape (size,)."""
        return np.where(np.arange(self.size) == _LOADED, 0.0, coefficients + np.eye(self.size)[0])

    def torque_step(self, state: State, signals: Signals, nonlinear: Values) -> Stepped:
        """Torques with inertia by the lagged speed's derivative; see :meth:`MeshTorque.torque_step`."""
        if not signals.size:
            return np.empty((0, self.size)), state
        speed, torque = signals.forward_speed, signals.torque
        last, followed = (float(signals.time[0]), float(speed[0])) if state is None else state
        left = np.exp(-np.maximum(np.diff(signals.time, prepend=last), 0.0) / _SMOOTH)
        behind = lag(followed, left, (1.0 - left) * speed)
        sign = speed / np.hypot(speed, max(nonlinear[0], 1e-9))
        drag = np.sign(speed) * np.abs(speed / REFERENCE) ** _POWER
        rate = (speed - behind) / (_SMOOTH * REFERENCE)
        columns = np.stack((torque, -sign, -np.abs(torque) * sign, -drag, -rate), axis=1)
        return columns, (float(signals.time[-1]), float(behind[-1]))


EFFECT = MotorCurrent(
    name="motor_current",
    cause="The torque is the motor's current: its constant is known to some 20 %, friction and inertia add.",
    kind="sensor",
    frame="torque",
    needs=("time", "wave_generator_angle", "torque", "speed", "run"),
    excitation=(torque_known, partial(enough_input_turns, turns=1.0)),
    remembers=True,
    reported=True,
    searched=False,
    given=True,
    grid=((0.5,), (5.0,)),
    quantities=(
        Quantity("relative_error", "-", -0.9, 9.0, 0.2, "a, of the torque by the constant that is known"),
        Quantity("friction", "N m", -1e3, 1e3, 3.0, "f, dry, of motor and gear"),
        Quantity("loaded_friction", "-", -1.0, 1.0, 0.1, "m, share of the torque that more of it is"),
        Quantity("viscous_friction", "N m", -1e3, 1e3, 5.0, "c, at 100 rad/s of the input"),
        Quantity("inertia", "N m", -1e3, 1e3, 3.0, "j, torque for 100 rad/s^2 of the input"),
        Quantity("reversal_speed", "rad/s", 1e-3, 50.0, 1.0, "omega_0, of the input", linear=False),
    ),
    confused_with=("coulomb_windup", "viscous_windup", "torque_offset"),
    always_confused=("tooth_compliance", "cup_compliance"),
    source="Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994, pp. 1083-1138",
    inspect=(
        "The motor's torque constant times ratio and efficiency; run the joint without load at several "
        "speeds: the current is its friction. No stiffness follows from a current, and no small friction."
    ),
)

"""Causes that act as torque: the mesh bears more than is reported, and its compliance turns it into angle."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Effect, Stage, Stepped, Values, by_run
from hd_diag.effects.signals import Signals

Shape = Callable[[Signals, Values], Floats]


def _nothing(signals: Signals, nonlinear: Values) -> Floats:
    return np.empty((signals.size, 0))


@dataclass(frozen=True, kw_only=True)
class MeshTorque(Effect):
    """The mesh bears the reported torque plus ``sum c_k shape_k``; several such causes add up to one torque.

    `reported` marks an error of the reported torque: smoothing of that torque smooths the cause as well,
    except for waves of the input's turn if the smoothing keeps them. `shape` makes torque [N m per unit of
    the coefficients], shape (n, size), from signals and nonlinear values. A cause with memory overrides
    `torque_step` instead.
    """

    stage: Stage = Stage.TORQUE
    proportional: bool = False
    own_slopes: bool = True
    reported: bool = False
    shape: Shape = _nothing

    def torque_step(self, state: Any, signals: Signals, nonlinear: Values) -> Stepped:
        """Torque at the next samples of a run [N m per unit], shape (n, size), and the state after them."""
        return self.shape(signals, nonlinear), state

    def torque(self, signals: Signals, nonlinear: Values) -> Floats:
        """As `torque_step` along a record, every run from its start."""
        if not self.remembers:
            return self.shape(signals, nonlinear)
        return by_run(signals, lambda run: self.torque_step(self.start(nonlinear), run, nonlinear)[0])

    def more(self, columns: Floats, coefficients: Floats) -> Floats:
        """Real less reported torque [N m], shape (n,), from columns of :meth:`torque`."""
        return np.asarray(columns @ coefficients)

    def changes(self, columns: Floats, coefficients: Floats) -> Floats:
        """Derivatives of :meth:`more` by the coefficients [N m per unit], shape (n, size)."""
        return columns

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """The torque times the model's slope by torque; see :meth:`Effect.columns`."""
        return signals.predicted_torque_slope[:, None] * self.torque(signals, nonlinear)

    def step(self, state: Any, signals: Signals, coefficients: Floats, nonlinear: Values) -> Stepped:
        """Change of the model's error under the changed torque; see :meth:`Effect.step`."""
        torque, state = self.torque_step(state, signals, nonlinear)
        return signals.contact.under_more_torque(self.more(torque, coefficients)), state

"""Torque that causes add to the reported one along a record, and the model's response to it."""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.diagnosis.fit.record_model import RecordModel
from hd_diag.effects.effect import Effect, Values
from hd_diag.effects.mesh_torque import MeshTorque
from hd_diag.effects.scaling import unit_scales
from hd_diag.effects.signals import Signals

_STEEPEST = 1e-2  # [rad/(N m)], rated torque 56 N m; no loaded joint has a hundredth of this compliance
_SEPARABLE = 5e-3  # of the rated torque: derivatives are reused for smaller changes of the torque
_NEAR = 0.02  # of the rated torque: the same for the motor's own torque

# Causes with their nonlinear values and coefficients.
Torques = tuple[tuple[tuple[MeshTorque, Values], Floats], ...]


@dataclass(frozen=True, eq=False)
class MeshTorques:
    """Causes that change the torque in the mesh, at their size. All arrays cover all rows of the record.

    Parameters
    ----------
    model : RecordModel
    parameters : ndarray, shape (p,)
        Of the model, in units of `fit_parameters.units`.
    causes : tuple
    as_taken : bool
        Whether the motor takes, in addition to the causes, exactly what is subtracted from the record.
    """

    model: RecordModel
    parameters: Floats
    causes: Torques
    as_taken: bool = False

    @cached_property
    def more(self) -> Floats:
        """Real torque less the record's torque [N m], shape (n,)."""
        taken = self.model.record.taken
        total = np.zeros(self.model.record.size) if taken is None or self.as_taken else -taken
        for (effect, nonlinear), coefficients in self.causes:
            total += effect.more(self.model.torque(effect, nonlinear), coefficients)
        return total

    @cached_property
    def error(self) -> Floats:
        """Change of the model's error by this torque [rad], shape (n,)."""
        return np.zeros(self.model.record.size) if self._none else self._under[0]

    @cached_property
    def slope(self) -> Floats:
        """The model's derivative by the torque, under this torque [rad/(N m)], shape (n,)."""
        nearby = self._nearby
        steep = self._whole.predicted_torque_slope if nearby._none else nearby._under[1]
        most = _STEEPEST * unit_scales(self.model.configured)["rad/(N m)"]
        return np.where(np.abs(steep) < most, steep, 0.0)  # infinite in the gap between the flanks

    @property
    def slope_key(self) -> Hashable:
        """Cache key of the derivative by the torque."""
        return self._nearby.key

    @cached_property
    def rounded(self) -> MeshTorques:
        """The causes at rounded sizes, so that the model's costly derivatives can be reused."""
        step, found = _SEPARABLE * self.model.configured.rated_torque, []
        for (effect, nonlinear), coefficients in self.causes:
            if effect.given and self.near:
                continue
            reach = self.model.greatest_torque(effect, nonlinear)
            found.append(((effect, nonlinear), np.rint(coefficients * reach / step) * step / reach))
        return replace(self, causes=tuple(found), as_taken=self.near)

    @cached_property
    def near(self) -> bool:
        """Whether the motor's own torque is about the torque that is subtracted from the record."""
        if self.model.record.taken is None:
            return False
        motor = replace(self, causes=tuple(one for one in self.causes if one[0][0].given))
        return float(np.std(motor.more)) < _NEAR * self.model.configured.rated_torque

    @property
    def key(self) -> Hashable:
        """Cache key: the causes and their sizes."""
        own = tuple((effect.name, nonlinear, one.tobytes()) for (effect, nonlinear), one in self.causes)
        return (self.as_taken, *own)

    def derivatives(self, reach: Floats | None = None) -> Floats:
        """The model's derivatives by its parameters, (n, p); averaged over steps, the columns of `reach`."""
        if reach is None:
            return self.model.derivatives(self.parameters, self.more)
        return self.model.secants(self.parameters, self.more, reach)

    def columns(self, effect: MeshTorque, nonlinear: Values) -> Floats:
        """Columns of a cause given these causes [rad per unit], (n, size); at its size if among them."""
        torque = self.model.torque(effect, nonlinear)
        for item, coefficients in self.causes:
            if item == (effect, nonlinear):
                torque = effect.changes(torque, coefficients)
        return np.asarray(self.slope[:, None] * torque)

    def beside(self, effect: MeshTorque, nonlinear: Values, coefficients: Floats) -> Floats:
        """Part of a cause of some size in the error, given the other causes [rad], shape (n,)."""
        others = replace(self, causes=tuple(one for one in self.causes if one[0][0].name != effect.name))
        both = replace(others, causes=(*others.causes, ((effect, nonlinear), coefficients)))
        return np.asarray(both.error - others.error)

    def signals(self) -> Signals:
        """The record as later stages see it: the torque that the mesh bears, the model's error under it."""
        if self._none:
            return self._whole
        error = self._whole.predicted + self.error
        seen = self._whole.bearing(self._whole.torque + self.more)
        return replace(seen, predicted=error, predicted_rate=self.model.rate(error))

    @property
    def _whole(self) -> Signals:
        return self.model.at(self.parameters).signals

    @property
    def _nearby(self) -> MeshTorques:
        """Torque at which the slope is taken; rounded with motor current, as every fit moves its friction."""
        return self if self.model.record.taken is None else self.rounded

    @property
    def _none(self) -> bool:
        return not self.causes and (self.as_taken or self.model.record.taken is None)

    @property
    def _under(self) -> Floats:
        """Change of the model's error by this torque [rad], and its derivative by the torque; (2, n)."""

        def under() -> Floats:
            error, slope = self.model.under(self.parameters, self.more)
            return np.stack((np.nan_to_num(error - self._whole.predicted), slope))

        return self.model.kept.get((self.parameters.tobytes(), "under", self.key), under)


def mesh_torques(
    model: RecordModel, parameters: Floats, sized: Iterable[tuple[tuple[Effect, Values], Any]]
) -> MeshTorques:
    """The effects that add torque, among some; see :class:`MeshTorques`."""
    causes = [((e, nonlinear), one) for (e, nonlinear), one in sized if isinstance(e, MeshTorque)]
    return MeshTorques(model, parameters, tuple(causes))

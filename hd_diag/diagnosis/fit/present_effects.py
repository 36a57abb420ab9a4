"""Several effects in one record: their columns at a point, and their response at full size."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.diagnosis.fit.fitted_rows import FittedRows
from hd_diag.diagnosis.fit.mesh_torques import MeshTorques, mesh_torques
from hd_diag.effects.effect import Effect, Stage, Values, seen_at
from hd_diag.effects.mesh_torque import MeshTorque
from hd_diag.effects.signals import Signals

Item = tuple[Effect, Values]

# Effects with their nonlinear values and coefficients.
Sized = tuple[tuple[Item, Floats], ...]


def plain(effect: Effect) -> bool:
    """Whether an effect is its columns times its coefficients, at any size and with other plain effects."""
    return effect.proportional and not effect.own_slopes and effect.stage in (Stage.REPORTED, Stage.GEAR)


def names(chosen: tuple[Item, ...]) -> Hashable:
    """Names of effects with their nonlinear values, as a key."""
    return tuple((effect.name, nonlinear) for effect, nonlinear in chosen)


@dataclass(frozen=True, eq=False)
class PresentEffects:
    """Effects that are present at some size while a record is linearised.

    Their full-size response beyond their columns is subtracted from the residual. Effects of later stages
    carry what earlier ones add.

    Parameters
    ----------
    data : FittedRows
    parameters : ndarray, shape (p,)
        Where the model is linearised, in units of `fit_parameters.units`.
    present : tuple
    """

    data: FittedRows
    parameters: Floats
    present: Sized

    @cached_property
    def whole(self) -> Signals:
        """Signals of all rows."""
        return self.data.model.at(self.parameters).signals

    @cached_property
    def signals(self) -> Signals:
        """Signals of the fitted rows."""
        return self.data.signals(self.parameters)

    def kept(self, *key: Hashable, compute: Callable[[], Floats]) -> Floats:
        """An array of the fitted rows, cached under a key."""
        return self.data.kept.get(key, compute)

    def columns(self, effect: Effect, nonlinear: Values) -> Floats:
        """Columns of an effect, shape (n, k) [rad per unit]; of a present one, the slopes at its size."""
        return self.kept(
            "columns", *self.context(effect, nonlinear), compute=lambda: self.new_columns(effect, nonlinear)
        )

    @cached_property
    def uncorrected(self) -> Floats:
        """Measured less predicted error of the model alone [rad], shape (n,)."""
        record, ratio = self.data.record, self.data.configured.kinematics.ratio
        return np.asarray(record.output_angle - record.input_angle / ratio - self.signals.predicted)

    @cached_property
    def residual(self) -> Floats:
        """The same less the full-size response of present effects beyond their columns [rad], shape (n,)."""
        # Plain effects without a stage cancel: they see the reported record, and equal their columns.
        more = tuple(one for one in self.present if not plain(one[0][0]) or one[0][0].stage != Stage.REPORTED)

        def corrected() -> Floats:
            first = [self.columns(*item) @ coefficients for item, coefficients in more]
            return np.asarray(self.uncorrected - self.together(more) + sum(first))

        return self.kept("residual", self._at, _key(more), compute=corrected)

    def jacobian(self, reach: Floats | None = None) -> Floats:
        """Derivatives by the parameters under the real torque, as later stages show them, (n, p).

        They are averaged over steps of the parameters if `reach` (p, p) gives these in its columns.
        """
        rounded = self._torques.rounded

        def carried() -> Floats:
            found = rounded.derivatives(reach)
            return self._carried(found, Stage.GEAR, of_teeth=True).take(self.data.at, axis=0)

        steps = None if reach is None else reach.tobytes()
        return self.kept("jacobian", steps, self._at, rounded.key, _key(self._later), compute=carried)

    @cached_property
    def _at(self) -> bytes:
        return self.parameters.tobytes()

    def torque(self, sized: Sized) -> Floats:
        """Torque that effects add in the mesh at all rows [N m], shape (n,)."""
        return mesh_torques(self.data.model, self.parameters, sized).more

    def possible_torques(self, sized: Sized) -> Floats:
        """Torque added by all effects, and without each sought one, whose law may be wrong; (n, k) [N m]."""
        sought = [one for one in sized if isinstance(one[0][0], MeshTorque) and not one[0][0].given]
        parts = [sized, *(tuple(other for other in sized if other is not one) for one in sought)]
        return np.column_stack([self.torque(part) for part in parts])

    def together(self, sized: Sized) -> Floats:
        """Part of several effects in the error [rad], (n,). Torques add up before the mesh bears them."""
        torques = mesh_torques(self.data.model, self.parameters, sized)
        rest = [self.full_size(*item, one) for item, one in sized if item[0].stage != Stage.TORQUE]
        return np.asarray(sum(rest, torques.error.take(self.data.at)))

    def full_size(self, effect: Effect, nonlinear: Values, coefficients: Floats) -> Floats:
        """An effect's part in the error, including contacts made and lost, shape (n,) [rad].

        Coefficients beyond its own belong to its wandering. A torque is added to those present.
        """
        if isinstance(effect, MeshTorque):
            return self._torques.beside(effect, nonlinear, coefficients).take(self.data.at)
        if effect.remembers or effect.stage > Stage.GEAR or effect.wanders(nonlinear):
            return self._of_all_rows(effect, nonlinear, coefficients).take(self.data.at)
        return np.nan_to_num(effect.response(self._there(effect, self._borne), coefficients, nonlinear))

    def _of_all_rows(self, effect: Effect, nonlinear: Values, coefficients: Floats) -> Floats:
        """The part at all rows of an effect that adds no torque."""
        own = effect.size if effect.wanders(nonlinear) else coefficients.size
        found = effect.response(self._seen(effect.stage), coefficients[:own], nonlinear)
        if own < coefficients.size:
            found = found + effect.wandering(self.whole, nonlinear) @ coefficients[own:]
        return np.nan_to_num(found)

    @cached_property
    def _borne(self) -> Signals:
        """Signals of all rows, under the torque that the mesh bears."""
        return self._torques.signals()

    @cached_property
    def _borne_roughly(self) -> Signals:
        """The same for columns, prediction not updated: this is costly, and small torques hardly matter."""
        causes = self._torques.rounded
        return self.whole.bearing(self.whole.torque + causes.more) if causes.more.any() else self.whole

    def _there(self, effect: Effect, borne: Signals) -> Signals:
        """Signals of the fitted rows as an effect sees them; before the gear, it sees the reported record."""
        if effect.stage < Stage.GEAR or borne is self.whole:
            return self.signals
        return borne.part(self.data.at)

    @cached_property
    def _torques(self) -> MeshTorques:
        """Torques of the present effects in the mesh."""
        return mesh_torques(self.data.model, self.parameters, self.present)

    @cached_property
    def _before(self) -> Sized:
        """Present effects that a later stage sees."""
        return tuple(one for one in self.present if Stage.TORQUE <= one[0][0].stage < Stage.STREAM)

    @cached_property
    def _later(self) -> Sized:
        """Present effects that carry what earlier stages add."""
        return tuple(one for one in self.present if one[0][0].stage > Stage.GEAR)

    def context(self, effect: Effect, nonlinear: Values) -> tuple[Hashable, ...]:
        """Cache key of an effect's columns; without the parameters if the motion alone makes the columns."""
        own = tuple(one for one in self._before if one[0] == (effect, nonlinear))
        seen: dict[Stage, Hashable] = {
            Stage.TORQUE: (self._torques.slope_key, _key(own + self._later)),
            Stage.GEAR: (self._torques.rounded.key, _key(self._later)),
            Stage.SPRING: _key(self._before + self._later),
            Stage.STREAM: _key(self._before),
        }
        size = self._size_of(effect, nonlinear)
        own_size = None if size is None else size.tobytes()
        at = None if self._of_motion(effect) else self._at
        return effect.name, nonlinear, at, seen.get(effect.stage), own_size

    def _of_motion(self, effect: Effect) -> bool:
        """Whether the columns depend on neither contact nor prediction."""
        carried = bool(self._later) and self._sees_all(effect)
        apart = effect.stage in (Stage.REPORTED, Stage.GEAR) and not (effect.of_teeth or carried)
        return apart and not any("predicted" in name for name in effect.needs)

    def _size_of(self, effect: Effect, nonlinear: Values) -> Floats | None:
        """Coefficients at which the columns are taken; None if it is absent or size does not matter."""
        if not effect.own_slopes or effect.stage == Stage.TORQUE:
            return None
        return next((one for item, one in self.present if item == (effect, nonlinear)), None)

    def new_columns(self, effect: Effect, nonlinear: Values) -> Floats:
        """As `columns`, not cached."""
        if isinstance(effect, MeshTorque):
            columns = self._torques.columns(effect, nonlinear)
            return self._carried(columns, effect.stage, effect.of_teeth).take(self.data.at, axis=0)
        size = self._size_of(effect, nonlinear)

        def of(seen: Signals) -> Floats:
            own = effect.columns(seen, nonlinear) if size is None else effect.slopes(seen, size, nonlinear)
            return effect.shown(seen, np.nan_to_num(own), nonlinear)

        def whole() -> Floats:
            seen = self._borne_roughly if effect.stage == Stage.GEAR else self._seen(effect.stage)
            columns = of(seen)
            if effect.wanders_by:
                columns = np.concatenate((columns, effect.wandering(seen, nonlinear)), axis=1)
            return columns

        if not self._sees_all(effect):
            return of(self._there(effect, self._borne_roughly))
        if effect.of_teeth and size is None:  # only torque changes them; later stages vary
            key = (self._at, "whole", effect.name, nonlinear, self._torques.rounded.key)
            columns = self.data.model.kept.get(key, whole)
        else:
            columns = whole()
        return self._carried(columns, effect.stage, effect.of_teeth).take(self.data.at, axis=0)

    def _carried(self, columns: Floats, stage: Stage, of_teeth: bool) -> Floats:
        """Columns with what later stages add to them, shape (rows of the whole, k)."""
        for (effect, nonlinear), coefficients in self._later:
            if effect.stage > stage and (of_teeth or effect.stage > Stage.SPRING):
                columns = columns + effect.carry(self.whole, columns, coefficients, nonlinear)
        return columns

    def _sees_all(self, effect: Effect) -> bool:
        """Whether an effect, or one that carries it, depends on earlier rows: then it needs all rows."""
        if effect.remembers or effect.stage > Stage.GEAR or effect.wanders_by:
            return True
        return effect.stage == Stage.GEAR and bool(self._later)

    def _seen(self, stage: Stage) -> Signals:
        """Signals of the whole record, as effects of a stage see them."""
        if stage < Stage.GEAR:
            return self.whole
        if stage == Stage.GEAR:
            return self._borne
        if stage not in self._behind:
            parts = [
                (item[0], self._of_all_rows(*item, coefficients))
                for item, coefficients in self._before
                if Stage.TORQUE < item[0].stage < stage
            ]
            self._behind[stage] = seen_at(stage, self._borne, parts, self.data.model.rate)
        return self._behind[stage]

    @cached_property
    def _behind(self) -> dict[Stage, Signals]:
        return {}


def _key(sized: Sized) -> Hashable:
    return tuple((effect.name, nonlinear, one.tobytes()) for (effect, nonlinear), one in sized)

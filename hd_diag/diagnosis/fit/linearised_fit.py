"""A record linearised about a drive and the causes beside it: columns of a fit, and the fit itself."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Floats
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.design import Design, design, inverse, projection
from hd_diag.diagnosis.fit.fitted_rows import FittedRows, fitted_rows
from hd_diag.diagnosis.noise import ORDER, Whitening, whitening
from hd_diag.diagnosis.record import Record
from hd_diag.drive import Drive
from hd_diag.effects import CATALOGUE, Catalogue
from hd_diag.effects.effect import Effect, Stage, Values
from hd_diag.effects.signals import Signals
from hd_diag.effects.stages import seen_at

_SHIFT = 2e-4  # of the rated torque: steps of its zero between which the derivatives are not told apart
_WHITE = Whitening(np.zeros(ORDER), 1.0)

Item = tuple[Effect, Values]
# Effects with their nonlinear values.
Chosen = tuple[Item, ...]

# The same with their coefficients.
Sized = tuple[tuple[Item, Floats], ...]


@dataclass(frozen=True, eq=False)
class LinearisedFit:
    """Everything that a fit needs at some parameters, beside some effects at their size.

    It never changes: what corrects, moves or whitens it returns another one. All fits of the same rows share
    what was computed.

    Parameters
    ----------
    data : FittedRows
    parameters : ndarray, shape (7,)
        Where the model is linearised, in units of `fit_parameters.SCALES`.
    whiten : Whitening
        Noise model.
    noise_residual : ndarray, shape (n,)
        What the noise was learnt from [rad]; empty before that.
    present : tuple
        Effects that it is linearised beside: what they are at full size beyond their columns is no longer in
        the residual, and effects of later stages carry what earlier ones add.
    """

    data: FittedRows
    parameters: Floats
    whiten: Whitening = _WHITE
    noise_residual: Floats = field(default_factory=lambda: np.empty(0))
    present: Sized = ()

    def moved(self, parameters: Floats) -> LinearisedFit:
        """The same rows and noise, linearised elsewhere beside nothing."""
        return replace(self, parameters=parameters, present=())

    def clear_of(self, shift: float) -> LinearisedFit:
        """Exclude rows where reported torque plus a shift [N m] is near zero; beside nothing."""
        data = fitted_rows(self.data.source, self.data.configured, self.data.catalogue, self.data.mask, shift)
        if np.array_equal(data.mask, self.data.mask):
            return self
        return LinearisedFit(data, self.parameters, self.whiten)

    def with_noise(self, chosen: Chosen) -> LinearisedFit:
        """Whitened by the residual of a model rich enough to leave only noise."""
        broadband = []
        for effect in self.data.searched:
            if effect.broadband and self.data.testable(effect)[0]:
                points = self.data.grid(effect)
                broadband.append(self.columns(effect, points[len(points) // 2]))
        parts = (self.always(), self.joined(chosen), self.data.smooth, *broadband)
        rest = self.residual - projection(np.concatenate(parts, axis=1), self.residual)
        return replace(self, whiten=whitening(rest, self.data.run), noise_residual=rest)

    def corrected(self, chosen: Chosen) -> LinearisedFit:
        """Linearised beside the chosen effects at the size that fits here."""
        return self.beside(self.sized(chosen, self.fit(chosen)[0]))

    def beside(self, sized: Sized) -> LinearisedFit:
        """Linearised beside effects of given coefficients."""
        return replace(self, present=sized)

    def sized(self, chosen: Chosen, beta: Floats) -> Sized:
        """The chosen effects with their coefficients out of a fit's."""
        return tuple((item, beta[place]) for item, place in zip(chosen, self.places(chosen), strict=True))

    @property
    def drive(self) -> Drive:
        """At the parameters."""
        return self.signals.contact.drive

    @cached_property
    def whole(self) -> Signals:
        """Of all rows."""
        return self.data.linearised(self.parameters).whole

    @cached_property
    def signals(self) -> Signals:
        """Of the fitted rows."""
        return self.data.linearised(self.parameters).signals

    @cached_property
    def uncorrected(self) -> Floats:
        """Measured less predicted error of the model alone [rad], shape (n,)."""
        record, ratio = self.data.record, self.data.configured.kinematics.ratio
        return np.asarray(record.output_angle - record.input_angle / ratio - self.signals.predicted)

    @cached_property
    def residual(self) -> Floats:
        """The same less what the present effects are at full size beyond their columns [rad], shape (n,)."""

        def corrected() -> Floats:
            residual = self.uncorrected
            for item, coefficients in self.present:
                beyond = self.full_size(*item, coefficients) - self.columns(*item) @ coefficients
                residual = residual - beyond
            return residual

        return self._kept("residual", _key(self.present), compute=corrected)

    @cached_property
    def jacobian(self) -> Floats:
        """Derivatives by the parameters, under the real torque, as later stages show them, (n, 7)."""
        step = _SHIFT * self.drive.rated_torque
        shift = step * round(sum(item[0].torque_shift(one) for item, one in self.present) / step)

        def carried() -> Floats:
            derivatives = self.data.derivatives(self.parameters, shift)
            return self._carried(derivatives, Stage.GEAR, of_teeth=True).take(self.data.at, axis=0)

        return self._kept("jacobian", shift, _key(self._later), compute=carried)

    def always(self) -> Floats:
        """Columns that every fit carries: the model's derivatives and the zero offset of the encoders."""
        return np.column_stack((self.jacobian, np.ones(self.data.at.size)))

    @cached_property
    def always_white(self) -> Floats:
        """The same whitened."""
        return self.whiten(self.always(), self.data.run)

    @cached_property
    def residual_white(self) -> Floats:
        """The residual whitened."""
        return self.whiten(self.residual, self.data.run)

    def columns(self, effect: Effect, nonlinear: Values) -> Floats:
        """Columns of an effect, shape (n, k) [rad per unit]; of a present one those that hold at its size."""
        return self._kept(
            "columns", *self._context(effect, nonlinear), compute=lambda: self._columns(effect, nonlinear)
        )

    def white(self, effect: Effect, nonlinear: Values, keep: bool = True) -> Floats:
        """Whitened columns of an effect."""
        if not keep:
            return self.whiten(self._columns(effect, nonlinear), self.data.run)
        noise = self.whiten.coefficients.tobytes(), self.whiten.scale
        return self._kept(
            "white",
            *noise,
            *self._context(effect, nonlinear),
            compute=lambda: self.whiten(self.columns(effect, nonlinear), self.data.run),
        )

    def joined(self, chosen: Chosen) -> Floats:
        """Columns of several effects side by side."""
        parts = [self.columns(*item) for item in chosen]
        return np.concatenate([np.empty((self.data.at.size, 0)), *parts], axis=1)

    def places(self, chosen: Chosen) -> list[slice]:
        """Where the coefficients of every chosen effect stand in a fit."""
        edges = np.cumsum([self.always_white.shape[1], *(self.columns(*item).shape[1] for item in chosen)])
        return [slice(first, last) for first, last in pairwise(edges.tolist())]

    def remainder(self, chosen: Chosen) -> Floats:
        """Residual of a fit with some effects, shape (n,) [rad]."""
        columns = np.concatenate((self.always(), self.joined(chosen)), axis=1)
        return np.asarray(self.residual - columns @ self.fit(chosen)[0])

    def full_size(self, effect: Effect, nonlinear: Values, coefficients: Floats) -> Floats:
        """An effect's part in the error, contacts made and lost by it included, shape (n,) [rad].

        Coefficients beyond its own are of what it wanders by.
        """
        if (own := effect.size) < coefficients.size and effect.stage > Stage.NOWHERE:
            wandering = effect.wandering(self.whole, nonlinear).take(self.data.at, axis=0)
            return self.full_size(effect, nonlinear, coefficients[:own]) + wandering @ coefficients[own:]
        if effect.remembers or effect.stage > Stage.GEAR:
            found = effect.response(self._seen(effect.stage), coefficients, nonlinear).take(self.data.at)
        else:
            found = effect.response(self.signals, coefficients, nonlinear)
        return np.nan_to_num(found)

    def amplitude(self, effect: Effect, nonlinear: Values, coefficients: Floats) -> float:
        """Rms of an effect's part in the error where it is fitted [rad].

        Of another torque, along the whole record: most of it is near zero torque, which no fit uses.
        """
        if effect.torque_shift(coefficients):
            return float(np.std(np.nan_to_num(effect.response(self.whole, coefficients, nonlinear))))
        return float(np.std(self.full_size(effect, nonlinear, coefficients)))

    def fit(self, chosen: Chosen, more: Floats | None = None) -> tuple[Floats, Floats, Design]:
        """Coefficients and covariance of [model, offset, effects, more], and their normal equations.

        The model's coefficients are steps from `parameters`, drawn to the prior. `more` are columns (n, k).
        """
        built = self.design(chosen, more)
        center, width = fit_parameters.prior(self.data.configured)
        precision, pull = np.zeros((2, built.moment.shape[1]))
        precision[: fit_parameters.COUNT] = width**-2.0
        pull[: fit_parameters.COUNT] = center - self.parameters
        covariance = inverse(built.gram.sum(axis=0) + np.diag(precision))
        beta = covariance @ (built.moment.sum(axis=0) + precision * pull)
        beta = fit_parameters.bounded(beta, covariance, self.parameters, self.data.configured)
        return beta, covariance, built

    def design(self, chosen: Chosen, more: Floats | None = None) -> Design:
        """Normal equations of [model, offset, effects, more] against the residual."""
        parts = [self.always_white, *(self.white(*item) for item in chosen)]
        if more is not None and more.shape[1]:
            parts.append(self.whiten(more, self.data.run))
        return design(np.concatenate(parts, axis=1), self.residual_white, self.data.block)

    @cached_property
    def _before(self) -> Sized:
        """Present effects that a later stage sees."""
        return tuple(one for one in self.present if Stage.GEAR <= one[0][0].stage < Stage.STREAM)

    @cached_property
    def _later(self) -> Sized:
        """Present effects that carry what earlier stages add."""
        return tuple(one for one in self.present if one[0][0].stage > Stage.GEAR)

    def _kept(self, *key: Hashable, compute: Callable[[], Floats]) -> Floats:
        return self.data.kept.get((self.parameters.tobytes(), *key), compute)

    def _context(self, effect: Effect, nonlinear: Values) -> tuple[Hashable, ...]:
        """What the columns of an effect depend on, beside the parameters."""
        seen: dict[Stage, Sized] = {
            Stage.GEAR: self._later,
            Stage.SPRING: self._before + self._later,
            Stage.STREAM: self._before,
        }
        size = self._size_of(effect, nonlinear)
        return (
            effect.name,
            nonlinear,
            _key(seen.get(effect.stage, ())),
            None if size is None else size.tobytes(),
        )

    def _size_of(self, effect: Effect, nonlinear: Values) -> Floats | None:
        """Coefficients at which its columns are taken, if it is present and they depend on its size."""
        if not effect.own_slopes:
            return None
        return next((one for item, one in self.present if item == (effect, nonlinear)), None)

    def _columns(self, effect: Effect, nonlinear: Values) -> Floats:
        size = self._size_of(effect, nonlinear)

        def of(seen: Signals) -> Floats:
            own = effect.columns(seen, nonlinear) if size is None else effect.slopes(seen, size, nonlinear)
            return np.nan_to_num(own)

        def whole() -> Floats:
            seen = self._seen(effect.stage)
            columns = of(seen)
            if effect.wanders_by:
                columns = np.concatenate((columns, effect.wandering(seen, nonlinear)), axis=1)
            return columns

        if not self._sees_all(effect):
            return of(self.signals)
        if effect.of_teeth and size is None:  # they see no other effect, but what carries them varies
            columns = self._kept("whole", effect.name, nonlinear, compute=whole)
        else:
            columns = whole()
        return self._carried(columns, effect.stage, effect.of_teeth).take(self.data.at, axis=0)

    def _carried(self, columns: Floats, stage: Stage, of_teeth: bool) -> Floats:
        """With what later stages make of them, shape (rows of the whole, k)."""
        for (effect, nonlinear), coefficients in self._later:
            if effect.stage > stage and (of_teeth or effect.stage > Stage.SPRING):
                columns = columns + effect.carry(self.whole, columns, coefficients, nonlinear)
        return columns

    def _sees_all(self, effect: Effect) -> bool:
        """Whether it needs rows that are not fitted: they come before others."""
        if effect.remembers or effect.stage > Stage.GEAR or effect.wanders_by:
            return True
        return effect.stage == Stage.GEAR and bool(self._later)

    def _seen(self, stage: Stage) -> Signals:
        """The whole record, as effects of a stage see it."""
        if stage <= Stage.GEAR:
            return self.whole
        if stage not in self._behind:
            parts = [
                (e, np.nan_to_num(e.response(self._seen(e.stage), coefficients[: e.size], nonlinear)))
                for (e, nonlinear), coefficients in self._before
                if e.stage < stage
            ]
            self._behind[stage] = seen_at(stage, self.whole, parts, self.data.rate)
        return self._behind[stage]

    @cached_property
    def _behind(self) -> dict[Stage, Signals]:
        return {}


def linearise(
    record: Record,
    configured: Drive,
    parameters: Floats,
    rows: npt.NDArray[np.bool_] | None = None,
    catalogue: Catalogue = CATALOGUE,
) -> LinearisedFit:
    """A record linearised about a drive, its noise not known yet; see :class:`FittedRows`.

    Parameters
    ----------
    record : Record
    configured : Drive
    parameters : ndarray, shape (7,)
        In units of `fit_parameters.SCALES`.
    rows : ndarray of bool, shape (n,), optional
        Which rows to fit, where the error is well defined; all without.
    catalogue : tuple of Effect
        Causes to search among.

    Returns
    -------
    LinearisedFit
    """
    return LinearisedFit(fitted_rows(record, configured, catalogue, rows), parameters)


def _key(sized: Sized) -> Hashable:
    return tuple((effect.name, nonlinear, one.tobytes()) for (effect, nonlinear), one in sized)

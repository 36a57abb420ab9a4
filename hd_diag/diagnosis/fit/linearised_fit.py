"""A record linearised about a drive and its causes: columns of a fit, and the fit itself."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Floats, Integers
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.design import Design, design, inverse, orthonormal
from hd_diag.diagnosis.fit.fit_parameters import TORSION
from hd_diag.diagnosis.fit.fitted_rows import FittedRows
from hd_diag.diagnosis.fit.mesh_torques import mesh_torques
from hd_diag.diagnosis.fit.present_effects import Item, PresentEffects, Sized, names, plain
from hd_diag.diagnosis.fit.record_model import RecordModel
from hd_diag.diagnosis.fit.refit import usable
from hd_diag.diagnosis.noise import ORDER, Whitening
from hd_diag.diagnosis.record import Record
from hd_diag.diagnosis.work import Work
from hd_diag.drive import Drive
from hd_diag.effects import CATALOGUE, Catalogue
from hd_diag.effects.effect import Effect, Stage, Values
from hd_diag.effects.mesh_torque import MeshTorque
from hd_diag.effects.scaling import of_drive
from hd_diag.effects.signals import Signals

_HELD = 1e12  # precision of held parameters, in units of `fit_parameters.units`
_WIDENINGS, _AS_WIDE = 4, 1.1  # most rounds; they end when every deviation grows by less than this factor
_WHITE = Whitening(np.zeros(ORDER), 1.0)

# Effects with their nonlinear values.
Chosen = tuple[Item, ...]

# Coefficients, covariance, normal equations, indices of the parameters on a bound.
_Solution = tuple[Floats, Floats, Design, Integers]


@dataclass(frozen=True, eq=False)
class LinearisedFit:
    """Everything that a fit needs at some parameters, with some effects present at their size.

    It is immutable: methods that correct, move or whiten it return a new one. All fits of the same rows share
    cached results.

    Parameters
    ----------
    data : FittedRows
    parameters : ndarray, shape (p,)
        Where the model is linearised, in units of `fit_parameters.units`.
    whiten : Whitening
        Noise model.
    present : tuple
        Effects present in the linearisation. Their full-size response beyond their columns is subtracted from
        the residual, and effects of later stages carry what earlier ones add.
    held : tuple of int
        Indices of parameters that stay where they are, besides those that the record cannot identify.
    misfit : float
        Residual of the chosen effects over the noise, for torque from motor current; else 1. Its square
        scales the prior precision: misfit says nothing about the motor's own torque.
    longer : float
        Factor by which steps of the parameters fall short, estimated from the last steps.
    reach : ndarray, shape (p, p), optional
        Steps of the parameters, in columns, over which slopes are averaged; None for local slopes.
    """

    data: FittedRows
    parameters: Floats
    whiten: Whitening = _WHITE
    present: Sized = ()
    held: tuple[int, ...] = ()
    misfit: float = 1.0
    longer: float = 1.0
    reach: Floats | None = None

    def moved(self, parameters: Floats) -> LinearisedFit:
        """The same rows and noise, linearised elsewhere; only the motor's effects stay present."""
        return replace(self, parameters=parameters, present=self._motor, reach=None)

    def widened(self, chosen: Chosen) -> LinearisedFit:
        """The fit with slopes averaged over the range of the parameters that the record leaves open.

        Local slopes change within this range wherever a pair of teeth comes into load. They would make
        parameters look certain which a remainder of the torque can replace. Steps are those of a cubature
        rule (Arasaratnam and Haykin, IEEE Trans. Automatic Control 54, 2009).
        """
        fit, size = self, self.parameters.size
        free = np.setdiff1d(np.arange(size), self._all_held)
        before = np.zeros(free.size)
        for _ in range(_WIDENINGS):
            spread = fit.fit(chosen)[1][np.ix_(free, free)]
            deviation = np.sqrt(np.diag(spread))
            if np.all(deviation < _AS_WIDE * before):
                break
            values, vectors = np.linalg.eigh(spread / np.multiply.outer(deviation, deviation))
            length = np.sqrt(free.size * np.maximum(values, 0.0))
            reach = np.zeros((size, size))
            reach[np.ix_(free, free)] = deviation[:, None] * vectors * length
            fit, before = replace(fit, reach=reach), deviation
        return fit

    def clear_of(self, shift: Floats) -> LinearisedFit:
        """Exclude rows where the torque may be near zero, see :func:`usable`; as :meth:`moved`."""
        data = self.data.on(self.data.mask & usable(self.data.source, shift))
        return self if data is self.data else replace(self, data=data, present=self._motor)

    def in_record(self, record: Record, rows: npt.NDArray[np.bool_]) -> LinearisedFit:
        """A fit on rows (n,) of another record of the same joint, with known noise; no effect is present."""
        model = RecordModel(record, self.data.configured, self.work)
        data = FittedRows(model, usable(record) & rows, self.data.catalogue, self.data.known)
        return LinearisedFit(data, self.parameters)

    def on(self, rows: npt.NDArray[np.bool_]) -> LinearisedFit:
        """A fit on other rows (n,) of the record, their noise not known yet; as :meth:`moved`."""
        return replace(self, data=self.data.on(rows), whiten=_WHITE, misfit=1.0, present=self._motor)

    @property
    def _motor(self) -> Sized:
        """Present effects of the motor, which are part of every fit."""
        return tuple(one for one in self.present if one[0][0].given)

    def with_noise(self, chosen: Chosen, richer: bool = True) -> LinearisedFit:
        """The fit whitened by the residual of the chosen effects and, if `richer`, of flexible columns.

        With flexible columns the residual contains only noise.
        """
        (rest, fitted), misfit = self._beyond(chosen, *([self.flexible()] if richer else [])), 1.0
        if richer and self.data.given:
            misfit = float(np.std(self._beyond(chosen)[0]) / max(float(np.std(rest)), 1e-300))
        return replace(self, whiten=self.data.whitening_of(rest, fitted), misfit=misfit)

    def passed(self) -> LinearisedFit:
        """The fit with the noise that repeated passes measure, known to all fits of these rows."""
        known = self.data.passes(self._beyond((), self.flexible())[0])
        return replace(self, data=replace(self.data, known=known))

    def _beyond(self, chosen: Chosen, *more: Floats) -> tuple[Floats, Floats]:
        """Residual (n,) [rad] with columns projected out, and these columns, orthonormal.

        The columns are those that every fit carries, those of some effects, and `more` (n, k).
        """
        wide = orthonormal(np.concatenate((self.always(), self.joined(chosen), *more), axis=1))
        return np.asarray(self.residual - wide @ (wide.T @ self.residual)), wide

    def flexible(self) -> Floats:
        """Columns (n, k) that can imitate any cause, so that hardly more than noise remains."""
        broadband = []
        for effect in self.data.searched:
            if effect.broadband and self.data.testable(effect)[0]:
                points = self.data.grid(effect)
                broadband.append(self.columns(effect, points[len(points) // 2]))
        return np.concatenate((self.data.smooth, *broadband), axis=1)

    def corrected(self, chosen: Chosen) -> LinearisedFit:
        """The fit with chosen effects present at their fitted size. If all are plain its solution stays."""
        solution = self._fit(chosen)
        found = self.beside(self.sized(chosen, solution[0]))
        if all(plain(effect) for effect, _ in (*chosen, *(item for item, _ in self.present))):
            found._solutions[names(chosen)] = solution
        return found

    def beside(self, sized: Sized) -> LinearisedFit:
        """The fit with effects present at given coefficients."""
        return replace(self, present=sized)

    def recentred(self) -> LinearisedFit:
        """The fit about the link torque: the record's, corrected by the present effects of the motor."""
        data = self.data
        torques = mesh_torques(data.model, self.parameters, self._motor)
        if not torques.causes or torques.near:
            return self
        source = data.source.less_motor(data.source.torque + torques.more - data.source.by_sensor)
        model = RecordModel(source, data.configured, data.model.work)
        return replace(self, data=FittedRows(model, data.mask, data.catalogue, data.known))

    def sized(self, chosen: Chosen, beta: Floats) -> Sized:
        """The chosen effects, each with its coefficients from a fit's."""
        return tuple((item, beta[place]) for item, place in zip(chosen, self.places(chosen), strict=True))

    @property
    def work(self) -> Work:
        """The work that all fits of the record belong to."""
        return self.data.model.work

    @property
    def drive(self) -> Drive:
        """The drive at the parameters."""
        return self.signals.contact.drive

    @cached_property
    def effects(self) -> PresentEffects:
        """The effects present in the linearisation."""
        return PresentEffects(self.data, self.parameters, self.present)

    @property
    def whole(self) -> Signals:
        """Signals of all rows."""
        return self.effects.whole

    @property
    def signals(self) -> Signals:
        """Signals of the fitted rows."""
        return self.effects.signals

    @property
    def _all_held(self) -> list[int]:
        """Indices of parameters held by this fit or by all fits of the record."""
        return [*self.held, *self.data.held]

    @cached_property
    def residual(self) -> Floats:
        """Measured less predicted error, less present effects beyond their columns [rad], (n,)."""
        return self.effects.residual

    @cached_property
    def jacobian(self) -> Floats:
        """Derivatives by the parameters, zero for held ones, (n, p)."""
        found = self.effects.jacobian(self.reach).copy()
        found[:, self._all_held] = 0.0
        return found

    def always(self) -> Floats:
        """Columns that every fit carries: the model's derivatives and the encoders' zeros."""
        return np.column_stack((self.jacobian, self.data.offsets))

    @cached_property
    def always_white(self) -> Floats:
        """These columns whitened."""
        return self.whiten(self.always(), self.data.run)

    @cached_property
    def residual_white(self) -> Floats:
        """The residual whitened."""
        return self.whiten(self.residual, self.data.run)

    def roughly(self, effect: Effect) -> LinearisedFit:
        """The fit in which to look for an effect: at nearby parameters if the effect comes from the teeth.

        Load sharing is cached there. Once chosen, the effect gets columns of its own.
        """
        return self._near if effect.of_teeth or effect.stage == Stage.SPRING else self

    @cached_property
    def _near(self) -> LinearisedFit:
        parameters = self.data.model.near(self.parameters)
        return self if parameters is self.parameters else replace(self, parameters=parameters)

    def columns(self, effect: Effect, nonlinear: Values) -> Floats:
        """Columns of an effect, shape (n, k) [rad per unit]; of a present one, the slopes at its size."""
        return self.effects.columns(effect, nonlinear)

    def white(self, effect: Effect, nonlinear: Values, keep: bool = True) -> Floats:
        """Whitened columns of an effect, cached if `keep`; raises OutOfTime if there is no more time."""
        self.work.check()
        if not keep:
            return self.whiten(self.effects.new_columns(effect, nonlinear), self.data.run)
        noise = self.whiten.key
        return self.effects.kept(
            "white",
            *noise,
            *self.effects.context(effect, nonlinear),
            compute=lambda: self.whiten(self.columns(effect, nonlinear), self.data.run),
        )

    def whitened(self, chosen: Chosen) -> Floats:
        """Whitened columns of [model, offset, effects], (n, k)."""
        return np.concatenate((self.always_white, *(self.white(*item) for item in chosen)), axis=1)

    def joined(self, chosen: Chosen) -> Floats:
        """Columns of several effects side by side."""
        parts = [self.columns(*item) for item in chosen]
        return np.concatenate([np.empty((self.data.at.size, 0)), *parts], axis=1)

    def places(self, chosen: Chosen) -> list[slice]:
        """Slice of each chosen effect's coefficients in a fit."""
        edges = np.cumsum([self.always_white.shape[1], *map(self._count, chosen)])
        return [slice(first, last) for first, last in pairwise(edges.tolist())]

    def _count(self, item: Item) -> int:
        """Number of columns of an effect. It depends on the rows, not on the parameters."""
        known, key = self.data.counts, (item[0].name, item[1])
        if key not in known:
            known[key] = self.columns(*item).shape[1]
        return known[key]

    def torsion(self, beta: Floats) -> Floats:
        """Error by a fit's datum and compliances less the configured ones [rad], (n,); `beta` is (k,)."""
        configured = fit_parameters.vector(self.data.configured, self.data.configured)
        step = self.parameters + beta[: self.parameters.size] - configured
        return np.asarray(self.jacobian[:, TORSION] @ step[TORSION])

    def remainder(self, chosen: Chosen) -> Floats:
        """Residual of a fit with some effects, shape (n,) [rad]."""
        columns = np.concatenate((self.always(), self.joined(chosen)), axis=1)
        return np.asarray(self.residual - columns @ self.fit(chosen)[0])

    def part(self, effect: Effect, nonlinear: Values, coefficients: Floats) -> Floats:
        """An effect's part in the error at the fitted rows [rad], (n,).

        If the effect adds torque, at all rows: most of its part is near zero torque, and no fit uses these.
        """
        if isinstance(effect, MeshTorque):
            beside = mesh_torques(self.data.model, self.parameters, self._motor)
            return beside.beside(effect, nonlinear, coefficients)
        return self.effects.full_size(effect, nonlinear, coefficients)

    def fit(self, chosen: Chosen, more: Floats | None = None) -> tuple[Floats, Floats, Design]:
        """Coefficients and covariance of [model, offset, effects, more], and their normal equations.

        The model's coefficients are steps from `parameters`; see :meth:`prior`. `more` are columns (n, k).
        """
        beta, covariance, built, _ = self._fit(chosen, more)
        return beta, covariance, built

    def design(self, chosen: Chosen, more: Floats | None = None) -> Design:
        """Normal equations of [model, offset, effects, more] against the residual.

        A parameter that the fit puts on a bound is fixed there, as in the fit.
        """
        beta, _, built, held = self._fit(chosen, more)
        return built.holding(held, beta[held])

    def deviance(self, chosen: Chosen, more: Floats | None = None) -> float:
        """Residual sum of squares of such a fit with that of the prior, in units of the noise."""
        return self.design(chosen, more).deviance()

    def cost(self, chosen: Chosen) -> float:
        """Deviance at the linearisation, with the chosen effects as present; encoder zeros are free."""
        beta, _, built, _ = self._fit(chosen)
        values = self.at_present(chosen, beta)
        fixed = np.delete(np.arange(beta.size), np.r_[self.parameters.size : self.always_white.shape[1]])
        return built.deviance_at(fixed, values[fixed])

    def at_present(self, chosen: Chosen, beta: Floats) -> Floats:
        """Coefficients (k,) at the linearisation: no steps, present effects, encoder zeros of `beta`."""
        values, known = beta.copy(), dict(self.present)
        values[: self.parameters.size] = 0.0
        for item, place in zip(chosen, self.places(chosen), strict=True):
            values[place] = known.get(item, 0.0)
        return values

    def on_bounds(self, chosen: Chosen) -> tuple[Integers, Floats]:
        """Indices of the parameters that a fit puts on a bound, and its steps to the bound."""
        beta, _, _, held = self._fit(chosen)
        return held, beta[held]

    def _fit(self, chosen: Chosen, more: Floats | None = None) -> _Solution:
        if more is not None and more.shape[1]:
            return self._solved(chosen, more)
        key = names(chosen)
        if key not in self._solutions:
            self._solutions[key] = self._solved(chosen, np.empty((self.data.at.size, 0)))
        return self._solutions[key]

    @cached_property
    def _solutions(self) -> dict[Hashable, _Solution]:
        return {}

    def _solved(self, chosen: Chosen, more: Floats) -> _Solution:
        columns = self.whitened(chosen)
        if more.shape[1]:
            columns = np.concatenate((columns, self.whiten(more, self.data.run)), axis=1)
        precision, pull = np.zeros((2, columns.shape[1]))
        prior = self.prior(chosen)
        precision[: prior[0].size], pull[: prior[1].size] = prior
        block, alone = self.data.block, self._wandering(chosen)
        built = design(columns, self.residual_white, block, precision, pull, alone)
        gram, moment = built.whole
        covariance = inverse(gram)
        beta, held = fit_parameters.bounded(
            covariance @ moment, covariance, self.parameters, self.data.configured
        )
        return beta, covariance, built, held

    def _wandering(self, chosen: Chosen) -> Integers:
        """Indices of the columns that let chosen effects wander."""
        found = [np.empty(0, np.int64)]
        for (effect, nonlinear), place in zip(chosen, self.places(chosen), strict=True):
            if effect.wanders(nonlinear):
                found.append(np.arange(place.start + effect.size, place.stop))
        return np.concatenate(found)

    def prior(self, chosen: Chosen) -> tuple[Floats, Floats]:
        """Prior precision of the coefficients of [model, offset, effects], and its centre; (k,) each.

        The model's have the prior of a drive, those of an effect have its `reach` as standard deviation.
        """
        places = self.places(chosen)
        center, width = fit_parameters.prior(self.data.configured)
        precision, pull = np.zeros((2, places[-1].stop if places else self.always_white.shape[1]))
        precision[: width.size] = width**-2.0
        pull[: width.size] = center - self.parameters
        precision[self._all_held], pull[self._all_held] = _HELD, 0.0
        for (effect, _), place in zip(chosen, places, strict=True):
            if effect.standard:
                precision[place] = 1.0 / self.misfit**2  # cancels the misfit: no larger for a remainder
                continue
            precision[place.start : place.start + effect.size] = effect.reach**-2.0
        return precision * self.misfit**2, pull


def linearise(
    record: Record,
    configured: Drive,
    parameters: Floats,
    rows: npt.NDArray[np.bool_] | None = None,
    catalogue: Catalogue = CATALOGUE,
    work: Work | None = None,
) -> LinearisedFit:
    """A record linearised about a drive, its noise not known yet; see :class:`FittedRows`.

    `parameters` (p,) are in units of `fit_parameters.units`. Of `rows` (n,), by default all, it uses those
    where the error is well defined. Without `work` there is no time limit. Usual sizes of the catalogue are
    scaled to the drive.
    """
    found = usable(record)
    mask = found if rows is None else found & rows
    model = RecordModel(record, configured, work or Work())
    rows_of = FittedRows(model, mask, of_drive(catalogue, configured))
    return LinearisedFit(rows_of, parameters)

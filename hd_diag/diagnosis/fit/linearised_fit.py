"""A record linearised about a drive: the columns of every fit, whitened, and the fit itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Floats, Integers
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.design import Design, design, inverse, solve
from hd_diag.diagnosis.fit.refit import usable
from hd_diag.diagnosis.noise import ORDER, Whitening, bounds, whitening
from hd_diag.diagnosis.record import Record
from hd_diag.drive import Drive
from hd_diag.effects import CATALOGUE, Catalogue
from hd_diag.effects.contact_weights import ContactWeights
from hd_diag.effects.effect import Effect, Stage
from hd_diag.effects.signals import Signals
from hd_diag.effects.stages import seen_at

Rows = npt.NDArray[np.bool_]

_BLOCKS = 24
_MOST_KEPT = 32 << 20  # bytes
_MOST_COLUMNS = 96 << 20  # bytes
_KNOWN = 2  # parameters, for a search that goes back to them
_SHIFT = 2e-4  # of the rated torque; a smaller change of the torque's zero changes no derivative
_SETTLED = 1.0  # standard deviations; the model is linear over such steps
Linear = dict[bytes, tuple[Signals, Signals, Floats]]


@dataclass
class Known:
    """What benches of the same rows share.

    Attributes
    ----------
    linear : dict
        Linearisations by the parameters, the latest last.
    general : ndarray, shape (n, k), optional
        Columns that any cause may look like and no parameter changes.
    """

    linear: Linear = field(default_factory=dict)
    general: Floats | None = None


Chosen = tuple[tuple[Effect, tuple[float, ...]], ...]
Present = Sequence[tuple[tuple[Effect, tuple[float, ...]], Floats]]
"""Effects with their nonlinear values, and their coefficients."""


class Workbench:
    """A record with a drive: everything that a fit needs, whitened once.

    Parameters
    ----------
    record : Record
        All that is known: causes with memory go through every row of it.
    configured : Drive
    parameters : ndarray, shape (7,)
        Where the model is linearised, in units of `fit_parameters.SCALES`.
    whiten : Whitening, optional
        Noise model to begin with.
    rows : ndarray of bool, shape (n,), optional
        Which rows to fit, where the error is well defined; all without.
    known : Known, optional
        What benches of the same rows share.

    Attributes
    ----------
    record, signals : Record, Signals
        Of the rows that are fitted.
    whole : Signals
        Of all rows.
    """

    def __init__(
        self,
        record: Record,
        configured: Drive,
        parameters: Floats,
        whiten: Whitening | None = None,
        rows: Rows | None = None,
        known: Known | None = None,
        catalogue: Catalogue = CATALOGUE,
    ) -> None:
        self.source = record
        self.catalogue = catalogue
        self.configured = configured
        known = Known() if known is None else known
        self.rows = usable(record) if rows is None else usable(record) & rows
        self._known = known
        self._at = np.flatnonzero(self.rows)  # several times as fast as a mask
        self.record = replace(record, stretch=record.stretches).select(self.rows)
        self.run = _broken(record, self.rows)
        self.parameters = parameters
        self.drive = fit_parameters.drive_of(parameters, configured)
        self.whole, self.signals, derivatives = self._linearised(known.linear)
        self.error, self.jacobian = self.signals.predicted, derivatives.take(self._at, axis=0)
        rec = self.record
        self.left = rec.output_angle - rec.input_angle / configured.kinematics.ratio - self.error
        self.uncorrected = self.left
        self.nuisance = np.ones((rec.size, 1))
        self._derivatives, self._shift = derivatives, 0.0
        self._before: Present = []
        self._later: Present = []
        self._behind: dict[Stage, Signals] = {}
        self.block = blocks(self.run)
        self._columns: dict[tuple[str, tuple[float, ...]], Floats] = {}
        self._uncarried: dict[tuple[str, tuple[float, ...]], Floats] = {}
        self._secants: dict[tuple[str, tuple[float, ...]], Floats] = {}  # of the chosen: never left out
        self.noise_residual = np.empty(0)
        self._white: dict[tuple[str, tuple[float, ...]], Floats] = {}
        self._testable: dict[str, tuple[bool, str]] = {}
        self._grids: dict[str, list[tuple[float, ...]]] = {}
        self._whiten_by(whiten or Whitening(np.zeros(ORDER), 1.0))

    def moved(self, parameters: Floats) -> Workbench:
        """The same rows and noise, linearised elsewhere."""
        other = Workbench(
            self.source, self.configured, parameters, self.whiten, self.rows, self._known, self.catalogue
        )
        other.noise_residual = self.noise_residual
        return other

    def clear_of(self, shift: float) -> Workbench:
        """Without the rows in which the real torque, as much above the reported one, is near zero [N m]."""
        rows = self.rows & usable(self.source, shift)
        if np.array_equal(rows, self.rows):
            return self
        return Workbench(
            self.source, self.configured, self.parameters, self.whiten, rows, catalogue=self.catalogue
        )

    def _linearised(self, known: Linear) -> tuple[Signals, Signals, Floats]:
        """Signals of all rows and of those that are fitted, and the derivatives by the parameters."""
        key, record = self.parameters.tobytes(), self.source
        if key not in known:
            error, derivatives, slope = fit_parameters.along(
                self.drive, self.configured, record.input_angle, record.torque
            )
            whole = signals(record, self.drive, error, slope)
            known[key] = whole, whole.part(self._at), derivatives
        known[key] = known.pop(key)
        while len(known) > _KNOWN:
            del known[next(iter(known))]
        return known[key]

    def columns(self, effect: Effect, nonlinear: tuple[float, ...]) -> Floats:
        """Columns of an effect, shape (n, k) [rad per unit]."""
        key = (effect.name, nonlinear)
        if key in self._secants:
            return self._secants[key]
        if key not in self._columns:
            _make_room(self._columns)
            self._columns[key] = self._fresh(effect, nonlinear)
        return self._columns[key]

    def white(self, effect: Effect, nonlinear: tuple[float, ...], keep: bool = True) -> Floats:
        """Whitened columns of an effect."""
        key = (effect.name, nonlinear)
        if key in self._white:
            return self._white[key]
        columns = self.columns(effect, nonlinear) if keep else self._fresh(effect, nonlinear)
        white = self.whiten(columns, self.run)
        if keep:
            _make_room(self._white)
            self._white[key] = white
        return white

    def testable(self, effect: Effect) -> tuple[bool, str]:
        """Whether the record's motion allows to find an effect; if not, which extra motion would."""
        if effect.name not in self._testable:
            self._testable[effect.name] = effect.testable(self.signals)
        return self._testable[effect.name]

    @property
    def searched(self) -> Catalogue:
        """Effects of the catalogue that are searched for in the residual."""
        return tuple(effect for effect in self.catalogue if effect.searched)

    def grid(self, effect: Effect) -> list[tuple[float, ...]]:
        """Start points of an effect's nonlinear values on this record."""
        if effect.name not in self._grids:
            self._grids[effect.name] = effect.starts(self.signals).points
        return self._grids[effect.name]

    def grid_step(self, effect: Effect, point: tuple[float, ...]) -> Floats:
        """Distance from a grid point to the next, in each nonlinear value."""
        grid = np.array([*self.grid(effect), point])
        away = np.abs(grid - np.array(point))
        steps = [np.min(column[column > 0.0], initial=np.inf) for column in away.T]
        return np.array(
            [s if np.isfinite(s) else 0.1 * max(abs(p), 1e-3) for s, p in zip(steps, point, strict=True)]
        )

    def joined(self, chosen: Chosen) -> Floats:
        """Columns of several effects side by side."""
        parts = [self.columns(effect, nonlinear) for effect, nonlinear in chosen]
        return np.concatenate(parts, axis=1) if parts else np.empty((self.left.size, 0))

    def places(self, chosen: Chosen) -> list[slice]:
        """Where the coefficients of every chosen effect stand in a fit."""
        edges = np.cumsum([self.always_white.shape[1], *(self.columns(*item).shape[1] for item in chosen)])
        return [slice(first, last) for first, last in pairwise(edges.tolist())]

    def remainder(self, chosen: Chosen) -> Floats:
        """What the model with some effects leaves, shape (n,) [rad]."""
        beta, _, _ = self.fit(chosen)
        return np.asarray(self.left - np.concatenate((self.always(), self.joined(chosen)), axis=1) @ beta)

    def always(self) -> Floats:
        """Columns that every fit carries: the model's derivatives and the zero offset of the encoders."""
        return np.concatenate((self.jacobian, self.nuisance), axis=1)

    def learn_noise(self, chosen: Chosen) -> None:
        """Whiten by the residual of a model rich enough to leave only noise."""
        rich = np.concatenate((self.always(), self.joined(chosen), self._general()), axis=1)
        rest = self.left - _projection(rich, self.left)
        self.noise_residual = rest
        self._whiten_by(whitening(rest, self.run))

    def correct(self, chosen: Chosen) -> None:
        """Take what the chosen effects are at full size beyond their columns out of what the model leaves."""
        self.correct_at(self.sized(chosen, self.fit(chosen)[0]))

    def sized(self, chosen: Chosen, beta: Floats) -> Present:
        """The chosen effects with their coefficients out of a fit's."""
        return [(item, beta[place]) for item, place in zip(chosen, self.places(chosen), strict=True)]

    def correct_at(self, sized: Present) -> None:
        """The same at given coefficients."""
        self.see(sized)
        for key in self._secants:
            self._white.pop(key, None)
        self._secants.clear()
        correction = np.zeros(self.left.size)
        for (effect, nonlinear), coefficients in sized:
            if effect.own_slopes:
                key = (effect.name, nonlinear)
                self._secants[key] = self._secant(effect, nonlinear, coefficients)
                self._white.pop(key, None)
            columns = self.columns(effect, nonlinear)
            correction += self.full_size(effect, nonlinear, coefficients) - columns @ coefficients
        self.left = self.uncorrected - correction
        self.left_white = self.whiten(self.left, self.run)

    def full_size(self, effect: Effect, nonlinear: tuple[float, ...], coefficients: Floats) -> Floats:
        """An effect's part in the error, contacts made and lost by it included, shape (n,) [rad].

        Coefficients beyond its own are of what it wanders by.
        """
        if (own := effect.size) < coefficients.size and effect.stage > Stage.NOWHERE:
            wandering = effect.wandering(self.whole, nonlinear).take(self._at, axis=0) @ coefficients[own:]
            return self.full_size(effect, nonlinear, coefficients[:own]) + wandering
        if effect.remembers or effect.stage > Stage.GEAR:
            return np.nan_to_num(effect.response(self._seen(effect), coefficients, nonlinear).take(self._at))
        return np.nan_to_num(effect.response(self.signals, coefficients, nonlinear))

    def amplitude(self, effect: Effect, nonlinear: tuple[float, ...], coefficients: Floats) -> float:
        """Rms of an effect's part in the error where it is fitted [rad].

        Of another torque, along the whole record: most of it is near zero torque, which no fit uses.
        """
        if effect.torque_shift(coefficients):
            return float(np.std(np.nan_to_num(effect.response(self.whole, coefficients, nonlinear))))
        return float(np.std(self.full_size(effect, nonlinear, coefficients)))

    def see(self, present: Present) -> None:
        """Let effects see each other at these coefficients: later stages carry what earlier ones add."""
        before = [one for one in present if Stage.GEAR <= one[0][0].stage < Stage.STREAM]
        later = [one for one in present if one[0][0].stage > Stage.GEAR]
        changed = set[Stage]()
        if before or self._before:
            changed |= {Stage.SPRING, Stage.STREAM}
        if later or self._later:
            changed |= {Stage.GEAR, Stage.SPRING}
        moved = self._under(sum(effect.torque_shift(coefficients) for (effect, _), coefficients in present))
        self._before, self._later = before, later
        self._behind.clear()
        stages = {effect.name: effect.stage for effect in self.catalogue}
        for kept in (self._columns, self._white):
            for key in [key for key in kept if stages.get(key[0]) in changed]:
                del kept[key]
        if moved or Stage.GEAR in changed:
            self.jacobian = self._carried(self._derivatives, Stage.GEAR, of_teeth=True).take(self._at, axis=0)
            self.always_white = self.whiten(self.always(), self.run)

    def _under(self, shift: float) -> bool:
        """Let the model's derivatives be those under a torque that differs [N m]; whether they change."""
        if abs(shift - self._shift) < _SHIFT * self.drive.rated_torque:
            return False
        rec = self.source
        self._shift = shift
        _, self._derivatives, _ = fit_parameters.along(
            self.drive, self.configured, rec.input_angle, rec.torque + shift
        )
        return True

    def _fresh(self, effect: Effect, nonlinear: tuple[float, ...]) -> Floats:
        if not self._sees_all(effect):
            return np.nan_to_num(effect.columns(self.signals, nonlinear))
        columns = self._of_teeth(effect, nonlinear) if effect.of_teeth else self._of_whole(effect, nonlinear)
        return self._carried(columns, effect.stage, effect.of_teeth).take(self._at, axis=0)

    def _of_whole(self, effect: Effect, nonlinear: tuple[float, ...]) -> Floats:
        """Columns at all rows, not carried by later stages."""
        seen = self._seen(effect)
        columns = np.nan_to_num(effect.columns(seen, nonlinear))
        return np.concatenate((columns, effect.wandering(seen, nonlinear)), axis=1)

    def _of_teeth(self, effect: Effect, nonlinear: tuple[float, ...]) -> Floats:
        """The same of an effect that sees no other: kept, for it takes long and what carries it varies."""
        key = (effect.name, nonlinear)
        if key not in self._uncarried:
            if sum(columns.nbytes for columns in self._uncarried.values()) > _MOST_KEPT:
                self._uncarried.clear()
            self._uncarried[key] = self._of_whole(effect, nonlinear)
        return self._uncarried[key]

    def _secant(self, effect: Effect, nonlinear: tuple[float, ...], coefficients: Floats) -> Floats:
        """Columns that hold at a size."""
        if not self._sees_all(effect):
            return np.nan_to_num(effect.slopes(self.signals, coefficients, nonlinear))
        columns = np.nan_to_num(effect.slopes(self._seen(effect), coefficients, nonlinear))
        return self._carried(columns, effect.stage, effect.of_teeth).take(self._at, axis=0)

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

    def _seen(self, effect: Effect) -> Signals:
        """The whole record, as an effect sees it."""
        if effect.stage <= Stage.GEAR:
            return self.whole
        if effect.stage not in self._behind:
            parts = [
                (e, np.nan_to_num(e.response(self._seen(e), coefficients[: e.size], nonlinear)))
                for (e, nonlinear), coefficients in self._before
                if e.stage < effect.stage
            ]
            self._behind[effect.stage] = seen_at(effect.stage, self.whole, parts, self._rate)
        return self._behind[effect.stage]

    def _rate(self, error: Floats) -> Floats:
        return _rate(self.source, error)

    def _whiten_by(self, whiten: Whitening) -> None:
        self.whiten = whiten
        self._white.clear()
        self.always_white = whiten(self.always(), self.run)
        self.left_white = whiten(self.left, self.run)

    def _general(self) -> Floats:
        """What any cause may look like: low orders, powers of torque, direction, speed; with slow ones."""
        if self._known.general is None:
            self._known.general = self._smooth()
        columns = [self._known.general]
        for effect in self.searched:
            if effect.broadband and self.testable(effect)[0]:
                points = self.grid(effect)
                columns.append(self.columns(effect, points[len(points) // 2]))
        return np.concatenate(columns, axis=1)

    def _smooth(self) -> Floats:
        s = self.signals
        theta, turned = s.wave_generator_angle, s.wave_generator_angle + s.output_angle
        load = s.torque / max(float(np.max(np.abs(s.torque))), 1e-9)
        columns = [f(k * theta) for k in (1, 2, 3, 4, 6, 8) for f in (np.cos, np.sin)]
        columns += [f(k * theta) * load for k in (1, 2, 4) for f in (np.cos, np.sin)]
        columns += [f(k * turned) for k in (2, 4) for f in (np.cos, np.sin)]
        columns += [
            load**3,
            load * np.abs(load),
            np.abs(load),
            load * s.speed / max(np.max(np.abs(s.speed)), 1e-9),
        ]
        return np.stack(columns).T

    def fit(self, chosen: Chosen, more: Floats | None = None) -> tuple[Floats, Floats, Design]:
        """Coefficients and covariance of [model, nuisance, effects, more], and their normal equations.

        The model's coefficients are steps from `parameters`, drawn to the prior. `more` are columns (n, k).
        """
        built = self.design(chosen, more)
        center, width = fit_parameters.prior(self.configured)
        precision, pull = np.zeros(built.moment.shape[1]), np.zeros(built.moment.shape[1])
        precision[: fit_parameters.COUNT], pull[: fit_parameters.COUNT] = (
            width**-2.0,
            center - self.parameters,
        )
        gram = built.gram.sum(axis=0) + np.diag(precision)
        moment = built.moment.sum(axis=0) + precision * pull
        covariance = inverse(gram)
        return self._bounded(covariance @ moment, covariance), covariance, built

    def _bounded(self, beta: Floats, covariance: Floats) -> Floats:
        """The best coefficients whose parameters a drive can have: those beyond a bound lie on it."""
        low, high = fit_parameters.bounds(self.configured)
        held = np.zeros(fit_parameters.COUNT, dtype=bool)
        found = beta
        for _ in range(fit_parameters.COUNT):
            at = self.parameters + found[: fit_parameters.COUNT]
            beyond = ((at < low - 1e-9) | (at > high + 1e-9)) & ~held
            if not beyond.any():
                break
            held |= beyond
            rows = np.flatnonzero(held)
            wanted = (
                np.clip(self.parameters + beta[: fit_parameters.COUNT], low, high)[rows]
                - self.parameters[rows]
            )
            spread = covariance[np.ix_(rows, rows)]
            found = beta - covariance[:, rows] @ np.linalg.solve(spread, beta[rows] - wanted)
        return found

    def design(self, chosen: Chosen, more: Floats | None = None) -> Design:
        """Normal equations of [model, nuisance, effects, more] against what the model leaves."""
        parts = [self.always_white, *(self.white(effect, nonlinear) for effect, nonlinear in chosen)]
        if more is not None and more.shape[1]:
            parts.append(self.whiten(more, self.run))
        return design(np.concatenate(parts, axis=1), self.left_white, self.block, self.left_white != 0.0)

    def design_with(self, whiten: Whitening, chosen: Chosen) -> Design:
        """The same with another bench's noise model, so that deviances compare."""
        columns = np.concatenate((self.always(), self.joined(chosen)), axis=1)
        left = whiten(self.left, self.run)
        return design(whiten(columns, self.run), left, self.block, left != 0.0)


def _make_room(kept: dict[tuple[str, tuple[float, ...]], Floats]) -> None:
    if sum(columns.nbytes for columns in kept.values()) > _MOST_COLUMNS:
        kept.clear()


def _scales(columns: Floats) -> Floats:
    mean_square: Floats = np.mean(columns**2, axis=0)
    return np.sqrt(np.maximum(mean_square, 1e-300))


def _projection(columns: Floats, target: Floats) -> Floats:
    """Part of the target that columns of any scale explain."""
    scaled = columns / _scales(columns)
    return np.asarray(scaled @ solve(scaled.T @ scaled, scaled.T @ target))


def signals(record: Record, drive: Drive, error: Floats, slope: Floats) -> Signals:
    """What the effects need of a record and the model's prediction along it."""
    angle = drive.frame.wave_generator_angle(record.input_angle)
    return Signals(
        time=record.time,
        wave_generator_angle=angle,
        output_angle=record.input_angle / drive.frame.ratio,
        speed=record.speed,
        torque=record.torque,
        temperature=record.temperature,
        run=record.stretches,
        predicted=error,
        predicted_torque_slope=slope,
        predicted_rate=_rate(record, error),
        contact=ContactWeights(drive, angle, record.torque, torsion=_torsion(drive, error, record.torque)),
    )


def _torsion(drive: Drive, error: Floats, torque: Floats) -> Floats:
    """Of the mesh, from the transmission error that it makes [rad]."""
    return np.asarray(-drive.frame.torque_sign * (error + drive.cup_compliance * torque))


def _rate(record: Record, values: Floats) -> Floats:
    """Derivative by time, run by run."""
    rate = np.zeros(record.size)
    for begin, end in bounds(record.run):
        if end - begin > 2:
            rate[begin:end] = np.gradient(values[begin:end], record.time[begin:end])
    return rate


def blocks(run: Integers) -> Integers:
    """About `_BLOCKS` contiguous stretches of equal length; shape (n,)."""
    return (np.arange(run.size) * _BLOCKS // max(run.size, 1)).astype(np.int64)


def _broken(record: Record, kept: npt.NDArray[np.bool_]) -> Integers:
    """Run numbers of the kept rows, with a new number after every row left out."""
    gap = np.concatenate(([False], np.diff(np.flatnonzero(kept)) > 1))
    change = np.concatenate(([False], np.diff(record.run[kept]) != 0))
    return np.cumsum(gap | change).astype(np.int64)


def settle(bench: Workbench, chosen: Chosen, rounds: int = 3, learn: bool = True) -> Workbench:
    """Move the model to the best parameters beside the chosen effects: Gauss-Newton on all rows.

    Parameters
    ----------
    bench : Workbench
    chosen : sequence of (Effect, nonlinear values)
    rounds : int
    learn : bool
        Whether to learn the noise anew first; it hardly changes with small steps.

    Returns
    -------
    Workbench
        Linearised at the parameters found, its noise learnt.
    """
    if learn:
        bench.learn_noise(chosen)
    for _ in range(rounds):
        beta, covariance, _ = bench.fit(chosen)
        step = beta[: fit_parameters.COUNT]
        # The fit itself still adds a step this small, linearly.
        if np.max(np.abs(step) / np.sqrt(np.diag(covariance)[: fit_parameters.COUNT] + 1e-12)) < _SETTLED:
            break
        moved = fit_parameters.admissible(bench.parameters + step, bench.configured)
        sized = bench.sized(chosen, beta)
        bench = bench.moved(moved)
        bench.correct_at(sized)
        bench.correct(chosen)
    bench.correct(chosen)
    return bench

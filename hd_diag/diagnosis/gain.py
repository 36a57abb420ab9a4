"""Value of a model on held-out rows: residuals, gain, and misfit over the noise."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Floats, Integers
from hd_diag.diagnosis.calibration import MISFIT, MORE
from hd_diag.diagnosis.drift import without_drift
from hd_diag.diagnosis.evidence.order_table import part
from hd_diag.diagnosis.evidence.solution import Solution
from hd_diag.diagnosis.evidence.unmodelled_terms import UnmodelledTerm
from hd_diag.diagnosis.evidence.waves import Remainder
from hd_diag.diagnosis.extension import extended_model, running_residual
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.design import interval, projection
from hd_diag.diagnosis.fit.linearised_fit import Chosen, LinearisedFit
from hd_diag.diagnosis.noise import ORDER, Whitening, numbered, slices
from hd_diag.diagnosis.record import Record, RecordError
from hd_diag.diagnosis.regression import centered
from hd_diag.diagnosis.stamps import usual_step
from hd_diag.drive import Drive
from hd_diag.effects.effect import Effect
from hd_diag.effects.remainders import TIME
from hd_diag.effects.signals import MISSING_STEPS

Rows = npt.NDArray[np.bool_]

_HELD_OUT = 4  # every fourth run, or stretch of a single run, is held out
_STRETCHES = 12
_SLICE = 1.0  # length of a block of the bootstrap [s]
_TORQUES, _RARE = 16, 0.02  # torque classes; share of the fitted rows that makes a class known
_KNOWN = 0.9  # least share of held-out rows whose torque class is known
_LEAST_FITTED, _LEAST_UNSEEN = 100, 25  # rows: a fit has some thirty columns


@dataclass(frozen=True)
class Rms:
    """Root mean squares on held-out data [rad].

    `extended` belongs to the model as it runs along the record, with causal signals; `named` to the same
    model without its order table; `offline` to the fit's own signals; `live` to the running model with the
    reported, unsmoothed torque. All of them contain `wandering`: unpredictable changes of the causes in
    amplitude and phase. `wandering_offline` is the wandering part of `offline`. The noise is `repeated` if it
    comes from states that the motion passed again; otherwise it is a lower bound, from differences between
    neighbours. `uncertain` is the deviation of the prediction by that of all coefficients: large if held-out
    rows have states that no others have, as in one move one way. `slow` is the residual in means over turns
    of the input, over noise and prediction together [-]; `gear` is that within turns, over the noise;
    `beyond` is as `slow`, but over the fit's noise, which includes slow noise.
    A running model that is worse with causes than without is discarded: `discarded` is its residual without
    wandering, and `named`, `extended`, `live` and `wandering` belong to the parameters alone.
    """

    nominal: float
    refit: float
    named: float
    extended: float
    offline: float
    live: float
    noise: float
    noise_low: float
    noise_high: float
    repeated: bool = field(default=True, kw_only=True)
    wandering: float = field(default=0.0, kw_only=True)
    wandering_offline: float = field(default=0.0, kw_only=True)
    slow: float = field(default=math.nan, kw_only=True)
    gear: float = field(default=math.nan, kw_only=True)
    beyond: float = field(default=math.nan, kw_only=True)
    uncertain: float = field(default=0.0, kw_only=True)
    discarded: float = field(default=math.nan, kw_only=True)

    def running(self, other: Rms) -> Rms:
        """With another model in place of the running one, whose residual is kept as `discarded`."""
        own = {name: getattr(other, name) for name in ("named", "extended", "live", "wandering")}
        return replace(self, **own, discarded=self.foretellable)

    @property
    def left(self) -> float:
        """Residual without wandering: the smaller one of the running model and the offline fit.

        The running model has late signals, which count against no cause. The fit has no order table.
        """
        return min(self.foretellable, math.sqrt(max(self.offline**2 - self.wandering_offline**2, 0.0)))

    @property
    def foretellable(self) -> float:
        """Residual of the running model without the wandering of causes."""
        return math.sqrt(max(self.extended**2 - self.wandering**2, 0.0))

    @property
    def with_causes(self) -> float:
        """Residual of the model with causes; the one that was discarded, if any."""
        return self.left if math.isnan(self.discarded) else self.discarded

    @property
    def hides_lines(self) -> bool:
        """Whether the residual at the gear's lines exceeds the noise, or is unknown."""
        return not self.gear < MISFIT

    def overstated(self, slow: float) -> float:
        """Factor by which the fit's noise understates the deviation of a cause with this `slow` share.

        Each band counts by the cause's share in it, as a misfit in one band says nothing about the other.
        """
        if not self.misfit.suspected:
            return 1.0
        bands = (self.misfit.value if math.isnan(one) else max(one, 1.0) for one in (self.beyond, self.gear))
        return math.sqrt(sum(share * one**2 for share, one in zip((slow, 1.0 - slow), bands, strict=True)))

    @property
    def without_causes(self) -> float:
        """Residual of the parameters alone, or of the configured drive if smaller."""
        return min(self.refit, self.nominal)

    @property
    def expected(self) -> float:
        """Residual that noise and the deviation of the prediction give together."""
        return math.hypot(self.noise, self.uncertain)

    @property
    def misfit(self) -> Misfit:
        """Residual `left` over noise and prediction together, with its interval."""
        value, low, high = (
            self.left / max(math.hypot(one, self.uncertain), 1e-300)
            for one in (self.noise, self.noise_high, self.noise_low)
        )
        return Misfit(value, low, high, self.repeated)


@dataclass(frozen=True)
class Gain:
    """Share of the nominal model's mean square that the extended model explains, with its 95 % interval.

    `held_out` says in words which rows were held out.
    """

    fraction: float
    low: float
    high: float
    held_out: str


class Misfit(NamedTuple):
    """Held-out rms of the extended model over noise and prediction together, and its interval [-].

    The noise is `measured` if the motion passed the same states again; otherwise the value is an upper bound.
    """

    value: float
    low: float
    high: float
    measured: bool = True

    @property
    def suspected(self) -> bool:
        """Whether the residual may exceed the noise: then something is `unexplained`."""
        return self.value > MISFIT or (self.low > MORE and self.high > MISFIT)

    @property
    def certain(self) -> bool:
        """Whether the residual certainly exceeds the noise."""
        return (self.value if self.measured else self.low) > MISFIT


def held_out(record: Record, good: Rows | None = None) -> tuple[Rows, str]:
    """Held-out rows as a mask (n,), and a description: whole recordings or runs, or stretches.

    The last part is never held out: predicting a slow drift needs data on both sides. `good` (n,) marks rows
    that are usable in a fit, by default all; enough of them are on each side of the division. If possible,
    the fitted rows cover the torques of the held-out ones: no model predicts unseen torques.

    Raises
    ------
    RecordError
        If no division has enough good rows on both sides.
    """
    good = np.ones(record.size, bool) if good is None else good
    enough = [
        (rows, which)
        for rows, which in _divisions(record, good)
        if np.count_nonzero(good & rows) >= _LEAST_UNSEEN and np.count_nonzero(good & ~rows) >= _LEAST_FITTED
    ]
    if enough:
        known = [_known_torques(record.torque, good & rows, good & ~rows) for rows, _ in enough]
        return enough[next((n for n, share in enumerate(known) if share >= _KNOWN), int(np.argmax(known)))]
    raise RecordError(
        f"too little motion: of {record.size} samples {np.count_nonzero(good)} are of a joint that moves, in "
        f"runs of more than {ORDER} samples; at least {_LEAST_FITTED + _LEAST_UNSEEN} are needed"
    )


def _known_torques(torque: Floats, unseen: Rows, seen: Rows) -> float:
    """Share of the unseen rows (n,) whose torque (n,) is in a histogram class that seen rows (n,) cover."""
    edges = np.linspace(float(torque.min()), float(torque.max()) + 1e-9, _TORQUES + 1)
    there, known = (np.histogram(torque[rows], edges)[0] for rows in (unseen, seen))
    return float(there[known >= _RARE * known.sum()].sum() / max(int(there.sum()), 1))


def _divisions(record: Record, good: Rows) -> Iterator[tuple[Rows, str]]:
    """Possible divisions, the best first: mask of held-out rows (n,) and its description."""
    bags = np.unique(record.bag)
    if bags.size >= _HELD_OUT:
        rows = _every_fourth(np.searchsorted(bags, record.bag), bags.size)
        if 0.1 < rows.mean() < 0.5:
            yield rows, f"{np.unique(record.bag[rows]).size} of {bags.size} recordings"
    if record.extent.runs >= _HELD_OUT:
        rows = _every_fourth(record.run, record.extent.runs)
        if 0.1 < rows.mean() < 0.5:
            yield rows, f"{np.unique(record.run[rows]).size} of {record.extent.runs} runs"
    share = f"{_STRETCHES // _HELD_OUT} of {_STRETCHES} stretches"
    for counted, where in ((np.ones(record.size, bool), "record"), (good, "motion")):
        before = np.cumsum(counted) - counted
        stretch = np.asarray(before * _STRETCHES // max(np.count_nonzero(counted), 1), np.int64)
        yield _every_fourth(stretch, _STRETCHES), f"{share} of the {where}"


def _every_fourth(number: Integers, count: int) -> Rows:
    """Mask (n,) of held-out rows: every fourth of `count` parts, except for the last; part numbers (n,)."""
    return np.asarray((number - count) % _HELD_OUT == _HELD_OUT // 2)


def renumbered(record: Record) -> Record:
    """Run numbers from zero, with a new run wherever rows are missing."""
    change = (np.diff(record.run) != 0) | (np.diff(record.time) > MISSING_STEPS * usual_step(record.time))
    return replace(record, run=numbered(change))


def measured_gain(
    record: Record,
    test: Rows,
    which: str,
    plain: LinearisedFit,
    found: Solution,
    every: LinearisedFit,
    rng: np.random.Generator,
) -> tuple[Rms, Gain]:
    """Residuals on held-out rows, and the gain.

    The fit `every` covers all rows, so that effects with memory know what came before a held-out row.
    """
    plain = replace(plain, whiten=found.fit.whiten)  # both fits use the whole model's noise model
    configured, fitted = every.data.configured, every.data.mask
    beside = tuple(one for one, _ in plain.present)

    def unseen(residual: Floats) -> Floats:
        """Residual of held-out rows without drift or offset; offsets are those of fitted rows, if any."""
        if record.by_velocity:
            own = fitted & test
            return without_drift(residual[own], record.time[own], record.bag[own])
        for bag in np.unique(record.bag):
            own = fitted & (record.bag == bag)
            if own.any():
                known = own & ~test if np.any(own & ~test) else own
                residual = np.where(own, residual - np.nanmean(residual[known]), residual)
        return np.asarray(residual[fitted & test])

    def of_fit(residual: Floats) -> Floats:
        whole = np.zeros(record.size)
        whole[fitted] = residual
        return unseen(whole)

    nominal = unseen(_nominal_residual(record, configured))
    model = extended_model(found, configured, record.select(~test))
    extended, live = (
        unseen(running_residual(model, record, torque, model.coarse_map))
        for torque in (record.torque, record.reported_torque)
    )
    seen = found.fit.signals
    described = part(found.table, seen.input_angle, seen.torque, configured.rated_torque)
    rows_fitted = Remainder.of(found.fit, found.chosen).residual - described
    noise = found.fit.data.noise_of(rows_fitted)
    most = noise.high
    if not noise.repeated:  # stretches also differ by slow noise, but unmeasured torsion is not noise
        beyond = max(_rms(extended) / max(_rms(rows_fitted), 1e-300), 1.0)
        most = beyond * noise.high if record.has_torque else noise.rms
    parts = [effect.wandering(every.whole, nonlinear) for effect, nonlinear in found.chosen]
    parts += [effect.columns(every.whole, at) for effect, at in found.chosen if effect is TIME]
    wandering = np.concatenate([np.empty((record.size, 0)), *parts], axis=1)[fitted & test]
    rest = renumbered(record.select(fitted & test))
    number = slices(rest.time, rest.run, _SLICE)
    offline = of_fit(_residual_of(every, found.fit, found.chosen))
    foreseen, whiten = offline - projection(wandering, offline), found.fit.whiten
    encoders = replace(whiten, slow=0.0)
    uncertain = _uncertain(every, found.fit, found.chosen, test[fitted])
    slow, gear = _bands(foreseen, rest, encoders, rng, uncertain)
    # A line at torques of held-out rows alone is unpredictable, so the fitted rows' residual counts too.
    gear = min(gear, _bands(rows_fitted, renumbered(found.fit.data.record), encoders, rng)[1])
    rms = Rms(
        nominal=_rms(nominal),
        refit=_rms(of_fit(_residual_of(every.moved(plain.parameters), plain, beside))),
        named=_rms(extended),
        extended=_rms(extended),
        offline=_rms(offline),
        live=_rms(live[np.isfinite(live)]),
        noise=noise.low if noise.vague else noise.rms,
        noise_low=noise.low,
        noise_high=most,
        repeated=noise.repeated and not noise.vague,
        wandering=_rms(projection(wandering, extended)),
        wandering_offline=_rms(projection(wandering, offline)),
        slow=slow,
        gear=gear,
        beyond=_bands(foreseen, rest, whiten, rng, uncertain)[0],
        uncertain=uncertain,
    )
    return rms, explained(nominal, extended, number, which, rng)


def _bands(
    left: Floats, rows: Record, noise: Whitening, rng: np.random.Generator, uncertain: float = 0.0
) -> tuple[float, float]:
    """Residual (n,) over the noise [-]: of means over turns of the input, and within turns.

    Only complete turns show the gear's lines; slow parts also vary within a turn where the motion reverses.
    The reference is simulated noise of the measured colour along the same rows. The deviation of the
    prediction [rad], which is mostly that of slow functions, is added to it in the first.
    """
    turn, lines = rows.turn, rows.through
    alike = noise.drawn(left.size, rng)

    def parts(values: Floats) -> tuple[float, float]:
        within = centered(values, turn)
        means = values - within
        return _rms(means - means.mean()), _rms(within[lines])

    slow, gear = parts(alike)
    found = parts(left)
    return found[0] / max(math.hypot(slow, uncertain), 1e-300), found[1] / max(gear, 1e-300)


def explained(before: Floats, after: Floats, number: Integers, which: str, rng: np.random.Generator) -> Gain:
    """Gain of the residual `after` over `before` (n,), with an interval by bootstrap over stretches (n,)."""
    whole, rest = (np.asarray(np.bincount(number, one**2), np.float64) for one in (before, after))
    low, high = interval(rest, rng, whole)
    return Gain(1.0 - float(rest.sum() / whole.sum()), 1.0 - high, 1.0 - low, which)


def _nominal_residual(record: Record, configured: Drive) -> Floats:
    """Residual of the configured drive at all rows [rad]."""
    error, _, _ = fit_parameters.along(configured, configured, record.input_angle, record.torque)
    return np.asarray(record.output_angle - record.input_angle / configured.kinematics.ratio - error)


def _residual_of(fit: LinearisedFit, trained: LinearisedFit, chosen: Chosen) -> Floats:
    """Residual of all rows of a fit [rad], with coefficients from a fit to some rows.

    The model excludes unmodelled terms, effects that do not last, and the columns by which a cause wanders,
    although all of them are fitted.
    """
    beta, _, _ = trained.fit(chosen)
    own = fit.parameters.size  # without encoder zeros, which belong to the rows of each fit
    residual = fit.effects.uncorrected - fit.jacobian @ beta[:own]
    sized = tuple((item, part[: item[0].size]) for item, part in trained.sized(chosen, beta))
    causes = tuple(one for one in sized if _foretells(one[0][0]))
    return np.asarray(residual - fit.beside(sized).effects.together(causes))


def _foretells(effect: Effect) -> bool:
    """Whether a prediction contains an effect that was fitted."""
    return effect.lasting and not isinstance(effect, UnmodelledTerm)


def _uncertain(fit: LinearisedFit, trained: LinearisedFit, chosen: Chosen, rows: Rows) -> float:
    """Rms deviation of a prediction by a fit to other rows, at `rows` (n,) [rad]; see `_residual_of`."""
    parts = [fit.always()[rows]]
    at = [np.arange(parts[0].shape[1])]
    for item, place in zip(chosen, trained.places(chosen), strict=True):
        if _foretells(item[0]):
            parts.append(fit.columns(*item)[rows, : item[0].size])
            at.append(np.arange(place.start, place.start + parts[-1].shape[1]))
    columns, places = np.concatenate(parts, axis=1), np.concatenate(at)
    spread = trained.fit(chosen)[1][np.ix_(places, places)]
    return math.sqrt(max(float(np.mean(np.sum(columns @ spread * columns, axis=1))), 0.0))


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))

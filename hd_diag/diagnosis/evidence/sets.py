"""Sets of causes fitted together with the remainders of any joint, and their evidence."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Floats
from hd_diag.diagnosis import calibration
from hd_diag.diagnosis.evidence.evidence import Evidence, Prior
from hd_diag.diagnosis.fit.design import foretold, holds, projection
from hd_diag.diagnosis.fit.fit_parameters import TORSION
from hd_diag.diagnosis.fit.joint_refinement import free, polished, sensible, settle
from hd_diag.diagnosis.fit.linearised_fit import Chosen, LinearisedFit
from hd_diag.diagnosis.fit.present_effects import Item
from hd_diag.diagnosis.record import Record
from hd_diag.diagnosis.stamps import usual_step
from hd_diag.drive import Drive
from hd_diag.effects.effect import Effect
from hd_diag.effects.remainders import LOOP, ORDERS, PLACE, SPEED, TIME, TORQUE, Remainder

Widths = Mapping[str, float]

_WANDERING = 0.3  # prior width of columns beyond a cause's own, as of its wandering, over its usual size


@dataclass(frozen=True)
class Remainders:
    """Every remainder of a record, each with its usual size and its range."""

    items: Chosen

    @staticmethod
    def of(record: Record, drive: Drive, compliance: float) -> Remainders:
        """Remainders for a record of a drive with some mean compliance [rad/(N m)]."""
        forward = np.sign(drive.kinematics.ratio) * record.speed
        usual: dict[Remainder, tuple[float, tuple[float, float]]] = {
            TORQUE: (calibration.USUAL_TORSION * compliance, _range(record.torque)),
            LOOP: (calibration.USUAL_SLOW, _range(record.torque)),
            SPEED: (calibration.USUAL_SLOW, _range(forward)),
            PLACE: (calibration.USUAL_SLOW, _range(record.torque)),
            TIME: (calibration.USUAL_SLOW, (float(record.time[0]), float(record.time[-1]))),
            **{line: (calibration.USUAL_LINE, _range(record.torque)) for line in ORDERS},
        }
        return Remainders(tuple((effect, (size, *ends)) for effect, (size, ends) in usual.items()))

    def at(self, widths: Widths) -> Chosen:
        """The remainders at sizes of `widths` times the usual ones."""
        return tuple((effect, (widths[effect.name] * size, *ends)) for effect, (size, *ends) in self.items)


def _range(values: Floats) -> tuple[float, float]:
    return min(float(values.min()), 0.0), max(float(values.max()), 0.0)


@dataclass(frozen=True)
class Set:
    """Causes and remainders, fitted together.

    Attributes
    ----------
    fit : LinearisedFit
        Linearised at the fitted parameters and sizes.
    remainders : Remainders
    causes : tuple of (Effect, nonlinear values)
    motor : tuple of (Effect, nonlinear values)
        Effects of the motor on a torque computed from its current.
    widths : dict
        Prior widths relative to the usual size, of remainders and causes by name.
    value : float
        Log evidence, including the prior odds of presence.
    rounds : int
        Most rounds of settling.
    before : Set, optional
        The set before its last cause was added.
    """

    fit: LinearisedFit
    remainders: Remainders
    causes: Chosen
    motor: Chosen = ()
    widths: Widths = field(default_factory=dict)
    value: float = -np.inf
    rounds: int = 3
    before: Set | None = None

    @property
    def given(self) -> Chosen:
        """Effects that are no causes: those of the motor, and remainders."""
        return (*self.motor, *self.remainders.at(self._widths))

    @property
    def chosen(self) -> Chosen:
        """All effects fitted in addition to the model's parameters."""
        return (*self.given, *self.causes)

    @property
    def _widths(self) -> Widths:
        """Prior widths of all remainders and causes, 1 where they are not tuned yet."""
        every = (*self.remainders.items, *self.causes)
        return {effect.name: self.widths.get(effect.name, 1.0) for effect, _ in every}

    @property
    def names(self) -> frozenset[str]:
        """Names of the causes."""
        return frozenset(effect.name for effect, _ in self.causes)

    def evidence(self, candidates: Iterable[tuple[str, Item]] = ()) -> Evidence:
        """Evidence of the set and of candidates by name; groups of the set have their effects' names.

        Parameters on a bound are fixed there: no set is credited with what they would explain beyond it.
        """
        fit, chosen, fixed, widths = self.fit, self.chosen, len(self.motor), self._widths
        built = fit.design(chosen)
        priors = (
            (effect.name, _prior(effect, place.stop - place.start, widths[effect.name]))
            for (effect, _), place in zip(chosen[fixed:], fit.places(chosen)[fixed:], strict=True)
        )
        found = Evidence.of(*built.of_data, float(built.square.sum()), *fit.prior(self.motor), priors)
        if not (others := list(candidates)):
            return found
        columns, (held, steps) = fit.whitened(chosen), fit.on_bounds(chosen)
        target = fit.residual_white - columns[:, held] @ steps
        columns[:, held] = 0.0
        whites = ((name, item[0], fit.roughly(item[0]).white(*item)) for name, item in others)
        apart = ((name, white, _prior(effect, white.shape[1])) for name, effect, white in whites)
        return found.beside(columns, target, apart)

    def valued(self) -> Set:
        """The set with tuned prior widths, and its evidence at the current linearisation."""
        log, widths = self.evidence().tuned(self._widths)
        return replace(self, widths=widths, value=log + self.presence)

    @property
    def presence(self) -> float:
        """Prior log odds of the causes, each at one of its grid points."""
        return sum(presence(self.fit, effect) for effect, _ in self.causes)

    def settled(self, rounds: int = 0) -> Set:
        """The set at the best parameters and sizes, with prior widths tuned there."""
        chosen = self.chosen
        fit = settle(self.fit.corrected(chosen), chosen, rounds or self.rounds, learn=False)
        return replace(self, fit=fit).valued()

    def polished(self, rounds: int = 2) -> Set:
        """The set with the best nonlinear values of motor and causes, parameters and sizes refitted.

        It stays as it is if this does not raise the evidence, or if another cause becomes senseless.
        """
        if not any(free(effect) for effect, _ in (*self.motor, *self.causes)):
            return self
        fit, chosen = polished(self.fit, self.chosen, rounds)
        motor, causes = chosen[: len(self.motor)], chosen[len(self.given) :]
        better = replace(self, fit=fit, motor=motor, causes=causes).valued()
        return better if better.value > self.value and better.senseless <= self.senseless else self

    def may_foretell(self, name: str) -> bool:
        """Whether a cause predicts held-out blocks, or may do so with other nonlinear values."""
        return any(free(effect) for effect, _ in self.causes if effect.name == name) or self.foretells(name)

    def foretells(self, name: str) -> bool:
        """Whether a cause predicts held-out blocks of the record. Evidence alone trusts the model.

        Without the cause, remainders and parameters move from their prior: this cost is shared equally by
        all blocks. A cause that wanders cannot be predicted, so it passes.
        """
        item = next(one for one in self.causes if one[0].name == name)
        if item[0].wanders(item[1]):
            return True
        place = self.fit.places(self.chosen)[self.chosen.index(item)]
        design = self.fit.design(self.chosen)
        more, moved = (one / design.square.size for one in design.prior_gain(place))
        gain, predicted, variance = design.held_out_gain(place)
        gain, predicted, variance = gain + more, predicted + moved, variance + moved
        there = min(foretold(one, predicted, variance) for one in (gain, predicted))
        worth = 0.5 * calibration.TEMPER * there
        return worth > -presence(self.fit, item[0]) and holds(gain, predicted, variance)

    @cached_property
    def relearned(self) -> Set:
        """The set with noise learned given it, and its evidence: that of other noise is not comparable."""
        before = self.fit.whiten
        whiten = replace(self.fit.with_noise(self.chosen).whiten, slow=before.slow, kept=before.kept)
        return replace(self, fit=replace(self.fit, whiten=whiten).corrected(self.chosen)).valued()._slowed()

    def _slowed(self) -> Set:
        """The set with the most likely slow noise, by steps of the noise's size and memory."""
        kept = np.exp(-usual_step(self.fit.data.record.time) / np.array(calibration.SLOW_FOR)).tolist()
        now = self.fit.whiten
        size, memory = (
            int(np.argmin(np.abs(np.subtract(choices, value))))
            for choices, value in ((calibration.SLOW, now.slow), (kept, now.kept or kept[1]))
        )
        best, value = self, self._likelihood
        for size_step, memory_step in ((0, -1), (0, 1), (1, 0), (-1, 0), (0, -1), (0, 1)):
            while size or size_step:  # at size zero the memory has no effect
                there = size + size_step, memory + memory_step
                if not (0 <= there[0] < len(calibration.SLOW) and 0 <= there[1] < len(kept)):
                    break
                whiten = replace(now, slow=calibration.SLOW[there[0]], kept=kept[there[1]])
                trial = replace(best, fit=replace(best.fit, whiten=whiten)).valued()
                if trial._likelihood <= value:
                    break
                best, value, (size, memory) = trial, trial._likelihood, there
        return best

    @property
    def _likelihood(self) -> float:
        """Log evidence that is comparable between sets with different slow noise, or none."""
        whiten = self.fit.whiten
        present = calibration.SLOW_NOISE if whiten.slow else 0.0
        return self.value + present - calibration.TEMPER * whiten.logarithm(self.fit.data.run)

    def beside(self, item: Item, widths: Widths) -> Set:
        """The set with one more cause, at its fitted size given some prior widths; not settled."""
        more = replace(self, causes=(*self.causes, item), widths=widths)
        return replace(more, fit=more.fit.corrected(more.chosen))

    def without(self, name: str) -> Set:
        """The set without one cause; not settled."""
        causes = tuple(item for item in self.causes if item[0].name != name)
        widths = {one: width for one, width in self.widths.items() if one != name}
        fewer = replace(self, causes=causes, widths=widths)
        return replace(fewer, fit=fewer.fit.corrected(fewer.chosen))

    def clear(self) -> Set:
        """The set on rows where no possible torque is near zero; its evidence is updated if rows drop out.

        See :meth:`PresentEffects.possible_torques`.
        """
        sized = self.fit.sized(self.chosen, self.fit.fit(self.chosen)[0])
        fit = self.fit.clear_of(self.fit.effects.possible_torques(sized))
        return self if fit is self.fit else replace(self, fit=fit.beside(sized)).valued()

    def on(self, other: Set) -> Set:
        """The set on the rows and with the noise of another set."""
        fit = replace(self.fit, data=other.fit.data, whiten=other.fit.whiten)
        return replace(self, fit=fit.beside(self.fit.present)).valued()

    def moved_to(self, fit: LinearisedFit) -> Set:
        """The set on other rows of the record, with the same noise."""
        there = replace(fit, whiten=self.fit.whiten, held=self.fit.held).moved(self.fit.parameters)
        sized = self.fit.sized(self.chosen, self.fit.fit(self.chosen)[0])
        there = there.clear_of(there.effects.possible_torques(sized))
        # Some terms have one column for each rest, so their number of columns depends on the rows.
        known = tuple(one for one in sized if there.columns(*one[0]).shape[1] == one[1].size)
        return replace(self, fit=there.beside(known), rounds=1)

    def at(self, parameters: Floats, held: tuple[int, ...] = ()) -> Set:
        """The set at other parameters (p,), those in `held` fixed, with the same sizes; not settled."""
        fit = replace(self.fit.moved(parameters), held=held).beside(self.fit.present)
        return replace(self, fit=fit)

    @property
    def sensible(self) -> bool:
        """Whether every cause is plausible at its size and not mostly cancelled by other effects."""
        return not self.senseless

    @cached_property
    def senseless(self) -> frozenset[str]:
        """Names of the causes that are implausible at their size, or mostly cancelled by other effects.

        True causes have any sign. Two causes that nearly cancel imitate the shape of a third. Friction of any
        law dissipates, so its remainders (loop, speed) cancel no true cause: they count as well.
        """
        good = sensible(self.fit, self.chosen)
        found = {item[0].name for item, one in zip(self.chosen, good, strict=True) if not one}
        if not self.causes:
            return frozenset(found)
        beta = self.fit.fit(self.chosen)[0]
        sized = self.fit.sized(self.chosen, beta)
        counted = [one for one in sized if one[0] in self.causes or one[0][0] in (LOOP, SPEED)]
        parts = np.array([self.fit.columns(*item) @ own for item, own in counted])
        parts -= parts.mean(axis=1, keepdims=True)
        causes = parts[-len(self.causes) :]
        left = causes + (causes @ parts.T < 0.0) @ parts  # with all parts of opposite sign
        size, rest = (np.linalg.norm(one, axis=1) for one in (causes, left))
        undone = (rest < (1.0 - calibration.UNDONE) * size) | self._of_torsion(causes, beta)
        return frozenset(found.union(self.causes[index][0].name for index in np.flatnonzero(undone)))

    def _of_torsion(self, causes: Floats, beta: Floats) -> npt.NDArray[np.bool_]:
        """Which causes, given as parts (k, n) [rad], imitate a part of the torsion; shape (k,).

        A change of the torsion, by a fit's coefficients, cancels most of such a cause. Functions of the
        torque reproduce nearly all of it.
        """
        torsion, size = self.fit.torsion(beta), np.linalg.norm(causes, axis=1)
        greater = np.maximum(size, np.linalg.norm(torsion - torsion.mean()))
        undone = causes @ torsion < -calibration.UNDONE * size * greater
        if undone.any():
            by_torque = [self.fit.columns(*one) for one in self.given if one[0] is TORQUE]
            columns = np.concatenate((self.fit.jacobian[:, TORSION], *by_torque), axis=1)
            own = causes - projection(columns - columns.mean(axis=0), causes.T).T
            undone &= np.linalg.norm(own, axis=1) < calibration.NOT_BY_TORQUE * size
        return np.asarray(undone)


def presence(fit: LinearisedFit, effect: Effect) -> float:
    """Prior log odds of a cause at one of its grid points; 0 for given effects and remainders."""
    if effect.given or isinstance(effect, Remainder):
        return 0.0
    known = calibration.PRESENT if effect.searched and effect.inspect else calibration.UNKNOWN
    return known - float(np.log(fit.data.trials(effect)))


def _prior(effect: Effect, count: int, width: float = 1.0) -> Prior:
    """Prior of `count` columns of an effect. The columns of a remainder contain its width."""
    if effect.standard:
        larger = calibration.LARGER_LINE if effect in ORDERS else calibration.LARGER
        widths = calibration.LOOP_BY if effect is LOOP else calibration.LARGER_BY
        return np.full(count, 1.0 / width), widths, larger
    usual = np.full(count, _WANDERING * float(effect.usual[0]))
    usual[: effect.size] = effect.usual[:count]
    return usual, calibration.SIZES, calibration.LARGER

"""Sets of causes beside the remainders of any joint, settled in a fit, with their evidence."""

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

_WANDERING = 0.3  # of a cause's usual size, that its size may wander by


@dataclass(frozen=True)
class Remainders:
    """What is usual of every remainder in a record: the effects at their usual size and range."""

    items: Chosen

    @staticmethod
    def of(record: Record, drive: Drive, compliance: float) -> Remainders:
        """For a record, beside a drive of some mean compliance [rad/(N m)]."""
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
        """The same at sizes of so many times the usual one."""
        return tuple((effect, (widths[effect.name] * size, *ends)) for effect, (size, *ends) in self.items)


def _range(values: Floats) -> tuple[float, float]:
    return min(float(values.min()), 0.0), max(float(values.max()), 0.0)


@dataclass(frozen=True)
class Set:
    """Causes beside remainders, settled.

    Attributes
    ----------
    fit : LinearisedFit
        At the parameters and sizes that fit.
    remainders : Remainders
    causes : tuple of (Effect, nonlinear values)
    motor : tuple of (Effect, nonlinear values)
        What a motor takes of its current.
    widths : dict
        Prior widths over the usual size, of remainders and causes by name.
    value : float
        Log evidence with the priors of presence.
    rounds : int
        Of settling, at most.
    before : Set, optional
        To which its last cause was added.
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
        """What is no cause: what a motor takes of its current, and remainders."""
        return (*self.motor, *self.remainders.at(self._widths))

    @property
    def chosen(self) -> Chosen:
        """All that is fitted beside the model's parameters."""
        return (*self.given, *self.causes)

    @property
    def _widths(self) -> Widths:
        """Of all remainders and causes, as usual where they are not tuned yet."""
        every = (*self.remainders.items, *self.causes)
        return {effect.name: self.widths.get(effect.name, 1.0) for effect, _ in every}

    @property
    def names(self) -> frozenset[str]:
        """Of the causes."""
        return frozenset(effect.name for effect, _ in self.causes)

    def evidence(self, candidates: Iterable[tuple[str, Item]] = ()) -> Evidence:
        """Of the set and of candidates, by names; the set's are the effects'.

        What a parameter on its bound would explain beyond it counts for no set.
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
        """With the best widths and the evidence where the fit stands."""
        log, widths = self.evidence().tuned(self._widths)
        return replace(self, widths=widths, value=log + self.presence)

    @property
    def presence(self) -> float:
        """Prior log odds of the causes, each at one of so many grid points."""
        return sum(presence(self.fit, effect) for effect, _ in self.causes)

    def settled(self, rounds: int = 0) -> Set:
        """Moved to the best parameters and sizes, widths tuned there."""
        chosen = self.chosen
        fit = settle(self.fit.corrected(chosen), chosen, rounds or self.rounds, learn=False)
        return replace(self, fit=fit).valued()

    def polished(self, rounds: int = 2) -> Set:
        """Moved to the best nonlinear values of motor and causes, parameters and sizes with them."""
        if not any(free(effect) for effect, _ in (*self.motor, *self.causes)):
            return self
        fit, chosen = polished(self.fit, self.chosen, rounds)
        motor, causes = chosen[: len(self.motor)], chosen[len(self.given) :]
        better = replace(self, fit=fit, motor=motor, causes=causes).valued()
        return better if better.value > self.value and better.senseless <= self.senseless else self

    def may_foretell(self, name: str) -> bool:
        """Whether a cause holds in blocks, or may with other nonlinear values."""
        return any(free(effect) for effect, _ in self.causes if effect.name == name) or self.foretells(name)

    def foretells(self, name: str) -> bool:
        """Whether a cause holds in blocks of the record that others foretell: evidence believes the model.

        What remainders and parameters would have to grow for it counts in all blocks alike. What wanders
        cannot be foretold.
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
        """With noise learned beside it, valued anew: the evidence of other noise is not comparable."""
        before = self.fit.whiten
        whiten = replace(self.fit.with_noise(self.chosen).whiten, slow=before.slow, kept=before.kept)
        return replace(self, fit=replace(self.fit, whiten=whiten).corrected(self.chosen)).valued()._slowed()

    def _slowed(self) -> Set:
        """With the slow noise beside which the record is most likely: steps of its size and of its memory."""
        kept = np.exp(-usual_step(self.fit.data.record.time) / np.array(calibration.SLOW_FOR)).tolist()
        now = self.fit.whiten
        size, memory = (
            int(np.argmin(np.abs(np.subtract(choices, value))))
            for choices, value in ((calibration.SLOW, now.slow), (kept, now.kept or kept[1]))
        )
        best, value = self, self._likelihood
        for size_step, memory_step in ((0, -1), (0, 1), (1, 0), (-1, 0), (0, -1), (0, 1)):
            while size or size_step:  # without slow noise its memory changes nothing
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
        """Log evidence that can be compared with that beside other slow noise, or none."""
        whiten = self.fit.whiten
        present = calibration.SLOW_NOISE if whiten.slow else 0.0
        return self.value + present - calibration.TEMPER * whiten.logarithm(self.fit.data.run)

    def beside(self, item: Item, widths: Widths) -> Set:
        """With one cause more, at the size that fits with some widths; not settled."""
        more = replace(self, causes=(*self.causes, item), widths=widths)
        return replace(more, fit=more.fit.corrected(more.chosen))

    def without(self, name: str) -> Set:
        """Without one cause; not settled."""
        causes = tuple(item for item in self.causes if item[0].name != name)
        widths = {one: width for one, width in self.widths.items() if one != name}
        fewer = replace(self, causes=causes, widths=widths)
        return replace(fewer, fit=fewer.fit.corrected(fewer.chosen))

    def clear(self) -> Set:
        """On rows where no torque that its causes leave may be near zero; valued anew if these are fewer."""
        sized = self.fit.sized(self.chosen, self.fit.fit(self.chosen)[0])
        fit = self.fit.clear_of(self.fit.effects.possible_torques(sized))
        return self if fit is self.fit else replace(self, fit=fit.beside(sized)).valued()

    def on(self, other: Set) -> Set:
        """On the rows and with the noise of another set."""
        fit = replace(self.fit, data=other.fit.data, whiten=other.fit.whiten)
        return replace(self, fit=fit.beside(self.fit.present)).valued()

    def moved_to(self, fit: LinearisedFit) -> Set:
        """On other rows of the record, with the noise that is known."""
        there = replace(fit, whiten=self.fit.whiten, held=self.fit.held).moved(self.fit.parameters)
        sized = self.fit.sized(self.chosen, self.fit.fit(self.chosen)[0])
        there = there.clear_of(there.effects.possible_torques(sized))
        # How many columns a term without a law has, one for each rest say, goes with the rows.
        known = tuple(one for one in sized if there.columns(*one[0]).shape[1] == one[1].size)
        return replace(self, fit=there.beside(known), rounds=1)

    def at(self, parameters: Floats, held: tuple[int, ...] = ()) -> Set:
        """At other parameters (p,), of which some are held, with the same sizes; not settled."""
        fit = replace(self.fit.moved(parameters), held=held).beside(self.fit.present)
        return replace(self, fit=fit)

    @property
    def sensible(self) -> bool:
        """Whether every cause is itself at its size, and no others undo most of it."""
        return not self.senseless

    @cached_property
    def senseless(self) -> frozenset[str]:
        """Names of the causes that are not themselves at their size, or that others undo most of.

        Causes that are there are of any sign. Two that leave little together are the shape of a third.
        Friction of any law dissipates: what is usual of it undoes no cause.
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
        left = causes + (causes @ parts.T < 0.0) @ parts  # beside all of the other sign
        size, rest = (np.linalg.norm(one, axis=1) for one in (causes, left))
        undone = (rest < (1.0 - calibration.UNDONE) * size) | self._of_torsion(causes, beta)
        return frozenset(found.union(self.causes[index][0].name for index in np.flatnonzero(undone)))

    def _of_torsion(self, causes: Floats, beta: Floats) -> npt.NDArray[np.bool_]:
        """Which causes (k, n), by a fit's coefficients, stand for a part of the torsion.

        A torsion off the configured undoes most of them, and functions of the torque could make nearly all.
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
    """Prior log odds of a cause at one of its grid points."""
    if effect.given or isinstance(effect, Remainder):
        return 0.0
    known = calibration.PRESENT if effect.searched and effect.inspect else calibration.UNKNOWN
    return known - float(np.log(fit.data.trials(effect)))


def _prior(effect: Effect, count: int, width: float = 1.0) -> Prior:
    """Of so many columns of an effect; those of a remainder are at a width."""
    if effect.standard:
        larger = calibration.LARGER_LINE if effect in ORDERS else calibration.LARGER
        widths = calibration.LOOP_BY if effect is LOOP else calibration.LARGER_BY
        return np.full(count, 1.0 / width), widths, larger
    usual = np.full(count, _WANDERING * float(effect.usual[0]))
    usual[: effect.size] = effect.usual[:count]
    return usual, calibration.SIZES, 0.0

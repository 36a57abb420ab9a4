"""Tests of a candidate: chance, practical size, gain in held-out blocks or in means over seconds."""

from __future__ import annotations

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.diagnosis.fit.design import f_test, holds, projection, solve, surprise
from hd_diag.diagnosis.fit.joint_refinement import sensible, settle
from hd_diag.diagnosis.fit.linearised_fit import Chosen, LinearisedFit
from hd_diag.diagnosis.fit.present_effects import Item
from hd_diag.diagnosis.measured_noise import rounding
from hd_diag.diagnosis.noise import numbered
from hd_diag.diagnosis.search.ranking import Candidate, family_size, ranked
from hd_diag.diagnosis.search.unmodelled_terms import UnmodelledTerm
from hd_diag.diagnosis.stamps import usual_step
from hd_diag.effects.effect import Effect, Stage
from hd_diag.model.torsion_map import ARCSEC

_TORSION = "torsional_hardening"
_LOOP = "hysteresis"

FAMILY_ERROR = 0.01
"""Chance of any false name by noise, over all candidates and grid points."""

OVERSTATED = 3.0
"""Times the gain of a likelihood that noise brings, by records without a cause."""

LEAST_SIZE = 0.25 * ARCSEC
"""A cause smaller than this beside the refitted model is of no practical size [rad rms]."""

_SHAPE = 0.08  # of a smooth law's size, to which its shape is known
_LATE = 0.002  # the same of a delay
_SHAPES = 8  # other shapes of a smooth law that are tried at most
_STAYING = 0.8  # share of an effect that these must leave of it, for it to be another cause
_CYCLES = 3.0  # samples by which torque and angles may be out of step
_SMOOTHED = 1.5  # deviations of the smoothed torque by its noise, that its error may have
_ROUNDED = 0.5  # of the rounding to counts, that may look like a delay or a wave
_MOST = 0.5  # of what a wave brings, that it must bring beside that of the counts, too
_OWN = 0.1  # of what an effect brings, that it must bring beside parameters free of their bounds, too
_CERTAIN_SIZE = 0.5 * ARCSEC  # of a shape that nothing held out can prove [rad rms]
_SECONDS = 2.5  # of a mean in which quick noise is gone
_CHANCE_SHARE = 3.0  # times what noise alone gives to so many columns
_LASTING_CHANCE = 1e-6
_TOGETHER = 3  # best candidates that are tried beside each other


def passing(fit: LinearisedFit, chosen: Chosen, found: list[Candidate], family: int) -> Candidate | None:
    """The first candidate, the best first, that passes every test beside those chosen already."""
    for candidate in found:
        # The order may be that of what they leave once all is settled.
        if by_chance(candidate, family) > FAMILY_ERROR:
            continue
        effect, nonlinear = candidate.effect, candidate.nonlinear
        large = size(fit, chosen, effect, nonlinear) >= LEAST_SIZE
        itself = sensible(fit, (*chosen, (effect, nonlinear)))[-1]
        if large and itself and _confirmed(fit, chosen, effect, nonlinear):
            return candidate
    return None


def beside_another(
    fit: LinearisedFit, chosen: Chosen, found: list[Candidate], family: int
) -> Candidate | None:
    """The first of the best that passes beside another one, which passes beside it; see :func:`passing`.

    Where two causes are about as large neither may foretell what the other adds to held-out blocks.
    """
    for one in found[:_TOGETHER]:
        if by_chance(one, family) > FAMILY_ERROR:
            continue
        trial = (*chosen, (one.effect, one.nonlinear))
        others = [other.effect for other in found if other.effect is not one.effect]
        second = passing(fit, trial, ranked(fit, trial, others)[:_TOGETHER], family)
        if second and passing(fit, (*chosen, (second.effect, second.nonlinear)), [one], family):
            return one
    return None


def only_corrects_shape(fit: LinearisedFit, chosen: Chosen, index: int) -> bool:
    """Whether one of the chosen effects is no more than the others' shape, or that of what imitates it.

    It belongs to the fit all the same: left out, what is nearest to it would be named for it. What stays
    beside the other shapes that the others can have is none of theirs.
    """
    (effect, nonlinear), others = chosen[index], chosen[:index] + chosen[index + 1 :]
    own = size(fit, others, effect, nonlinear)
    if own < imitated(fit, others, effect, nonlinear):
        return True
    richer = (*others, *_other_shapes(fit, others))
    return own < of_shapes(fit, others, effect) and size(fit, richer, effect, nonlinear) < _STAYING * own


def _other_shapes(fit: LinearisedFit, chosen: Chosen) -> Chosen:
    """The smooth laws among the chosen effects at other points of their grids."""
    found: list[Item] = []
    for effect, nonlinear in chosen:
        if smooth(effect) and not effect.given:
            points = [point for point in fit.data.grid(effect) if point != nonlinear]
            found += [(effect, point) for point in points[:: -(-len(points) // _SHAPES) or 1]]
    return tuple(found)


def by_chance(candidate: Candidate, family: int) -> float:
    """Chance that noise makes any of so many hypotheses gain as much."""
    return min(1.0, candidate.p_value * family)


def chance(fit: LinearisedFit, chosen: Chosen, index: int) -> float:
    """The same for one of the chosen effects beside the others, by likelihoods, once all is settled.

    Noise of which few seconds were seen has likelihoods some times as large as its model says. Of what is not
    settled they say little: a cause in a wrong shape is less like noise than what is left without it.
    """
    others = chosen[:index] + chosen[index + 1 :]
    gain = (log_likelihood(fit, chosen) - log_likelihood(fit, others)) / OVERSTATED
    p = np.exp(-surprise(gain, fit.columns(*chosen[index]).shape[1]))
    return min(1.0, float(p) * family_size(fit))


def chance_in_misfit(p_value: float, family: int, over_noise: float) -> float:
    """The same where so many times the noise may be left: gains of likelihoods are overstated by its square.

    As deviations are by itself (Birge, Phys. Rev. 40, 1932).
    """
    power = max(over_noise, 1.0) ** -2.0
    return float(min(1.0, family * (p_value / family) ** power))


def log_likelihood(fit: LinearisedFit, chosen: Chosen) -> float:
    """Twice the logarithm of the likelihood of what a fit leaves, but for a constant.

    With the noise of that: slow noise looks like a cause to the noise that is learned beside it, and is noise
    without it.
    """
    own = fit.with_noise(chosen, richer=False)
    rows = np.count_nonzero(own.residual_white)
    return -float(rows * np.log(own.whiten.scale**2 * own.deviance(chosen) / rows))


def of_shapes(fit: LinearisedFit, chosen: Chosen, effect: Effect) -> float:
    """Size up to which an effect may only mend the shape of those chosen [rad rms].

    A law of friction, torsion or drift is right to some share of it; what the next smooth law then explains
    is no second cause. Lines of teeth, bearings and encoders mend no smooth law; a delay has hardly a shape.
    """
    if not smooth(effect):
        return 0.0
    sized = [one for one in fit.sized(chosen, fit.fit(chosen)[0]) if smooth(one[0][0])]
    shares = [_LATE if item[0].stage == Stage.STREAM else _SHAPE for item, _ in sized]
    sizes = [fit.amplitude(*item, coefficients) for item, coefficients in sized]
    return max((share * one for share, one in zip(shares, sizes, strict=True)), default=0.0)


def imitated(fit: LinearisedFit, chosen: Chosen, effect: Effect, nonlinear: tuple[float, ...]) -> float:
    """Size up to which an effect may only be the shape of what imitates it beside it [rad rms].

    Over part of a turn, gravity on a soft cup is a runout but for some per cent: the torsion's own shape; and
    two large effects may undo each other but for as much. The encoders' zeros have no shape that could be
    wrong; another law of torsion by torque is a shape itself.
    """
    if effect.name == _TORSION:
        return 0.0
    part = _part(fit, chosen, effect, nonlinear)
    return _SHAPE * float(np.std(part - projection(fit.data.offsets, part)))


def smooth(effect: Effect) -> bool:
    """Whether an effect has no line of its own: it goes with torque, speed, time or the output's turn."""
    if isinstance(effect, UnmodelledTerm):
        return False
    slow = effect.frame == "output" and not effect.nonlinear
    return effect.broadband or slow or effect.frame in ("torque", "time")


def least_size(fit: LinearisedFit, effect: Effect, nonlinear: tuple[float, ...]) -> float:
    """Size that an effect has to have in the end [rad rms].

    Rounding to counts is no noise where an encoder hardly moves: it looks like a delay; nor at a speed that
    comes back: there the input's, of which no wave is known as of the output's, is a line whose phase slips.
    What smoothing left of the torque's noise, or cut of its corners, bends the torsion: a loop or teeth that
    differ, of which parameters imitate most, may follow it. Torsion by a late torque is a loop.
    """
    if effect.stage == Stage.STREAM:
        return max(LEAST_SIZE, _ROUNDED * fit.data.counted)
    if effect.wanders(nonlinear):
        return max(LEAST_SIZE, _ROUNDED * rounding(fit.data.count_steps[0]))
    if not effect.of_teeth and effect.name != _LOOP:
        return LEAST_SIZE
    whole, at = fit.whole, fit.data.at
    slope, off = whole.predicted_torque_slope[at], [_SMOOTHED * fit.data.source.torque_deviation]
    if effect.name == _LOOP:
        off += [_CYCLES * usual_step(whole.time) * fit.data.model.rate(whole.torque)]
    by_torque = [float(np.sqrt(np.mean((slope * one[at]) ** 2))) for one in off]
    return max(LEAST_SIZE, *by_torque)


def needed(fit: LinearisedFit, chosen: Chosen) -> Chosen:
    """The chosen effects that are still needed beside the others."""
    for index, (effect, nonlinear) in enumerate(chosen):
        if effect.given:
            continue
        rest = chosen[:index] + chosen[index + 1 :]
        blind = isinstance(effect, UnmodelledTerm) and not effect.predictive
        least = _CERTAIN_SIZE if blind else least_size(fit, effect, nonlinear)
        small = size(fit, rest, effect, nonlinear) < least
        if blind and not small:
            continue
        gain, predicted = held_out_gain(fit, chosen, index)
        itself = sensible(fit, chosen)[index] and not _beyond_bounds(fit, chosen, rest, gain)
        itself = itself and (smooth(effect) or not _rounded(fit, chosen, rest))
        certain = itself and holds(gain, predicted) and chance(fit, chosen, index) <= FAMILY_ERROR
        if small or not certain:
            return needed(fit, rest)
    return chosen


def _rounded(fit: LinearisedFit, chosen: Chosen, rest: Chosen) -> bool:
    """Whether rounding to the output's counts explains most of what the rest does not.

    Beside noise its mean is a wave of the angle that is rounded, of one period a count (Widrow, Kollar and
    Liu, IEEE Trans. Instrum. Meas. 45(2), 1996); at a speed that comes back that is a line of some order.
    """
    step = fit.data.count_steps[1]
    if not step:
        return False
    phase = 2.0 * np.pi / step * (fit.data.record.output_angle - fit.remainder(rest))
    wave = np.column_stack((np.cos(phase), np.sin(phase)))
    beside = fit.deviance(rest, wave) - fit.deviance(chosen, wave)
    return beside < _MOST * (fit.deviance(rest) - fit.deviance(chosen))


def _beyond_bounds(fit: LinearisedFit, chosen: Chosen, rest: Chosen, gain: Floats) -> bool:
    """Whether the parameters, were they free of bounds, would do nearly all that an effect brings.

    Noise of a torque makes a joint look stiffer: a hardening from zero on is then a negative compliance. What
    it brings is counted from parameters that had time to get along without it.
    """
    if wanders(chosen):
        return False
    own, least = float(gain.sum()) / _OWN, fit.deviance(chosen)
    if own >= fit.deviance(rest) - least:
        return False
    return own < settle(fit.corrected(rest), rest, learn=False).deviance(rest) - least


def held_out_gain(fit: LinearisedFit, chosen: Chosen, index: int) -> tuple[Floats, Floats]:
    """Gain of one of the chosen effects in held-out blocks; see :meth:`Design.held_out_gain`.

    An effect that wanders cannot be predicted from block to block: its gain in each block beyond that of as
    many columns by chance.
    """
    place = fit.places(chosen)[index]
    if wanders(chosen[index : index + 1]):
        others = (*chosen[:index], *chosen[index + 1 :])
        without, beside = (block_deviances(fit, some) for some in (others, chosen))
        gain = without - beside - _CHANCE_SHARE * (place.stop - place.start) / without.size
        return gain, np.maximum(gain, 0.0)
    return fit.design(chosen).held_out_gain(place)


def wanders(chosen: Chosen) -> bool:
    """Whether amplitude and phase of one of the effects may wander over the record."""
    return any(effect.wanders(nonlinear) for effect, nonlinear in chosen)


def block_deviances(fit: LinearisedFit, chosen: Chosen) -> Floats:
    """Residual sum of squares of a fit to all blocks, in every block, less that of the data."""
    beta, _, built = fit.fit(chosen)
    return np.asarray(np.einsum("k,bkl,l->b", beta, built.gram, beta) - 2.0 * built.moment @ beta)


def size(fit: LinearisedFit, chosen: Chosen, effect: Effect, nonlinear: tuple[float, ...]) -> float:
    """Rms of what the model and the chosen effects, fitted to an effect's part, leave of it [rad]."""
    return float(np.std(own_part(fit, chosen, _part(fit, chosen, effect, nonlinear))))


def own_part(fit: LinearisedFit, chosen: Chosen, part: Floats) -> Floats:
    """What the model and the chosen effects, fitted to a part or several, leave of them; (n,) or (n, k)."""
    fixed = np.concatenate((fit.always(), fit.joined(chosen)), axis=1)
    white = fit.whiten(part, fit.data.run)
    moment = [one.T @ white for one in (fit.always_white, *(fit.white(*item) for item in chosen))]
    return np.asarray(part - fixed @ solve(fit.design(chosen).whole[0], np.concatenate(moment)))


def _part(fit: LinearisedFit, chosen: Chosen, effect: Effect, nonlinear: tuple[float, ...]) -> Floats:
    """What an effect adds at the size that fits beside those chosen [rad], (n,)."""
    columns = fit.columns(effect, nonlinear)
    return np.asarray(columns @ fit.fit((*chosen, (effect, nonlinear)))[0][-columns.shape[1] :])


def _confirmed(fit: LinearisedFit, chosen: Chosen, effect: Effect, nonlinear: tuple[float, ...]) -> bool:
    """Whether held-out blocks confirm a gain; a term that is not predictive needs a large one."""
    if isinstance(effect, UnmodelledTerm) and not effect.predictive:
        return size(fit, chosen, effect, nonlinear) > _CERTAIN_SIZE and lasting(fit, chosen, effect)
    return holds(*held_out_gain(fit, (*chosen, (effect, nonlinear)), len(chosen)))


def lasting(fit: LinearisedFit, chosen: Chosen, effect: Effect, nonlinear: tuple[float, ...] = ()) -> bool:
    """Whether means over seconds are explained far better than slow noise would be, beside the zeros."""
    whole = np.column_stack((fit.remainder(chosen), fit.columns(effect, nonlinear)))
    zeros, means = _means(fit, fit.data.offsets), _means(fit, whole)
    mean, columns = np.split(means - projection(zeros, means), [1], axis=1)
    residual = mean - projection(columns, mean)
    fitted = columns.shape[1] + zeros.shape[1]
    before, after = float(np.sum(mean**2)), float(np.sum(residual**2))
    return f_test(before, after, columns.shape[1], len(mean), fitted) < _LASTING_CHANCE


def _means(fit: LinearisedFit, columns: Floats) -> Floats:
    """Over stretches of `_SECONDS` within runs."""
    # By the clock: numbered from the begin of every run, short runs would give too few means for a proof.
    stretch = np.floor(fit.data.record.time / _SECONDS)
    change = (np.diff(stretch) != 0) | (np.diff(fit.data.run) != 0)
    number = numbered(change)
    count = np.bincount(number)
    wide = columns.reshape(columns.shape[0], -1)
    means = np.stack([np.bincount(number, c) / count for c in wide.T], axis=1)
    full = count > 0.5 * np.median(count)
    return means[full].reshape(-1, *columns.shape[1:])

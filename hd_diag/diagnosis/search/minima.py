"""Other minima of the model's parameters: searched for globally beside causes, or fitted at low speed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hd_diag.diagnosis.fit.joint_refinement import settle
from hd_diag.diagnosis.fit.linearised_fit import Chosen, LinearisedFit
from hd_diag.diagnosis.fit.refit import FEW_STARTS, Refit, distinct, refit
from hd_diag.diagnosis.search.ranking import Candidate, candidates

_SLOW = 0.34  # share of the samples that count as slow
_UNEVEN = 1.3  # ratio of the residual at high and low speed from which both are fitted apart
_RESTART_GAIN = 12.0  # deviance by which another minimum must beat the present one


def speed_dependent(fit: LinearisedFit) -> bool:
    """Whether the residual differs between high and low speed."""
    speed, rest = np.abs(fit.signals.speed), fit.remainder(())
    slow, fast = np.quantile(speed, (_SLOW, 1.0 - _SLOW))
    ratio = np.std(rest[speed >= fast]) / max(float(np.std(rest[speed <= slow])), 1e-300)
    return bool(slow < 0.5 * fast and not 1.0 / _UNEVEN < ratio < _UNEVEN)


def refitted_at_low_speed(
    fit: LinearisedFit, best: list[Candidate], rng: np.random.Generator
) -> tuple[LinearisedFit, list[Candidate]]:
    """Fit with the parameters of low speed, and its candidates, if the best of them explains more there.

    A cause that changes the ripple with speed (a resonance) makes parameters fitted at all speeds wrong.
    """
    speed = np.abs(fit.data.record.speed)
    slow = refit(fit.data.record.select(speed <= np.quantile(speed, _SLOW)), fit.data.configured, rng)
    if not distinct([fit.parameters, slow.parameters])[1:]:
        return fit, best
    other = fit.moved(slow.parameters)
    trials = ((fit, best), (other, candidates(other, ())))
    here, there = (
        each.deviance(tuple((one.effect, one.nonlinear) for one in found[:1])) for each, found in trials
    )
    return trials[there < here - _RESTART_GAIN]


def restarted(fit: LinearisedFit, chosen: Chosen, rng: np.random.Generator) -> LinearisedFit:
    """Search the model's parameters globally again, now that the causes found take part freely.

    Where even flexible columns explain no more than noise gives them, no other minimum can.
    """
    more = fit.flexible()
    here = fit.deviance(chosen)
    if here - fit.deviance(chosen, more) < more.shape[1] + _RESTART_GAIN:
        return fit
    again = globally_refitted(fit, chosen, rng)
    if not distinct([fit.parameters, again.parameters])[1:]:
        return fit
    other = settle(fit.moved(again.parameters), chosen, rounds=2)
    deviance = replace(other, whiten=fit.whiten).deviance(chosen)  # with one noise model
    return other if deviance < here - _RESTART_GAIN else fit


def is_only_minimum(fit: LinearisedFit, chosen: Chosen, rng: np.random.Generator) -> bool:
    """Whether no other minimum of what is not held fits as well; the chosen effects take part freely."""
    return globally_refitted(fit, chosen, rng).trustworthy


def globally_refitted(fit: LinearisedFit, chosen: Chosen, rng: np.random.Generator) -> Refit:
    """The model's parameters searched for globally, under the torque that the chosen effects leave.

    What else these are takes part freely, and so does what their torque may be off by.
    """
    own, extra = fit.data, fit.joined(chosen)
    more = fit.effects.torque(fit.sized(chosen, fit.fit(chosen)[0]))[own.at]
    record = replace(own.record, torque=own.record.torque + more)
    return refit(record, own.configured, rng, extra, fit.parameters, FEW_STARTS, held=fit.held)

"""Linearised fits of records of the package's own drive plus added signals, for tests of the search."""

import dataclasses
import functools
from collections.abc import Callable

import numpy as np
from joint_records import NOISE, RATE, RATIO, joint, prepared

from hd_diag.diagnosis.evidence.naming import Standing
from hd_diag.diagnosis.evidence.sets import Remainders, Set
from hd_diag.diagnosis.evidence.solution import Solution, solution
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.linearised_fit import LinearisedFit, linearise
from hd_diag.diagnosis.fit.present_effects import Item
from hd_diag.diagnosis.record import Record
from hd_diag.drive import Drive, transmission_error
from hd_diag.effects import CATALOGUE
from hd_diag.effects.effect import Effect
from hd_diag.effects.signals import Signals

CONFIGURED = joint().drive
TRUE = joint(eccentricity__magnitude=12e-6, eccentricity__direction=0.6).drive
POINT = fit_parameters.vector(TRUE, CONFIGURED)
EFFECTS = {effect.name: effect for effect in CATALOGUE}
Part = Callable[[Signals], np.ndarray]


@functools.cache
def swinging(seconds: float = 20.0, seed: int = 0, drive: Drive = TRUE) -> Record:
    """A joint that moves up and down at several speeds under torques of both signs, with nested reversals."""
    time = np.arange(round(seconds * RATE)) / RATE
    angle = 60.0 * np.sin(2.0 * np.pi * time / 10.0) + 25.0 * np.sin(2.0 * np.pi * time / 3.1)
    torque = 30.0 * np.sin(2.0 * np.pi * time / 5.3) + 18.0 * np.sin(2.0 * np.pi * time / 1.7)
    noise = NOISE * np.random.default_rng(seed).standard_normal(time.size)
    output = angle / RATIO + transmission_error(drive, angle, torque) + noise
    return prepared({"time": time, "input": angle, "output": output, "torque": torque})


def bench(*parts: Part, record: Record | None = None) -> LinearisedFit:
    """Fit at the true parameters, noise learned without causes; the parts are added to the error [rad]."""
    plain = linearise(record, CONFIGURED, POINT) if record else _plain()
    added = sum((part(plain.signals) for part in parts), np.zeros(plain.data.record.size))
    moved = dataclasses.replace(plain.data.record, output_angle=plain.data.record.output_angle + added)
    return linearise(moved, CONFIGURED, POINT).with_noise(())


@functools.cache
def _plain() -> LinearisedFit:
    return linearise(swinging(), CONFIGURED, POINT)


def of(effect: Effect, **values: float) -> Part:
    """Signal of an effect with values in its stated quantities."""
    coefficients, nonlinear = effect.from_physical(values)
    return lambda signals: effect.response(signals, coefficients, nonlinear)


def chosen_set(fit: LinearisedFit, *causes: Item) -> Set:
    """Set of causes at the fit's point, without remainders."""
    return Set(fit, Remainders(()), causes, fit.data.given)


def solved(fit: LinearisedFit, *causes: Item) -> Solution:
    """Solution in which every cause is fitted and certain."""
    standings = {
        effect.name: Standing({effect.name: 0.0, "": -20.0}, frozenset(EFFECTS), 1e-5, 0.0)
        for effect, _ in causes
    }
    return solution(chosen_set(fit, *causes), standings, np.random.default_rng(0))

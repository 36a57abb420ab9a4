"""The model that a diagnosis found, as it runs: sample by sample, with causal signals."""

from __future__ import annotations

import itertools

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.diagnosis.evidence.solution import Solution
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.noise import bounds
from hd_diag.diagnosis.record import Record
from hd_diag.drive import Drive
from hd_diag.effects.effect import Effect
from hd_diag.effects.order_line import ORDER_LINE
from hd_diag.extended_model import ExtendedModel, Range, Ranges, Term
from hd_diag.model.torsion_map import TorsionMap


def extended_model(found: Solution, configured: Drive, record: Record) -> ExtendedModel:
    """The refitted drive with its causes, functions, repeating waves and the encoders' offset.

    It is valid in the range of the record.
    """
    beta, _, _ = found.fit.fit(found.chosen)
    drive = fit_parameters.drive_of(found.fit.parameters + beta[: found.fit.parameters.size], configured)
    known = [(cause.effect, cause.coefficients, cause.nonlinear) for cause in found.causes]
    sized = found.fit.sized(found.chosen, beta)
    known += [(effect, one, nonlinear) for (effect, nonlinear), one in sized if effect.given]
    known += [(one.effect, one.coefficients, one.nonlinear) for one in found.functions if one.is_described]
    known += [(ORDER_LINE, row.coefficients, row.nonlinear) for row in found.table if row.in_model]
    terms = tuple(_term(*one) for one in known)
    zeros = found.fit.data.offsets  # one per recording; a running joint uses their mean
    offset = float(zeros.mean(axis=0) @ beta[found.fit.parameters.size :][: zeros.shape[1]])
    return ExtendedModel(drive, terms, offset, _ranges(record))


def encoder_zeros(found: Solution) -> Floats:
    """Zero of the output encoder against the input encoder in each fitted recording [rad], shape (k,)."""
    data = found.fit.data
    first = np.unique(data.record.bag, return_index=True)[1]
    own = found.fit.fit(found.chosen)[0][found.fit.parameters.size :][: data.offsets.shape[1]]
    return np.asarray(data.offsets[first] @ own)


def running_residual(
    model: ExtendedModel, record: Record, torque: Floats, table: TorsionMap | None
) -> Floats:
    """Measured less predicted error (n,) [rad] of a model that runs along a record, as in the node.

    `torque` (n,) [N m] is that of the record, or as reported. `table` is the model's torsion map; without it
    the prediction is exact.
    """
    predicted = np.empty(record.size)
    for rows in itertools.starmap(slice, bounds(record.stretch)):
        speed, heat = (None if c is None else c[rows] for c in (record.reported_speed, record.temperature))
        signals = record.time[rows], record.input_angle[rows], speed, torque[rows], heat
        predicted[rows], _ = model.step(model.start(), *signals, table)
    return np.asarray(record.output_angle - record.input_angle / model.drive.kinematics.ratio - predicted)


def _term(effect: Effect, coefficients: Floats, nonlinear: tuple[float, ...]) -> Term:
    """An effect with its quantities clipped to their limits."""
    values = effect.to_physical(coefficients, nonlinear)
    limited = {
        q.name: values[q.name][0] if q.periodic else float(np.clip(values[q.name][0], q.low, q.high))
        for q in effect.quantities
    }
    inside, others = effect.from_physical(limited)
    return Term(effect, tuple(inside.tolist()), others)


def _ranges(record: Record) -> Ranges:
    """Ranges of torque, speed (including standstill) and temperature of a record."""
    heat = record.temperature
    speed = _range(np.append(record.speed, 0.0))
    return Ranges(_range(record.torque), speed, None if heat is None else _range(heat))


def _range(values: Floats) -> Range:
    return Range(float(values.min()), float(values.max()))

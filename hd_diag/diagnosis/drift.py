"""Inputs known by velocity: slow drift of the integral, and whether the velocity has its own sensor."""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls

from hd_diag.arrays import Floats, Integers
from hd_diag.diagnosis.findings import Finding
from hd_diag.diagnosis.noise import bounds
from hd_diag.diagnosis.record import MINIMUM_SAMPLES, Record, RecordError
from hd_diag.diagnosis.ripple.ripple import ripple
from hd_diag.diagnosis.smoothing import smooth
from hd_diag.diagnosis.stamps import usual_step
from hd_diag.model.transmission_error import Kinematics

_KNOTS = 5.0  # spacing of a drift's knots [s]
_MOST_KNOTS = 60  # knots in a record
_MEMORY = 0.25  # longest memory of a position filter [s]
_TAPS = 30
_SLOW = 1.0  # smoothing window that removes slow parts [s]
_MOST_ROWS = 120_000
_LEFT = 0.3  # remaining line over the largest one, which no mean of output angles gives
_COHERENT = 0.5  # share of the integral's error that the output angle explains


def drift_columns(time: Floats, record: Integers) -> Floats:
    """Piecewise linear columns (n, k) between the knots of each recording, with a sum of one.

    Times [s] and ascending recording numbers have shape (n,).
    """
    edges = bounds(record)
    whole = sum(float(np.ptp(time[begin:end])) for begin, end in edges)
    step, columns = max(_KNOTS, whole / _MOST_KNOTS), []
    for begin, end in edges:
        own = time[begin:end]
        count = max(round(float(np.ptp(own)) / step), 1) + 1
        knots = np.linspace(own.min(), own.max(), count)
        part = np.zeros((time.size, count))
        part[begin:end] = np.stack([np.interp(own, knots, one) for one in np.eye(count)], axis=1)
        columns.append(part)
    return np.concatenate(columns, axis=1)


def without_drift(values: Floats, time: Floats, record: Integers) -> Floats:
    """Values (n,) or (n, m) less a fitted drift; see :func:`drift_columns`."""
    columns, known = drift_columns(time, record), np.isfinite(values.reshape(time.size, -1)).all(axis=1)
    return np.asarray(values - columns @ np.linalg.lstsq(columns[known], values[known], rcond=None)[0])


def check_velocity(record: Record, kinematics: Kinematics) -> Finding | None:
    """A finding if the record does not prove that the input velocity has its own sensor.

    Notes
    -----
    The integral of a filtered derivative is a mean of earlier output angles with non-negative weights, so it
    is coherent and late. Such a mean is fitted to the difference between integral and output. If there is a
    second encoder, the residual has lines at the gear's orders; after a filter it has none.
    """
    if not record.by_velocity:
        return None
    record = record.select(np.arange(min(record.size, _MOST_ROWS)))
    step = usual_step(record.time)
    lags = np.unique(np.rint(np.geomspace(1.0, max(_MEMORY / step, 2.0), _TAPS)).astype(np.int64))
    inner = np.zeros(record.size, bool)
    for begin, end in bounds(record.stretch):
        inner[begin + lags[-1] : end] = True
    if np.count_nonzero(inner) < MINIMUM_SAMPLES:
        raise RecordError(
            f"too short for a velocity as input: {np.count_nonzero(inner)} samples come more than "
            f"{_MEMORY:g} s after a gap, at least {MINIMUM_SAMPLES} are needed"
        )
    late = [np.roll(record.output_angle, lag) for lag in lags]
    columns = [one - record.output_angle for one in (*late, record.input_angle / kinematics.ratio)]
    both = without_drift(np.stack(columns, axis=1)[inner], record.time[inner], record.bag[inner])
    # Fast parts determine the weights, because drift distorts slow ones.
    small = np.asarray(np.linalg.qr(both - smooth(both, record.stretch[inner], step, _SLOW), mode="r"))
    kernel, _ = nnls(small[:, :-1], small[:, -1])
    rest = both[:, -1] - both[:, :-1] @ kernel
    explained = 1.0 - float(np.var(rest) / max(np.var(both[:, -1]), 1e-300))
    try:
        given = record.time[inner], record.input_angle[inner], record.bag[inner]
        before, after = (ripple(*given[:2], values, given[2], kinematics) for values in (both[:, -1], rest))
        largest = max(line.amplitude for line in before.lines)
        if any(line.amplitude > _LEFT * largest for line in after.found):
            return None
        why = "shows no line of the gear"
    except RecordError as error:
        why = f"cannot show a line of the gear ({error})"
    text = f"the velocity {why} beside the output's angle: it is not shown to be a sensor of its own"
    if explained > _COHERENT:
        text += (
            f". It is that angle, filtered: {100 * explained:.0f} % of what its integral is off is the "
            f"output's own course, {1e3 * step * float(kernel @ lags):.0f} ms late"
        )
    text += ". No transmission error can be had of it; the robot's driver would have to publish the motor"
    return Finding("velocity_filtered", f"{text} encoder's angle or velocity", explained, "-", True)

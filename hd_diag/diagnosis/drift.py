"""Inputs known by a velocity: slow drift of its integral, and whether it is a sensor of its own."""

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

_KNOTS = 5.0  # between which a drift goes straight [s]
_MOST_KNOTS = 60  # of a record
_MEMORY = 0.25  # of a filter of positions [s]
_TAPS = 30
_SLOW = 1.0  # [s]
_MOST_ROWS = 120_000
_LEFT = 0.3  # of a line of the integral, which a mean of the output's angles cannot make
_COHERENT = 0.5  # share of the integral's error that the output's own course explains


def drift_columns(time: Floats, record: Integers) -> Floats:
    """Straight pieces between knots of each recording, which sum up to one; shape (n, k).

    Times are in s; numbers of the recordings ascend; both of shape (n,).
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
    """Values (n,) or (n, m) less what a drift could be of them; see :func:`drift_columns`."""
    columns, known = drift_columns(time, record), np.isfinite(values.reshape(time.size, -1)).all(axis=1)
    return np.asarray(values - columns @ np.linalg.lstsq(columns[known], values[known], rcond=None)[0])


def check_velocity(record: Record, kinematics: Kinematics) -> Finding | None:
    """A finding where the velocity behind the input angle is not shown to be a sensor of its own.

    Notes
    -----
    The integral of a filtered derivative is a mean of the output's angles before, with weights that are not
    negative: it is coherent and late. What the integral is off the output is fitted by such a mean; a second
    encoder leaves lines at the gear's orders, a filter leaves none.
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
    # Quick parts tell the weights: of slow ones some is forgotten in the integral.
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

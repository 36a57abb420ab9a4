"""Inputs known by a velocity: slow drift of its integral, and whether it is a sensor of its own."""

from __future__ import annotations

import numpy as np

from hd_diag.arrays import Floats, Integers
from hd_diag.diagnosis.findings import Finding
from hd_diag.diagnosis.noise import bounds
from hd_diag.diagnosis.record import Record, RecordError
from hd_diag.diagnosis.ripple.ripple import ripple
from hd_diag.diagnosis.smoothing import rate
from hd_diag.model.transmission_error import Kinematics

_KNOTS = 5.0  # between which a drift goes straight [s]
_MOST_KNOTS = 60  # of a record
_MEMORY = 0.06  # of a filter of positions [s]
_AHEAD = 0.01  # by which it may be centred [s]
_TAPS = 15
_MOST_ROWS = 120_000
_COHERENT = 0.5  # share of the integral's error that the output's own speed explains


def drift_columns(time: Floats, record: Integers) -> Floats:
    """Straight pieces between knots of each recording, which sum up to one; shape (n, k).

    Parameters
    ----------
    time : ndarray, shape (n,)
        [s]
    record : ndarray of int64, shape (n,)
        Number of the recording, ascending.
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
    A filtered derivative of the output's angle is coherent with it and late. What the integral is off the
    output is fitted by the output's own speed, before and after; a second encoder leaves lines at the gear's
    orders, a filter leaves none.
    """
    if not record.by_velocity:
        return None
    record = record.select(np.arange(min(record.size, _MOST_ROWS)))
    step = float(np.median(np.diff(record.time)))
    error = record.input_angle / kinematics.ratio - record.output_angle
    speed = rate(record.output_angle, record.stretch, step, 3.0 * step)
    every = max(round((_MEMORY + _AHEAD) / _TAPS / step), 1)
    first = -round(_AHEAD / step)
    lags = first + every * np.arange(_TAPS)
    inner = np.zeros(record.size, bool)
    for begin, end in bounds(record.stretch):
        inner[begin + lags[-1] : end + first] = True
    columns = np.stack([np.roll(speed, lag) for lag in lags], axis=1)
    both = without_drift(np.column_stack((columns, error)), record.time, record.bag)
    taps = np.linalg.lstsq(both[inner, :-1], both[inner, -1], rcond=1e-9)[0]
    rest = both[:, -1] - both[:, :-1] @ taps
    explained = 1.0 - float(np.var(rest[inner]) / max(np.var(both[inner, -1]), 1e-300))
    try:
        given = record.time[inner], record.input_angle[inner], rest[inner], record.bag[inner]
        if ripple(*given, kinematics).found:
            return None
        why = "shows no line of the gear"
    except RecordError as error:
        why = f"cannot show a line of the gear ({error})"
    text = f"the velocity {why} beside the output's angle: it is not shown to be a sensor of its own"
    if explained > _COHERENT:
        text += (
            f". It is that angle, filtered: {100 * explained:.0f} % of what its integral is off is the "
            f"output's own speed, {-1e3 * float(np.sum(taps)):.0f} ms late"
        )
    advice = (
        "No transmission error can be had of it; the robot's driver would have to publish the motor encoder's"
    )
    return Finding("velocity_filtered", f"{text}. {advice} angle or velocity", explained, "-", True)

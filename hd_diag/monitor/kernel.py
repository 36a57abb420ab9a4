"""Errors of samples, compiled; imported late because it imports numba."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hd_diag.arrays import Floats, Integers, Times
from hd_diag.model.kernel.compiler import entry_point, part
from hd_diag.model.kernel.interpolation import interpolate_at


@entry_point
def compare(
    joint: Integers,
    stamp: Times,
    paired: Integers,
    input_angle: Floats,
    output_angle: Floats,
    torque: Floats,
    speed: Floats,
    drives: Any,
    known: Floats,
    kept: Any,
    count: int,
) -> tuple[Floats, int]:
    """Errors (3, m) of samples: predicted, measured and the difference [rad]; and how many are not predicted.

    The samples are columns as in `Aligned`. Predictions are those `known` (m,) [rad], which may be empty.
    Where these are nan, the maps of the `drives` (records of `_DRIVE`) predict. The samples are written into
    `kept` (records of `SAMPLE`), from index `count` on.
    """
    size, missing = joint.size, 0
    errors = np.empty((3, size))
    predicted, measured, residual = errors[0], errors[1], errors[2]
    predicted[:] = math.nan
    if known.size:
        predicted[:] = known
    _predict(joint, input_angle, torque, drives, predicted)
    for i in range(size):
        missing += math.isnan(predicted[i])
        measured[i] = output_angle[i] - input_angle[i] / drives[joint[i]].ratio
        residual[i] = measured[i] - predicted[i]
        sample = kept[count + i]
        sample.joint, sample.stamp, sample.paired = joint[i], stamp[i], paired[i]
        sample.input_angle, sample.output_angle = input_angle[i], output_angle[i]
        sample.torque, sample.speed, sample.residual = torque[i], speed[i], residual[i]
    return errors, missing


@part
def _predict(joint: Integers, input_angle: Floats, torque: Floats, drives: Any, predicted: Floats) -> None:
    """Fill predictions that are nan as `drive.transmission_error` does, for joints that have a map."""
    rows, turn = np.empty(joint.size, np.int64), np.empty(joint.size)
    load, beta = np.empty(joint.size), np.empty(joint.size)
    for j in range(drives.size):
        drive, count = drives[j], 0
        for i in range(joint.size if drive.rows else 0):
            if joint[i] == j and math.isnan(predicted[i]):
                rows[count], turn[count] = i, drive.phase + drive.turning * input_angle[i]
                load[count] = drive.torque_sign * torque[i]
                count += 1
        if count:
            interpolate_at(drive, turn, load, beta, count)
        for k in range(count):
            i = rows[k]
            predicted[i] = -drive.torque_sign * beta[k] - drive.cup_compliance * torque[i]

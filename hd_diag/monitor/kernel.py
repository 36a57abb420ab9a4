"""Errors of samples, lost samples, compiled: imported late, for it imports numba."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hd_diag.arrays import Floats, Integers, Times
from hd_diag.model.kernel.compiler import entry_point, part
from hd_diag.model.kernel.interpolation import interpolate_at
from hd_diag.streams.rules import CLOCK_JUMP

_STEPS_TOGETHER = 32
_KEPT = 0.02  # by which the steps of a sender that keeps its period differ [-]
_OFF_MULTIPLE = 0.25  # by which a step may differ from whole periods [-]
_SAME = 0.9  # share of steps that are alike: the period is another now


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
    is_whole: bool,
    kept: Any,
    count: int,
) -> tuple[Floats, int]:
    """Errors (3, m) of samples, columns as in `Aligned`: predicted, measured and the difference [rad].

    Predicted is what is `known` (m,) [rad], which may be empty; where that is nan, unless it `is_whole`, what
    the maps of the `drives` (`DRIVE`) give. How many are still missing then is returned too: if it is none,
    the samples are put into `kept` (`SAMPLE`), from `count` on.
    """
    size, missing = joint.size, 0
    errors = np.empty((3, size))
    predicted, measured, residual = errors[0], errors[1], errors[2]
    predicted[:] = math.nan
    if known.size:
        predicted[:] = known
    if not is_whole:
        _predict(joint, input_angle, torque, drives, predicted)
        for i in range(size):
            missing += math.isnan(predicted[i])
    for i in range(0 if missing else size):
        measured[i] = output_angle[i] - input_angle[i] / drives[joint[i]].ratio
        residual[i] = measured[i] - predicted[i]
        sample = kept[count + i]
        sample.joint, sample.stamp, sample.paired = joint[i], stamp[i], paired[i]
        sample.input_angle, sample.output_angle = input_angle[i], output_angle[i]
        sample.torque, sample.speed, sample.residual = torque[i], speed[i], residual[i]
    return errors, missing


@part
def _predict(joint: Integers, input_angle: Floats, torque: Floats, drives: Any, predicted: Floats) -> None:
    """As `drive.transmission_error` by each joint's map, if it has one, where predicted is nan."""
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


@entry_point
def lost(stamps: Times, known: float) -> tuple[float, float, float, int]:
    """Period of a sender [ns] whose stamps [ns] (n,) are looked at, and what is missing among them.

    `known` is the period so far. Missing are at most as many as the long steps say, and as the whole time
    says, which short steps make up for: their number is the last. A step of `CLOCK_JUMP` or more is a pause
    of the sender or a clock that was set: nothing is known to be missing there.
    """
    steps = np.diff(stamps).astype(np.float64)
    steps = steps[(steps > 0.0) & (steps < CLOCK_JUMP)]  # no clock that was set, no pause of the sender
    usual = _known_step(steps, known)
    if usual == 0.0:
        usual = _usual_step(steps)
    if usual <= 0.0:
        return usual, 0.0, 0.0, 0
    missing = np.sum(np.rint(steps[steps > 1.5 * usual] / usual) - 1.0)
    net = np.rint(np.sum(steps) / usual) - steps.size
    return usual, missing, net, int(np.sum(steps < 0.5 * usual))


@part
def _known_step(steps: Floats, known: float) -> float:
    """The period known so far [ns], where a reader that falls behind lets samples of it through; else 0.

    Then most samples may be lost: nearly all steps are multiples of the period, and not all the same.
    """
    if known <= 0.0 or 2 * np.sum(steps > 1.5 * known) <= steps.size:
        return 0.0
    multiples = np.sort(np.rint(steps / known))
    most = same = 1
    for i in range(1, multiples.size):
        same = same + 1 if multiples[i] == multiples[i - 1] else 1
        most = max(most, same)
    whole = np.sum(np.abs(steps / known - np.rint(steps / known)) < _OFF_MULTIPLE)
    return known if most < _SAME * steps.size and whole > _SAME * steps.size else 0.0


@part
def _usual_step(steps: Floats) -> float:
    """Period of a sender [ns]: over several steps, for one that makes up for its delays has short ones."""
    if not steps.size:
        return 0.0
    span = max(1, min(_STEPS_TOGETHER, steps.size // 2))
    time = np.zeros(steps.size + 1)
    time[1:] = np.cumsum(steps)
    usual = np.median(time[span:] - time[: time.size - span]) / span
    # With many losses there is one in most spans; where the sender keeps its period a single step tells it.
    single = np.median(steps)
    is_kept = np.sum(np.abs(steps - single) < _KEPT * single) > 0.5 * steps.size
    return float(single if is_kept and single > 0.5 * usual else usual)

"""Recursive least squares of the residual's orders, compiled: imported late, for it imports numba."""

from __future__ import annotations

import math

import numpy as np

from hd_diag.arrays import Floats, Times
from hd_diag.model.kernel.compiler import entry_point

MEMORY = 30.0  # time of motion after which a sample counts for 1/e [s]
_LONGEST_STEP = 0.1  # of motion between two samples [s]; longer ones are gaps
_SLOWEST = 0.05  # of the input [rad/s]; slower is rest


@entry_point
def follow(
    stamp: Times,
    input_angle: Floats,
    output_angle: Floats,
    residual: Floats,
    last: Floats,
    gram: Floats,
    moment: Floats,
    step: Times,
) -> None:
    """Add samples to the sums of 1, cosines and sines of the orders in `residual_orders.ORDERS`.

    `last` is the input angle of the sample before, `step` its stamp, nan and 0 before the first; both change.
    """
    terms = np.ones(9)
    for i in range(stamp.size):
        elapsed = min((stamp[i] - step[0]) * 1e-9, _LONGEST_STEP)
        turned = abs(input_angle[i] - last[0])
        last[0], step[0] = input_angle[i], stamp[i]
        terms[1], terms[5] = math.cos(input_angle[i]), math.sin(input_angle[i])
        for k in (2, 3):  # twice the angle
            terms[k] = 1.0 - 2.0 * terms[k + 3] * terms[k + 3]
            terms[k + 4] = 2.0 * terms[k + 3] * terms[k - 1]
        terms[4], terms[8] = math.cos(output_angle[i]), math.sin(output_angle[i])
        if elapsed > 0.0 and turned > _SLOWEST * elapsed and math.isfinite(residual[i]):
            kept = math.exp(-elapsed / MEMORY)
            for j in range(9):
                moment[j] = moment[j] * kept + terms[j] * residual[i]
                for k in range(9):
                    gram[j, k] = gram[j, k] * kept + terms[j] * terms[k]

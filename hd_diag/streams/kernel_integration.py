"""The angle of an input of which a velocity is known, compiled: a part of `kernel`."""

from __future__ import annotations

import math
from typing import Any

from hd_diag.arrays import Floats
from hd_diag.model.kernel.compiler import part
from hd_diag.streams.rules import DRIFT_TIME, PAIRING_GAP, Given

_INPUT, _OUTPUT, _SPEED = int(Given.INPUT), int(Given.OUTPUT), int(Given.SPEED)


@part
def with_velocity(joint: Any, given: int, value: Floats) -> int:
    """What is given where an input's velocity stands for its angle: checked in its place."""
    if joint.velocity_ratio != 0.0 and given & _SPEED:
        value[0] = value[3]
        given |= _INPUT
    return given


@part
def integrate(joint: Any, stamp: int, before: int, given: int, value: Floats) -> int:
    """Put the integral of the velocity in the input angle's place; what is given then.

    It follows the output times the ratio, slowly: what both are apart is forgotten over `DRIFT_TIME`. Before
    an output is known there is no angle. `before` is the stamp of the input before.
    """
    elapsed = (stamp - before) * 1e-9
    if given & _INPUT:
        if stamp - before > PAIRING_GAP:
            joint.followed = 0  # it goes on as far off the output as it was
        joint.away += 0.5 * (joint.rate + value[3]) * elapsed * joint.followed
        joint.rate = value[3]
    if given & _OUTPUT:
        own = joint.velocity_ratio * value[1]
        if joint.followed:
            joint.away -= own - joint.own
        joint.own, joint.followed = own, 1
    if given & _INPUT and joint.followed:
        joint.drift += (1.0 - math.exp(-min(elapsed, DRIFT_TIME) / DRIFT_TIME)) * (joint.away - joint.drift)
        value[0] = joint.own + joint.away - joint.drift
        return given
    return given & ~_INPUT

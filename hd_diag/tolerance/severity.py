"""How an eccentricity that a diagnosis found stands against what the assembly may have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from hd_diag.config.parameters import Value
from hd_diag.diagnosis.diagnosis import Allowed, Diagnosis
from hd_diag.diagnosis.judgement import Answer
from hd_diag.tolerance.criteria import cup_torques
from hd_diag.tolerance.evaluation import warm_up
from hd_diag.tolerance.limit import allowed, largest_eccentricity
from hd_diag.tolerance.study import limits_and_spreads


def with_allowed(found: Diagnosis, flat: Mapping[str, Value], joint: str) -> Diagnosis:
    """The diagnosis with what the configured drive may have, as ``hd-diag tolerance`` says it.

    At the rated torque, within the joint's limits among parameters by their full names. As it is where no
    eccentricity is known, no limit is reached, or the teeth cannot bear the torque.
    """
    if not Answer(found).eccentricity > 0.0:
        return found
    drive, (limits, _) = found.configured, limits_and_spreads(flat, joint)
    warm_up()
    try:
        torque = float(cup_torques(drive, np.array([drive.rated_torque]))[0])
        least = allowed(drive, torque, limits, largest_eccentricity(drive))
    except ValueError:
        return found
    return replace(found, allowed=Allowed(*least)) if least else found

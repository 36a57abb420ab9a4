"""A bag of a joint whose output encoder is driven by an off-centre pinion.

python docs/examples/pinion_joint.py pinion.mcap
"""

from __future__ import annotations

import math
import sys

import numpy as np

from hd_diag.config.configuration import resolve
from hd_diag.model.torsion_map import ARCSEC
from hd_diag.simulation import Motion, Noise, Samples, SimulatedJoint, write_bag

TRUTH = {"joint_1.eccentricity.magnitude": 12e-6, "joint_1.eccentricity.direction": 0.8}  # [m], [rad]
SIZE, DIRECTION = 6.0 * ARCSEC, math.radians(70.0)  # at the output [rad]
PINION_RATIO = 22.5
MOTION = Motion(duration=120.0, sample_rate=200.0)


def misread(samples: Samples) -> Samples:
    """Samples with the output angle as the encoder on the pinion gives it."""
    pinion = PINION_RATIO * samples.output_angle
    return samples._replace(output_angle=samples.output_angle + SIZE * np.cos(pinion - DIRECTION))


def joint() -> SimulatedJoint:
    """A joint with an eccentricity and the pinion's encoder."""
    return SimulatedJoint(resolve(TRUTH).joints[0].drive, Noise(white=1.0 * ARCSEC), alter=misread)


if __name__ == "__main__":
    write_bag(
        sys.argv[1], resolve({}), MOTION, np.random.default_rng(1), {"joint_1": joint()}, overwrite=True
    )

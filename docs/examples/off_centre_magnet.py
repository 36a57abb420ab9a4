"""A bag of a joint whose motor encoder has an off-centre magnet; its 12 µm eccentricity is not configured.

python docs/examples/off_centre_magnet.py magnet.mcap
"""

from __future__ import annotations

import math
import sys

import numpy as np

from hd_diag.config.configuration import resolve
from hd_diag.model.torsion_map import ARCSEC
from hd_diag.simulation import Motion, Noise, Samples, SimulatedJoint, write_bag

SIZE, DIRECTION = 4.0e-3, math.radians(110.0)  # of the reading's error, at the motor [rad]
TRUTH = {"joint_1.eccentricity.magnitude": 12e-6, "joint_1.eccentricity.direction": 0.8}  # [m], [rad]


def misread(samples: Samples) -> Samples:
    """Samples with the input angle as an off-centre magnet gives it."""
    return samples._replace(input_angle=samples.input_angle + SIZE * np.cos(samples.input_angle - DIRECTION))


if __name__ == "__main__":
    drive = resolve(TRUTH).joints[0].drive
    joint = SimulatedJoint(drive, Noise(white=1.0 * ARCSEC, torque=0.05), alter=misread)
    motion = Motion(duration=120.0, sample_rate=250.0)
    rng = np.random.default_rng(2)
    truth = {"joint_1": joint}
    write_bag(sys.argv[1], resolve({}), motion, rng, truth, with_temperature=True, overwrite=True)

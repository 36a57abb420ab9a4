"""Backlash, load and transmission error of the example drive, 10 µm off centre, at three input angles."""

import numpy as np

from hd_diag.config.configuration import resolve
from hd_diag.drive import mesh_state, transmission_error

drive = resolve({"joint_1.eccentricity.magnitude": 10e-6}).joints[0].drive
angle, torque = np.array([0.0, 0.5, 1.0]), np.full(3, 14.0)  # [rad], [N m] on the link
teeth = mesh_state(drive, angle, drive.frame.cup_torque(torque))
least, peak = teeth.minimum_backlash, teeth.peak_load  # [m], [N]
error = transmission_error(drive, angle, torque)  # [rad]

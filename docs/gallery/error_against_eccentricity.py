"""Transmission error over the eccentricity: far from proportional."""

import matplotlib.pyplot as plt
import numpy as np

import hd_diag

ARCSEC = np.pi / 180 / 3600
angle = np.linspace(0.0, 2 * np.pi, 720)  # of the input, a whole turn
sizes = np.arange(0.0, 20.5e-6, 1e-6)
swing = []
for size in sizes:
    drive = hd_diag.gear("CSG-25-100", eccentricity={"magnitude": size, "direction": 0.0})
    error = hd_diag.transmission_error(drive, angle, drive.rated_torque / 2)
    swing.append(np.ptp(error) / ARCSEC)

figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
axes.plot(1e6 * sizes, swing, marker=".")
axes.set(xlabel="eccentricity [µm]", ylabel="error, peak to peak [arcsec]")
figure.savefig("error_against_eccentricity.svg")

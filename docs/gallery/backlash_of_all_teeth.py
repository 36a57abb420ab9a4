"""Backlash of every tooth pair at one moment, centred and 10 µm off centre."""

import matplotlib.pyplot as plt
import numpy as np

import hd_diag

figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
for size in (0.0, 10e-6):
    drive = hd_diag.gear("CSG-25-100", eccentricity={"magnitude": size, "direction": 0.0})
    teeth = hd_diag.mesh_state(drive, angle=0.0, torque=0.0)
    least = teeth.backlash[0].min(axis=0)  # of both flanks [m]
    place = 360.0 * np.arange(least.size) / least.size
    axes.plot(place, 1e6 * np.where(least < 30e-6, least, np.nan), label=f"{size * 1e6:.0f} µm off centre")
axes.set(xlabel="tooth's place on the flexspline [°]", ylabel="backlash [µm]")
axes.legend()
figure.savefig("backlash_of_all_teeth.svg")

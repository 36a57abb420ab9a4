"""Backlash along the face width: the cup's cone, and a wave generator that leans by 1 mrad."""

import matplotlib.pyplot as plt
import numpy as np

import hd_diag

cup = {"face_width": 12e-3, "cup_length": 40e-3, "sections": 5}  # [m]
figure, both = plt.subplots(1, 2, figsize=(8, 3), layout="constrained", sharey=True)
for axes, size in zip(both, (0.0, 1e-3), strict=True):
    drive = hd_diag.gear("CSG-25-100", tilt={"magnitude": size, "direction": np.pi / 2}, **cup)
    backlash = hd_diag.mesh_state(drive, angle=0.0, torque=0.0).section_backlash[0].min(axis=1)
    place = 360.0 * np.arange(backlash.shape[1]) / backlash.shape[1]
    for number, least in enumerate(backlash):
        axes.plot(place, 1e6 * np.where(least < 30e-6, least, np.nan), label=f"section {number + 1}")
    axes.set(title=f"tilt {1e3 * size:.1f} mrad", xlabel="tooth's place [°]")
both[0].set_ylabel("backlash [µm]")
figure.legend(*both[0].get_legend_handles_labels(), loc="outside right", fontsize="small")
figure.savefig("tilt_and_sections.svg")

"""Force on every tooth pair at one moment, under the rated torque."""

import matplotlib.pyplot as plt
import numpy as np

import hd_diag

figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
for size in (0.0, 10e-6):
    drive = hd_diag.gear("CSG-25-100", eccentricity={"magnitude": size, "direction": np.pi / 2})
    teeth = hd_diag.mesh_state(drive, angle=0.0, torque=drive.rated_torque)
    force = teeth.load[0].sum(axis=0)  # of both flanks [N]
    loaded, peak = int(teeth.loaded_pairs[0]), float(teeth.peak_load[0])
    label = f"{size * 1e6:.0f} µm off centre: {loaded} pairs, {peak:.0f} N at most"
    axes.plot(360.0 * np.arange(force.size) / force.size, force, label=label)
axes.set(xlabel="tooth's place on the flexspline [°]", ylabel="force [N]")
axes.legend()
figure.savefig("load_at_one_moment.svg")

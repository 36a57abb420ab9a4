"""What an assembly may have of both: eccentricity against tilt, with the limits of interference and load."""

import matplotlib.pyplot as plt
import numpy as np

import hd_diag
from hd_diag.tolerance.limit import frontier, largest_eccentricity

drive = hd_diag.gear("CSG-25-100")
limits = {"interference": 14e-6, "overlap": 43e-6, "peak_tooth_load": 78.0}  # [m], [m], [N]
largest, torque = largest_eccentricity(drive), drive.rated_torque
rays = [frontier(drive, torque, limits, largest, share) for share in np.linspace(-1.0, 1.0, 13)]

figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
for name in limits:
    eccentricity, tilt = np.array([ray[name] for ray in rays]).T
    axes.plot(1e3 * tilt, 1e6 * eccentricity, label=name.replace("_", " "))
axes.axvline(0.0, color="grey", linewidth=0.5)
axes.set(xlabel="tilt, right: towards the eccentricity, left: against it [mrad]", ylabel="eccentricity [µm]")
axes.set_ylim(bottom=0.0)
axes.legend(fontsize="x-small")
figure.savefig("eccentricity_against_tilt.svg")

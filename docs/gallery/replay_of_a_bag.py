"""A bag run through the model: measured error beside what two configurations predict."""

import subprocess
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import hd_diag

ARCSEC = np.pi / 180 / 3600
Path("elbow.yaml").unlink(missing_ok=True)
made = ["--eccentricity-um", "12", "--duration", "20", "--angle-noise-arcsec", "0.5", "--out", "elbow.mcap"]
subprocess.run(["hd-diag", "gear", "CSG-25-100", "--joint", "elbow", "--out", "elbow.yaml"], check=True)
subprocess.run(["hd-diag", "simulate", "--config", "elbow.yaml", *made, "--overwrite"], check=True)

elbow = hd_diag.load("elbow.yaml")["elbow"]
record = hd_diag.read("elbow.mcap", elbow)
measured = record.output_angle - record.input_angle / elbow.drive.frame.ratio
some = slice(2000, 2500)
figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
axes.plot(record.time[some], measured[some] / ARCSEC, color="grey", label="measured")
for size in (0.0, 12e-6):
    drive = hd_diag.gear("CSG-25-100", eccentricity={"magnitude": size, "direction": 0.0})
    error = hd_diag.transmission_error(drive, record.input_angle[some], record.torque[some])
    axes.plot(record.time[some], error / ARCSEC, label=f"predicted, {1e6 * size:.0f} µm off centre")
axes.set(xlabel="time [s]", ylabel="transmission error [arcsec]")
axes.legend(fontsize="small")
figure.savefig("replay_of_a_bag.svg")

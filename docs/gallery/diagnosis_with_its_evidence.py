"""A hidden eccentricity found in a record: the error that remains, step by step, beside the noise."""

import subprocess
import textwrap
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
answer = hd_diag.verdict(hd_diag.diagnose(hd_diag.read("elbow.mcap", elbow), elbow.drive), "elbow")

left = {"as configured": "nominal", "refitted": "refit", "with causes": "extended", "noise": "noise_floor"}
figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
axes.barh([*left], [answer[key]["rms"] / ARCSEC for key in left.values()], color="steelblue")
axes.invert_yaxis()
axes.set(xlabel="error that is left on held-out data [arcsec rms]")
axes.set_title("\n".join(textwrap.wrap(answer["verdict"], 100)), fontsize="small", loc="left")
figure.savefig("diagnosis_with_its_evidence.svg")

"""A hidden eccentricity found in a record: the error that remains, step by step, beside the noise."""

import subprocess
import textwrap

import matplotlib.pyplot as plt
import numpy as np

import hd_diag

ARCSEC = np.pi / 180 / 3600
made = ["--eccentricity-um", "12", "--duration", "60", "--rate", "100", "--angle-noise-arcsec", "0.5"]
subprocess.run(["hd-diag", "simulate", *made, "--out", "joint.mcap", "--overwrite"], check=True)

drive = hd_diag.gear()  # the example drive, as it should be: without eccentricity
answer = hd_diag.verdict(hd_diag.diagnose(hd_diag.read("joint.mcap", "joint_1"), drive))

left = {"as configured": "nominal", "refitted": "refit", "with causes": "extended", "noise": "noise_floor"}
figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
axes.barh([*left], [answer[key]["rms"] / ARCSEC for key in left.values()], color="steelblue")
axes.invert_yaxis()
axes.set(xlabel="error that is left on held-out data [arcsec rms]")
axes.set_title("\n".join(textwrap.wrap(answer["verdict"], 100)), fontsize="small", loc="left")
figure.savefig("diagnosis_with_its_evidence.svg")

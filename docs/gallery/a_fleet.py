"""Three recordings of one joint whose eccentricity grows: the trend that `hd-diag fleet` sees."""

import subprocess
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pyarrow.parquet as parquet

DAY = 86_400
Path("bags").mkdir(exist_ok=True)
for day, size in enumerate((6, 9, 12)):
    made = ["--eccentricity-um", str(size), "--duration", "60", "--rate", "50", "--angle-noise-arcsec", "0.5"]
    stamp = ["--start-time", str(1.767e9 + day * DAY), "--seed", str(day)]
    command = ["hd-diag", "simulate", *made, *stamp, "--out", f"bags/{day}.mcap", "--overwrite"]
    subprocess.run(command, check=True)
command = ["hd-diag", "fleet", "bags", "--out", "fleet.parquet"]
subprocess.run(command, check=True)

table = parquet.read_table("fleet.parquet").to_pydict()
size, spread = (np.array(table[name]) for name in ("eccentricity_m", "eccentricity_std_m"))
figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
axes.errorbar(np.arange(size.size), 1e6 * size, 1.96e6 * spread, marker="o", capsize=4)
axes.set(xlabel="recording, one a day", ylabel="eccentricity [µm]", xticks=np.arange(size.size))
figure.savefig("a_fleet.svg")

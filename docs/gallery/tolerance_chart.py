"""How much eccentricity an assembly may have: the share of good ones over the tolerance."""

import json
import subprocess

import matplotlib.pyplot as plt

command = ["hd-diag", "tolerance", "--samples", "100", "--sensitivity-samples", "0", "--json", "-"]
found = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
drawn = found["assemblies"]
tolerance = [1e6 * size for size in drawn["tolerances"]]

figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
for name, one in drawn["yield"].items():
    axes.plot(
        tolerance, [100 * share for share in one["share"]], label=name, linewidth=3 if name == "all" else 1
    )
axes.axvline(1e6 * found["allowed"]["eccentricity"], linestyle=":", color="grey", label="allowed")
axes.set(xlabel="tolerance of the eccentricity [µm]", ylabel="good assemblies [%]")
axes.legend(fontsize="x-small")
figure.savefig("tolerance_chart.svg")

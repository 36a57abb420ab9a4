"""Speed of the mesh model: the numpy modules against the compiled path, measured in one run.

    python bench/bench_model.py [--moments N] [--torques Q] [--json FILE]

Median of repeated calls on one core, on the paper's drive, eccentric by 23 um; both paths are compared first.
A map is built to twice the rated torque of 56 N m, and checked, once.
"""

# ruff: noqa: D103, T201

import argparse
import contextlib
import itertools
import json
import os
import statistics
import sys
import time
from pathlib import Path
from unittest import mock

import numpy as np

from hd_diag.model import clearance, compiled, load_sharing
from hd_diag.model.geometry import Geometry
from hd_diag.model.tooth_profile import DoubleArc
from hd_diag.model.torsion import Mesh
from hd_diag.model.torsion_map import build

DRIVE = Geometry(
    flexspline_teeth=200,
    circular_spline_teeth=202,
    semi_major=30.2584e-3,
    semi_minor=29.7404e-3,
    flexspline_tooth=DoubleArc(0.2031e-3, 0.5046e-3, (0.7625e-3, -0.0548e-3), (0.6929e-3, 0.6557e-3)),
    flexspline_root=0.4e-3,
    flexspline_tip=0.8519e-3,
    circular_spline_slot=DoubleArc(0.2313e-3, 0.4357e-3, (1.2201e-3, -0.0782e-3), (1.2791e-3, 0.5886e-3)),
    circular_spline_datum=29.868e-3,
    circular_spline_tip_radius=30.7755e-3,
)
COMPLIANCE = 1e-6
ECCENTRICITY = 23e-6j
AGREEMENT = 1e-14  # [rad]
MAP_TORQUE = 112.0  # [N m]
SAMPLES = 100_000


@contextlib.contextmanager
def one_core():
    """Keep this thread, and those that it starts, on one core."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(before)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def curve(turn):
    contact = clearance.contacts(DRIVE, turn, ECCENTRICITY)
    return load_sharing.torque_curve(contact.rotation, load_sharing.flank_stiffness(contact, COMPLIANCE))


def numpy_torsion(turn, torque):
    return load_sharing.torsion(curve(turn), torque[:, None])[:, 0]


def numpy_table(turn, torque):
    return load_sharing.torsion(curve(turn), torque)


def compiled_torsion(turn, torque):
    return compiled.torsion(DRIVE, COMPLIANCE, turn, ECCENTRICITY, 0.0, torque)


def compiled_table(turn, torque):
    return compiled.torsion_table(DRIVE, COMPLIANCE, turn, ECCENTRICITY, 0.0, torque)


def seconds(function, *arguments, budget=1.0):
    """Median time of a call on one core, after one that is not counted."""
    times = []
    with one_core():
        function(*arguments)
        while len(times) < 3 or (sum(times) < budget and len(times) < 5000):
            start = time.perf_counter()
            function(*arguments)
            times.append(time.perf_counter() - start)
    return statistics.median(times)


def compare(name, slow, fast, turn, torque, rows):
    worst = float(np.max(np.abs(slow(turn, torque) - fast(turn, torque))))
    if not worst <= AGREEMENT:
        sys.exit(f"{name}: the paths differ by {worst:.3g} rad")
    times = [seconds(function, turn, torque) / rows for function in (slow, fast)]
    return compared_times(name, *times, worst)


def compared_times(name, slow, fast, worst):
    return {"case": name, "numpy": slow, "compiled": fast, "ratio": slow / fast, "worst": worst}


def cases(moments, torques):
    turn = np.linspace(0.0, 2 * np.pi, moments, endpoint=False)
    torque = np.random.default_rng(0).uniform(-100.0, 100.0, moments)
    levels = np.linspace(-100.0, 100.0, torques)
    one = turn[:1] + 0.3, torque[:1]
    yield compare("one moment, one call", numpy_torsion, compiled_torsion, *one, 1)
    yield compare(f"each of {moments} moments", numpy_torsion, compiled_torsion, turn, torque, moments)
    name = f"table row of {torques} torques, each of {moments}"
    yield compare(name, numpy_table, compiled_table, turn, levels, moments)


def compiled_only(moments):
    turn = np.linspace(0.0, 2 * np.pi, moments, endpoint=False)
    torque = np.random.default_rng(0).uniform(-100.0, 100.0, moments)
    mesh = (DRIVE, COMPLIANCE, turn, ECCENTRICITY, 0.0, torque)
    yield "torsion, stiffness, gradient", seconds(compiled.torsion_and_gradient, *mesh) / moments
    dense = seconds(compiled.contacts, DRIVE, turn, ECCENTRICITY)
    yield "dense contacts", dense / moments
    yield "dense contacts, numpy", seconds(clearance.contacts, DRIVE, turn, ECCENTRICITY) / moments


def by_numpy(function, *arguments):
    with mock.patch.object(compiled, "available", return_value=False):
        return function(*arguments)


def duration(function, *arguments):
    with one_core():
        start = time.perf_counter()
        result = function(*arguments)
        return result, time.perf_counter() - start


def maps():
    """Building a map, and its predictions: of a joint that turns slowly, and fast, and one at a time."""
    mesh = Mesh(DRIVE, COMPLIANCE, ECCENTRICITY)
    (_, slow), (table, fast) = duration(by_numpy, build, mesh, MAP_TORQUE), duration(build, mesh, MAP_TORQUE)
    yield compared_times("map: build and check", slow, fast, 0.0)
    for name, step in (("slow, 0.3 mrad per sample", 0.0003), ("fast, 0.1 rad per sample", 0.1)):
        turn = step * np.arange(SAMPLES)
        torque = 50.0 * np.sin(1e-3 * np.arange(SAMPLES))
        yield compare(
            f"map: each of {SAMPLES}, {name}",
            lambda *place: by_numpy(table, *place),
            table,
            turn,
            torque,
            SAMPLES,
        )
    yield compare(
        "map: one, one call", lambda *place: by_numpy(table, *place), table, turn[:1], torque[:1], 1
    )


def first_call():
    """Import of numba and first torsion in this process: compiled, or read from the cache."""
    start = time.perf_counter()
    if not compiled.available():
        sys.exit("numba is not installed: there is only the numpy path")
    imported = time.perf_counter()
    compiled_torsion(np.zeros(1), np.ones(1))
    return {"import": imported - start, "first torsion": time.perf_counter() - imported}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--moments", type=int, default=1000)
    parser.add_argument("--torques", type=int, default=64)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    start = first_call()
    print(f"import of numba {start['import']:.2f} s, first torsion {start['first torsion']:.2f} s")
    print(f"{'us':<50}{'numpy':>12}{'compiled':>12}{'ratio':>8}{'differ [rad]':>14}")
    compared = []
    for case in itertools.chain(cases(options.moments, options.torques), maps()):
        compared.append(case)
        times = f"{case['numpy'] * 1e6:>12.3f}{case['compiled'] * 1e6:>12.3f}{case['ratio']:>8.1f}"
        print(f"{case['case']:<50}{times}{case['worst']:>14.1e}")
    alone = dict(compiled_only(options.moments))
    for name, alone_time in alone.items():
        print(f"{name:<50}{alone_time * 1e6:>24.3f}")
    if options.json:
        result = {"start [s]": start, "compared [s]": compared, "alone [s]": alone}
        options.json.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()

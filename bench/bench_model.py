"""Speed of the mesh model, for bench/suite.py.

Median of repeated calls on one core, on the paper's drive, eccentric by 23 um. A map is built to twice the
rated torque of 56 N m, and checked, once.
"""

# ruff: noqa: D103

import contextlib
import os
import statistics
import time

import numpy as np

from hd_diag.model.contact import contacts
from hd_diag.model.geometry import Geometry
from hd_diag.model.load_sharing import mesh_state
from hd_diag.model.mesh import Mesh
from hd_diag.model.tooth_profile import DoubleArc
from hd_diag.model.torsion import torsion, torsion_and_gradient, torsion_table
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
ECCENTRICITY = 23e-6j
MESH = Mesh(DRIVE, 1e-6, ECCENTRICITY)
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


def duration(function, *arguments):
    with one_core():
        start = time.perf_counter()
        result = function(*arguments)
        return result, time.perf_counter() - start


def moments(count, torques):
    """Exact solutions: of one moment, of many, of many at the same torques, with derivatives."""
    turn = np.linspace(0.0, 2 * np.pi, count, endpoint=False)
    torque = np.random.default_rng(0).uniform(-100.0, 100.0, count)
    levels = np.linspace(-100.0, 100.0, torques)
    yield "one moment, one call", seconds(torsion, MESH, turn[:1] + 0.3, torque[:1])
    yield f"each of {count} moments", seconds(torsion, MESH, turn, torque) / count
    each = seconds(torsion_table, MESH, turn, levels) / count
    yield f"table row of {torques} torques, each of {count}", each
    yield "torsion and derivatives", seconds(torsion_and_gradient, MESH, turn, torque) / count
    yield "contacts", seconds(contacts, MESH, turn) / count
    yield "state of all teeth", seconds(mesh_state, MESH, turn, torque) / count


def maps():
    """Building a map, and its predictions: of a joint that turns slowly, and fast, and one at a time."""
    table, took = duration(build, MESH, MAP_TORQUE)
    yield "map: build and check", took
    torque = 50.0 * np.sin(1e-3 * np.arange(SAMPLES))
    for name, step in (("slow, 0.3 mrad per sample", 0.0003), ("fast, 0.1 rad per sample", 0.1)):
        turn = step * np.arange(SAMPLES)
        yield f"map: each of {SAMPLES}, {name}", seconds(table, turn, torque) / SAMPLES
    yield "map: one, one call", seconds(table, turn[:1], torque[:1])

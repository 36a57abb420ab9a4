"""Sections of bench/suite.py that run in its own process: model, maps, growth, a change at run time."""

# ruff: noqa: D103

from __future__ import annotations

import dataclasses
import time

import drives
import models
import numpy as np
import paper_method
from live import config, states
from timing import cpu_time, median_time, wall_time

from hd_diag.drive import Drive, mesh_state, transmission_error
from hd_diag.extended_model import ExtendedModel
from hd_diag.model.flank_chain import chained
from hd_diag.model.mesh import Mesh
from hd_diag.model.threads import cores
from hd_diag.model.torsion import torsion
from hd_diag.model.torsion_map import build
from hd_diag.model.transmission_error import Kinematics
from hd_diag.monitor.all_joints import Monitor
from hd_diag.replay.map_builder import MapBuilder

AGREEMENT = 1e-9  # [rad]
ECCENTRICITY = 23e-6j  # [m]
MAP_TORQUE = 112.0  # [N m], twice the rated torque of the paper's drive
TURNS = (0.3, 7.7, -4.1)  # wave generator angles at which both methods are compared and timed [rad]
TORQUE = 56.0  # [N m]
BATCH = 2000  # moments
SAMPLES = 100_000
US, NS = 1e6, 1e9
TRANSMISSION_ERROR = "~/transmission_error"
EFFECTS = (
    "hysteresis",
    "stream_delay",
    "circular_spline_pitch",
    "viscous_windup",
    "thermal_drift",
    "torque_offset",
)


def mesh() -> Mesh:
    return drives.mesh(eccentricity=(0.0, ECCENTRICITY.imag))


def moment(options):
    """One moment of all teeth under load: the paper's method, one call of this model, and a batch."""
    gear, own = paper_method.Gear(), Drive(mesh(), Kinematics(-100.0), TORQUE)

    def plainly():
        return [paper_method.one_moment(gear, turn, ECCENTRICITY, TORQUE)[0] for turn in TURNS]

    turns, load = np.array(TURNS), np.full(len(TURNS), TORQUE)
    state = mesh_state(own, turns, load)
    differ = max(
        np.abs(np.array(plainly()) - beta).max() for beta in (state.torsion, torsion(own.mesh, turns, load))
    )
    if not differ <= AGREEMENT:
        raise AssertionError(f"the methods differ by {differ:.3g} rad")
    agree = f"agree to {differ:.0e} rad"
    slow = median_time(plainly) / len(TURNS)
    yield {"what": "the paper's method: a search per pair, recursion", "value": slow * 1e3, "unit": "ms"}
    one = median_time(mesh_state, own, turns[:1], load[:1])
    against = "the paper's method"
    yield {
        "what": "one call: 200 teeth x 2 flanks and load",
        **{"value": one * US, "unit": "us", "ratio": slow / one, "against": against, "note": agree},
        **{"aim": 500, "aim_unit": "x"},
    }
    turn = np.linspace(0.0, 2 * np.pi, BATCH, endpoint=False)
    torque = np.full(BATCH, TORQUE)
    for what, function in (
        ("200 teeth x 2 flanks and load", lambda: mesh_state(own, turn, torque)),
        ("torsion alone", lambda: torsion(own.mesh, turn, torque)),
    ):
        each, together = median_time(function) / BATCH, wall_time(function) / BATCH
        yield {
            "what": f"each of {BATCH}: {what}",
            **{"value": each * US, "unit": "us", "ratio": slow / each, "against": against},
            **{"aim": 20, "aim_unit": "us"},
        }
        yield {
            "what": f"each of {BATCH}: {what}, {all_cores()}",
            **{"value": together * US, "unit": "us", "ratio": slow / together},
            **{"against": f"{against}, on one", "aim": 5000, "aim_unit": "x"},
        }


def all_cores():
    return f"all {cores()} cores, wall"


def width(options):
    """The paper's drive in sections along the width, with a coned cup: one moment, and the map."""
    turn, torque, plane = np.linspace(0.0, 2 * np.pi, BATCH, endpoint=False), np.full(BATCH, TORQUE), None
    for sections in (1, 3, 5):
        geometry = drives.geometry(face_width=0.011, cup_length=0.04, sections=sections)
        own = dataclasses.replace(mesh(), geometry=geometry)
        each, took = median_time(torsion, own, turn, torque) / BATCH, cpu_time(build, own, MAP_TORQUE)[1]
        plane = plane or each
        told = f"{sections} section{'s' * (sections > 1)}"
        aims = {"aim": round(5 * plane * US), "aim_unit": "us"} if sections > 1 else {}
        yield {
            "what": f"{told}: torsion of a moment",
            **{"value": each * US, "unit": "us", "ratio": each / plane, "against": "one section", **aims},
        }
        yield {"what": f"{told}: map", "value": took, "unit": "s", "aim": 1, "aim_unit": "s"}


def flanks(options):
    """One moment of the paper's drive, with flanks as double arcs and as chains of three pieces."""
    turn, torque, own = np.linspace(0.0, 2 * np.pi, BATCH, endpoint=False), np.full(BATCH, TORQUE), mesh()
    plain = own.geometry
    low = plain.circular_spline_tip_radius - plain.circular_spline_datum
    tooth = chained(plain.flexspline_tooth, plain.flexspline_root, plain.flexspline_tip)
    slot = chained(plain.circular_spline_slot, 0.99 * low, plain.slot_end)
    chains = dataclasses.replace(plain, flexspline_tooth=tooth, circular_spline_slot=slot)
    arcs = None
    for what, geometry in (("double arcs", plain), ("chains of three pieces", chains)):
        each = median_time(torsion, dataclasses.replace(own, geometry=geometry), turn, torque) / BATCH
        arcs = arcs or each
        yield {
            "what": f"{what}: torsion of a moment",
            **{"value": each * US, "unit": "us", "ratio": each / arcs, "against": "double arcs"},
        }


def maps(options):
    """Building the map of the transmission error, and predictions from it."""
    table, took = cpu_time(build, mesh(), MAP_TORQUE)
    yield {"what": "build and check, +-112 N m", "value": took, "unit": "s", "aim": 1, "aim_unit": "s"}
    rng = np.random.default_rng(0)
    torque = 50.0 * np.sin(1e-3 * np.arange(SAMPLES))
    motions = {
        "slow, 0.3 mrad per sample": 0.0003 * np.arange(SAMPLES),
        "fast, 0.1 rad per sample": 0.1 * np.arange(SAMPLES),
        "anywhere": rng.uniform(0.0, 2 * np.pi, SAMPLES),
    }
    exact = median_time(torsion, table.mesh, motions["anywhere"][:BATCH], torque[:BATCH]) / BATCH
    for name, turn in motions.items():
        each = median_time(table, turn, torque) / SAMPLES
        yield {
            "what": f"prediction, {name}",
            **{"value": each * NS, "unit": "ns", "ratio": exact / each, "against": "exact torsion"},
            **{"aim": 100, "aim_unit": "ns"},
        }
    together = wall_time(table, motions["anywhere"], torque) / SAMPLES
    yield {
        "what": f"prediction, anywhere, {all_cores()}",
        **{"value": together * NS, "unit": "ns", "ratio": exact / together},
        **{"against": "exact torsion, on one"},
    }
    one = median_time(table, motions["anywhere"][:1], torque[:1])
    yield {"what": "prediction, one call for one sample", "value": one * US, "unit": "us"}


def run_time(options):
    """A change of eccentricity while a monitor runs: time to the next sample, and until its map is in use.

    The prediction is compared with the exact one for the new eccentricity.
    """
    before = config("joint_1")
    monitor, stamp = Monitor(before), 1_700_000_000_000_000_000
    first = sample(stamp)
    monitor.mixed_states(np.array([stamp]), (first,))
    changed = config("joint_1", joint_1__eccentricity__magnitude=17e-6)
    builder, start = MapBuilder(), time.perf_counter()
    try:
        monitor.configure(changed)
        builder.request(changed.joints[0])
        published = monitor.mixed_states(np.array([stamp + 1_000_000]), (sample(stamp + 1_000_000),))
        in_force = time.perf_counter() - start
        check_in_force(published, changed.joints[0].drive)
        name, table = builder.finished.get(timeout=60.0)
        if isinstance(table, Exception) or not monitor.use_map(name, table):
            raise AssertionError(f"no map came of the change: {table}")
        took = time.perf_counter() - start
    finally:
        builder.close()
    yield {"what": "change and the next sample, exact, wall", "value": in_force * 1e3, "unit": "ms"}
    yield {"what": "its map in use, wall", "value": took, "unit": "s", "aim": 1, "aim_unit": "s"}


def check_in_force(published, drive):
    found = next(each for each in published if each.topic == TRANSMISSION_ERROR)
    expected = transmission_error(drive, np.array([0.7]), np.array([20.0]))
    if not np.array_equal(np.ravel(found.position), expected):
        raise AssertionError(f"predicted {found.position} rad instead of {expected}")


def sample(stamp, joints=1):
    """One message of several joints with everything that they report."""
    names = [name for k in range(1, joints + 1) for name in (f"joint_{k}_motor", f"joint_{k}")]
    position = np.tile([0.7, 0.007], (1, joints))
    effort = np.tile([0.0, 20.0], (1, joints))
    return states(names, [stamp], position, effort)


def growth(options):
    """Growth of the times with teeth, joints, samples and effects."""
    yield from by_teeth()
    yield from by_joints()
    yield from by_samples()
    yield from by_effects()


def by_teeth():
    first = None
    for teeth, outward in ((60, 43.5e-6), (100, 20.7e-6), (160, 5.6e-6), (200, 0.0), (320, -8.4e-6)):
        gear = drives.mesh(drives.resized(teeth, outward), eccentricity=(0.0, 5e-6))
        turn = np.linspace(0.0, 2 * np.pi, 500)
        each = median_time(torsion, gear, turn, np.full(500, 10.0), budget=0.3) / 500
        first = first or each
        yield {
            "what": f"torsion, {teeth} teeth",
            **{"value": each * US, "unit": "us", "ratio": each / first, "against": "60 teeth"},
        }


def by_joints():
    first = None
    for joints in (1, 2, 7, 14):
        names = [f"joint_{k}" for k in range(1, joints + 1)]
        settings, clock = config(*names, array_rate=0.0), [1_700_000_000_000_000_000]
        monitor = Monitor(settings)
        table = build(settings.joints[0].drive.mesh, MAP_TORQUE)
        for name in names:
            monitor.use_map(name, table)
        messages = iter([sample(clock[0] + k * 1_000_000, joints) for k in range(3000)])

        def step(monitor=monitor, messages=messages):
            message = next(messages)
            monitor.mixed_states(message.stamp, (message,))

        step()
        each = cpu_time(lambda step=step: [step() for _ in range(2000)])[1] / 2000
        first = first or each
        yield {
            "what": f"monitor, one message of {joints} joint{'s' * (joints > 1)}",
            **{"value": each * US, "unit": "us", "ratio": each / first, "against": "1 joint"},
        }


def by_samples():
    table = build(mesh(), MAP_TORQUE)
    rng, first = np.random.default_rng(0), None
    for count in (1, 100, 10_000, 1_000_000):
        turn, torque = rng.uniform(0.0, 6.0, count), rng.uniform(-50.0, 50.0, count)
        took = median_time(table, turn, torque, budget=0.5)
        first = first or took
        yield {
            "what": f"map, {count:,} sample{'s' * (count > 1)} in one call",
            **{"value": took * US, "unit": "us", "ratio": took / first, "against": "1 sample"},
        }


def by_effects():
    names, count, first = EFFECTS, 2000, None
    time_, angle, torque, temperature = models.motion(count)
    table = build(models.model().drive.mesh, MAP_TORQUE)
    for number in (0, 1, 2, 4, len(names)):
        whole: ExtendedModel = models.model(*names[:number])

        def run(whole=whole):
            return whole.step(whole.start(), time_, angle, None, torque, temperature, table)

        each = median_time(run, budget=0.5) / count
        first = first or each
        yield {
            "what": f"extended model, {number} effects, each of {count} samples",
            **{"value": each * US, "unit": "us", "ratio": each / first, "against": "none"},
        }


def tolerance(options):
    """Moments of a tolerance study: 96 angles of an assembly, with all criteria."""
    from hd_diag.tolerance.evaluation import evaluate, warm_up

    warm_up()
    own, turn = mesh(), np.linspace(0.0, 2 * np.pi, BATCH, endpoint=False)
    center = np.full(BATCH, 9e-6 + 2e-6j)
    each = median_time(evaluate, own, turn, center, np.array([-TORQUE])) / BATCH
    yield {"what": "all criteria of a moment", "value": each * US, "unit": "us"}
    assembly = dataclasses.replace(own, eccentricity=9e-6)
    exact = median_time(torsion, assembly, turn, np.full(BATCH, -TORQUE)) / BATCH
    yield {
        "what": "torsion of the same moment",
        **{"value": exact * US, "unit": "us", "ratio": each / exact, "against": "of all criteria"},
    }


SECTIONS = {
    "moment": moment,
    "width": width,
    "flanks": flanks,
    "maps": maps,
    "run_time": run_time,
    "growth": growth,
    "tolerance": tolerance,
}

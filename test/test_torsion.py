"""Torsion of a mesh over angle and torque, and inputs that a mesh refuses."""

import math
import subprocess
import sys
from dataclasses import replace
from functools import partial

import drives
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from reference import polyline, published

from hd_diag.model import kernel, threads
from hd_diag.model import torsion as module
from hd_diag.model.contact import contacts
from hd_diag.model.kernel.compiler import entry_point
from hd_diag.model.load_sharing import flank_stiffness, mesh_state, torsion_of_flanks
from hd_diag.model.mesh import Mesh
from hd_diag.model.torsion import torsion, torsion_along, torsion_and_gradient, torsion_table
from hd_diag.model.torsion_map import ARCSEC, build

Array, PAPER = polyline.Array, drives.PAPER
ASTRAY = drives.mesh(eccentricity=(5e-6, -16e-6), runout=(3e-6, 2e-6), arc_offset=4e-6)

angles = st.floats(-20, 20)
torques = st.floats(-120, 120)


def at(mesh: Mesh, angle: float, torque: float) -> float:
    return float(torsion(mesh, np.array([angle]), np.array([torque]))[0])


LIMITS = {  # the first parts to strike, and their clearance
    "root at the long axis": (drives.PAPER, 117.1e-6),
    "tip at the long axis": (
        polyline.Drive(circular_spline_datum=29.76e-3, tooth_root=0.35e-3),
        29.76e-3 + 1.2201e-3 + math.sqrt(0.2313**2 - 0.0782**2) * 1e-3 - 31.1103e-3,
    ),
    "tip at the short axis": (polyline.Drive(semi_minor=29.85e-3, semi_major=30.2e-3), 73.6e-6),
}


@pytest.mark.parametrize("place", LIMITS)
def test_refuses_a_displacement_at_which_teeth_strike(place: str) -> None:
    drive, largest = LIMITS[place]
    drives.mesh(drive, (0.6 * largest, 0.0), (0.0, 0.399 * largest))
    for eccentricity, runout in ((1.001, 0.0), (0.0, 1.001), (0.5, 0.501)):
        said = rf"eccentricity .* and runout .* {largest * 1e6:.6g} µm.*{place}"
        with pytest.raises(ValueError, match=said):
            drives.mesh(drive, (0.0, -eccentricity * largest), (runout * largest, 0.0))


DISPLACEMENT = "eccentricity .* and runout .* must add up to less than 117.1 µm"
POSITIVE = "tooth_compliance must be positive and finite, not"


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        *(("eccentricity", value, DISPLACEMENT) for value in (complex(math.nan, 0), complex(0, math.inf))),
        *(("runout", value, DISPLACEMENT) for value in (complex(math.nan, 0), complex(0, math.inf))),
        *(("tooth_compliance", x, f"{POSITIVE} {x:g} m/N") for x in (0.0, -1e-6, math.nan, math.inf)),
        *(("arc_offset", x, f"arc_offset must be finite, not {x} m") for x in (math.nan, -math.inf)),
    ],
)
def test_refuses_what_is_no_number_or_not_positive(name: str, value: complex, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Mesh(drives.geometry(), **{name: value})


STATIC = drives.mesh(eccentricity=(5e-6, -16e-6))
RUNOUT = drives.mesh(runout=(12e-6, 9e-6))
# Mesh; angle after which another mesh has the same torsion; that mesh; sign of angle, torque and torsion.
LAWS = {
    "mirror": (ASTRAY, 0.0, drives.mesh(PAPER, (5e-6, 16e-6), (3e-6, -2e-6), -4e-6), -1.0),
    "every turn": (ASTRAY, 2 * np.pi, ASTRAY, 1.0),
    "opposite displacement": (ASTRAY, 0.0, drives.mesh(PAPER, (-5e-6, 16e-6), (-3e-6, -2e-6), 4e-6), 1.0),
    "static eccentricity, every half turn": (STATIC, np.pi, STATIC, 1.0),
    # A runout meets every slot alike: differences in the housing need something fixed in it.
    "runout alone, every tooth": (RUNOUT, 7 * 2 * np.pi / 202, RUNOUT, 1.0),
}


@pytest.mark.parametrize("law", LAWS)
@given(angle=angles, torque=torques)
@settings(max_examples=30)
def test_symmetries(law: str, angle: float, torque: float) -> None:
    mesh, later, other, sign = LAWS[law]
    found = sign * at(other, sign * angle + later, sign * torque)
    assert_allclose(found, at(mesh, angle, torque), rtol=1e-9, atol=1e-13)


def test_nan_where_no_tooth_reaches_the_slots() -> None:
    mesh = drives.mesh(drives.shallow())
    angle = np.arange(10) * 2 * np.pi / 32 / 10
    plus_free, minus_free = np.isnan(contacts(mesh, angle).rotation).all(axis=2).T
    for torque, free in ((-1.0, minus_free), (0.0, plus_free | minus_free), (1.0, plus_free)):
        assert 0 < free.sum() < free.size
        assert_array_equal(np.isnan(torsion(mesh, angle, np.full(10, torque))), free)
    beta, gradient = torsion_along(mesh, 2 * np.pi / 256 * np.arange(256), np.full(256, 1e-3), 8)
    assert 0 < np.isnan(beta).sum() < 256
    assert_array_equal(np.isnan(gradient).any(axis=1), np.isnan(beta))


def orders(mesh: Mesh, torque: float) -> tuple[Array, float]:
    """Amplitude of every order of the wave generator's turn, and peak to peak [arcsec]."""
    angle = np.arange(8 * 202) * 2 * np.pi / (8 * 202)
    beta = torsion(mesh, angle, np.full(angle.size, torque)) / ARCSEC
    return np.abs(np.fft.rfft(beta)) * 2 / angle.size, float(np.ptp(beta))


@pytest.mark.parametrize("torque", published.ORDER_2_ARCSEC)
def test_static_eccentricity_shows_at_even_orders(torque: float) -> None:
    amplitude, peak_to_peak = orders(drives.mesh(eccentricity=(0.0, published.ECCENTRICITY)), torque)
    assert_allclose(amplitude[2], published.ORDER_2_ARCSEC[torque], atol=0.01)
    assert_allclose(peak_to_peak, published.PEAK_TO_PEAK_ARCSEC[torque], atol=0.05)
    assert np.argmax(amplitude[1:]) + 1 == 2
    assert np.max(amplitude[1:200:2]) < 1e-6


@pytest.mark.parametrize("torque", published.RIPPLE_ARCSEC)
def test_only_tooth_passing_without_eccentricity(paper_mesh: Mesh, torque: float) -> None:
    amplitude, peak_to_peak = orders(paper_mesh, torque)
    assert 0 < peak_to_peak < published.RIPPLE_ARCSEC[torque]
    others = np.delete(amplitude, np.arange(0, amplitude.size, 202))
    assert np.max(others) < 1e-6 * amplitude[202]


def test_one_moment_equals_many_and_a_table_bit_for_bit() -> None:
    angle, torque = np.linspace(-9, 40, 300), np.linspace(-70, 80, 300)
    one = [at(ASTRAY, *pair) for pair in zip(angle, torque, strict=True)]
    assert_array_equal(one, torsion(ASTRAY, angle, torque))
    angle, torque = np.array([0.2, 1.9, 5.0]), np.array([-30.0, 0.0, 1.0, 56.0])
    table = torsion_table(ASTRAY, angle, torque)
    for row, turned in enumerate(angle):
        assert_allclose(table[row], [at(ASTRAY, turned, m) for m in torque], rtol=1e-13, atol=1e-17)


BY = ("eccentricity.x", "eccentricity.y", "circular_spline_datum", "tooth_compliance", "torque")


def random_moments(seed: int, number: int) -> Array:
    random = np.random.default_rng(seed)
    return np.array([random.uniform(-2 * np.pi, 2 * np.pi, number), random.uniform(-100, 100, number)])


def shifted(mesh: Mesh, name: str, step: float) -> Mesh:
    if name == "circular_spline_datum":
        datum = mesh.geometry.circular_spline_datum + step
        return replace(mesh, geometry=replace(mesh.geometry, circular_spline_datum=datum))
    way = {"eccentricity.x": 1.0, "eccentricity.y": 1j}.get(name, 0.0)
    softer = mesh.tooth_compliance + step * (name == "tooth_compliance")
    return replace(mesh, eccentricity=mesh.eccentricity + way * step, tooth_compliance=softer)


@pytest.mark.parametrize("loaded", [True, False])
@pytest.mark.parametrize("name", BY)
def test_gradient_is_that_of_finite_differences(name: str, loaded: bool) -> None:
    """Also at zero torque, preloaded or in a gap; eccentric, so that no two flanks bound the gap at once."""
    turn, torque = random_moments(7, 300) * np.array([[1.0], [loaded]])
    step = {"torque": 1e-5, "tooth_compliance": 1e-10}.get(name, 1e-9)
    push = step if name == "torque" else 0.0
    errors, sizes = [], []
    for eccentricity in ((3e-6, 1e-6), (5e-6, -16e-6)):
        mesh = drives.mesh(eccentricity=eccentricity, runout=(3e-6, 2e-6))
        _, gradient = torsion_and_gradient(mesh, turn, torque)
        above = torsion(shifted(mesh, name, step), turn, torque + push)
        below = torsion(shifted(mesh, name, -step), turn, torque - push)
        bears = np.isfinite(gradient[:, 4]) if name == "torque" else np.full(turn.size, True)
        expected = (above - below)[bears] / (2 * step)
        errors.append(np.abs(gradient[bears, BY.index(name)] - expected))
        sizes.append(expected)
    scale = np.sqrt(np.mean(np.concatenate(sizes) ** 2))
    # If a flank begins to carry within the step, beta has a kink without derivative; this is rare.
    assert np.quantile(np.concatenate(errors), 0.98) <= 1e-7 * scale + 1e-15 / step


def test_gradient_has_the_torsion_and_is_infinite_by_torque_in_a_gap(paper_mesh: Mesh) -> None:
    turn, torque = random_moments(6, 50)
    torque[::5] = 0.0
    beta, gradient = torsion_and_gradient(paper_mesh, turn, torque)
    assert_array_equal(beta, torsion(paper_mesh, turn, torque))
    assert_array_equal(np.isinf(gradient[:, 4]), torque == 0.0)
    assert_array_equal(gradient[torque == 0.0, 3], 0.0)


@pytest.mark.parametrize("outward", [0.0, 30e-6], ids=["preload", "gap"])
def test_along_samples_it_is_exact_at_nodes_and_straight_between(outward: float) -> None:
    """This holds at all teeth if nothing fixed in the housing displaces the wave generator."""
    drive = replace(drives.PAPER, circular_spline_datum=drives.PAPER.circular_spline_datum + outward)
    mesh = drives.mesh(drive, (0.0, 0.0), (3e-6, 1e-6))
    random, steps = np.random.default_rng(8), 3
    step = 2 * np.pi / (steps * mesh.geometry.circular_spline_teeth)
    node, torque = random.integers(0, 600, 400), random.uniform(-90.0, 90.0, 400)

    def along(place: Array, torque: Array = torque) -> Array:
        return np.column_stack(torsion_along(mesh, step * (place + 1e-9), torque, steps))

    expected = np.column_stack(torsion_and_gradient(mesh, step * node, torque))
    rounding = 1e-7 * np.abs(expected).max(axis=0)
    assert module.teeth_along(mesh, steps, 400) == (1, False)
    assert np.all(np.abs(along(node) - expected) <= rounding)
    middle = 0.5 * (along(node) + along(node + 1.0))
    assert np.all(np.abs(along(node + 0.5) - middle)[:, [0, 3, 4, 5]] <= rounding[[0, 3, 4, 5]])
    order = random.permutation(400)
    assert_array_equal(along(node[order] + 0.5, torque[order]), along(node + 0.5)[order])
    idle, gradient = torsion_and_gradient(mesh, step * node, np.zeros(400))
    found = along(node, np.zeros(400))
    assert_allclose(found[:, 0], idle, rtol=0, atol=1e-12)
    if outward:
        assert np.all(np.abs(found[:, 1:4] - gradient[:, :3]) < rounding[1:4])


@pytest.mark.parametrize(("size", "samples"), [(4.0, 20_000), (16.0, 60_000), (16.0, 3000)])
def test_along_samples_a_displacement_is_carried_from_tooth_to_tooth(size: float, samples: int) -> None:
    """To 0.02 arcsec of 250; derivatives jump where pairs come into load, but are right on average."""
    mesh = drives.mesh(drives.PAPER, (0.0, 0.25e-6 * size), (1e-6, 2e-6))
    random, steps = np.random.default_rng(9), 4
    step = 2 * np.pi / (steps * mesh.geometry.circular_spline_teeth)
    turn, torque = step * random.integers(0, 808, samples), random.uniform(-90.0, 90.0, samples)
    teeth, blends = module.teeth_along(mesh, steps, samples)
    assert 1 < teeth < mesh.geometry.circular_spline_teeth
    assert blends == (samples == 3000)
    found, gradient = torsion_along(mesh, turn, torque, steps)
    exact, slopes = torsion_and_gradient(mesh, turn, torque)
    assert np.std(found - exact) < 0.02 * ARCSEC
    for column, expected in zip(gradient.T[:5], slopes.T[:5], strict=True):
        assert column @ expected / (expected @ expected) == pytest.approx(1.0, abs=0.02)
        assert np.std(column - expected) < 0.2 * np.std(expected)


def test_along_samples_it_is_solved_once_for_all_torques() -> None:
    mesh, random = drives.mesh(drives.PAPER, (0.0, 4e-6), (1e-6, 2e-6)), np.random.default_rng(10)
    turn, torque = random.uniform(0.0, 2.0 * np.pi, 500), random.uniform(-60.0, 60.0, 500)
    solved = module.TorsionAlong(mesh, turn, -70.0, 70.0, 4)
    for other in (torque, 0.5 * torque + 9.0):
        assert solved.covers(other)
        for found, expected in zip(solved(other), torsion_along(mesh, turn, other, 4), strict=True):
            assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    assert not solved.covers(torque + 20.0)


def test_numbers_that_are_not_spoil_their_own_moment_only() -> None:
    turn, torque = random_moments(5, 12)
    turn[2], torque[6] = math.nan, math.nan
    spoilt = np.isin(np.arange(12), [2, 6])
    beta, gradient = torsion_and_gradient(ASTRAY, turn, torque)
    state = mesh_state(ASTRAY, turn, torque)
    for found in (torsion(ASTRAY, turn, torque), beta, gradient[:, 0], gradient[:, 2], state.torsion):
        assert_array_equal(np.isnan(found), spoilt)
    assert np.isnan(state.backlash[2]).all()
    assert not state.load[[2, 6]].any()


def test_several_threads_give_the_same_to_the_last_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    moments, found = random_moments(14, 1003), []
    for cores in (1, 3):
        monkeypatch.setattr(threads, "cores", lambda cores=cores: cores)
        found.append((torsion(ASTRAY, *moments), *vars(mesh_state(ASTRAY, *moments)).values()))
    for one, three in zip(*found, strict=True):
        assert_array_equal(three, one)


def test_kernels_are_compiled_once() -> None:
    """The warm-up also covers strided columns and read-only arrays."""
    module.warm_up(gradient=True)
    compiled = [found for found in vars(kernel.entry).values() if hasattr(found, "signatures")]
    own = [found for found in compiled if found.py_func.__module__.endswith((".entry", ".interpolation"))]
    before = [len(found.signatures) for found in own]  # several if another kernel includes it
    turn, torque = np.repeat(random_moments(11, 5), 2, axis=1)[:, ::2]
    turn.flags.writeable = torque.flags.writeable = False
    for solve in (torsion, torsion_table, torsion_and_gradient, mesh_state):
        solve(ASTRAY, turn, torque)
    torsion_along(ASTRAY, turn, torque, 2)
    contact = contacts(ASTRAY, turn)
    torsion_of_flanks(contact.rotation[::2], flank_stiffness(contact, 1e-6)[::2], np.sort(torque))
    build(drives.mesh(drives.COARSE), 6.0)(turn, np.broadcast_to(0.5, 5))
    assert [len(found.signatures) for found in own] == before
    assert len(own) == 11
    assert all(before)


def test_a_cache_that_cannot_be_written_is_done_without(monkeypatch: pytest.MonkeyPatch) -> None:
    import numba

    njit = numba.njit

    def refuse(*, cache: bool = False, **options: bool) -> object:
        if cache:
            raise RuntimeError("cannot cache function: no locator available for file")
        return njit(**options)

    monkeypatch.setattr(numba, "njit", refuse)
    assert entry_point(lambda x: x + 1)(2) == 3


def test_machine_code_of_two_processes_shares_no_names() -> None:
    """A third process loads both: with a shared name it would run one's sort for the other's argsort."""
    code = """
import os, hd_diag.model.kernel.compiler, numba.core.bytecode as bytecode
if forked := os.fork():
    os.waitpid(forked, 0)
print(bytecode.FunctionIdentity.from_function(lambda: 0).unique_id, flush=True)
"""
    run = partial(subprocess.check_output, [sys.executable, "-c", code], text=True, timeout=60)
    assert len(set((run() + run()).split())) == 4

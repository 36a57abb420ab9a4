"""The compiled path gives the numbers of the numpy modules; finite differences confirm its derivatives."""

import dataclasses
import math
import subprocess
import sys
import warnings

import drives
import hypothesis
import hypothesis.strategies as st
import numpy as np
import pytest

from hd_diag.drive import Drive, mesh_state
from hd_diag.model import clearance, compiled, load_sharing, threads
from hd_diag.model.torsion import limited_curves
from hd_diag.model.torsion_map import TorsionMap, build
from hd_diag.model.transmission_error import Kinematics

needs_numba = pytest.mark.skipif(not compiled.available(), reason="numba is not installed")

COMPLIANCE = 1e-6
ROUNDING = 1e-14  # [rad]; differences seen are below 1e-15


def moments(seed, number):
    """Wave generator angles, eccentricities up to 40 um (some none at all) and torques (some zero)."""
    random = np.random.default_rng(seed)
    turn = random.uniform(-2 * np.pi, 2 * np.pi, number)
    eccentricity = random.uniform(0, 40e-6, number) * np.exp(1j * random.uniform(0, 2 * np.pi, number))
    torque = random.uniform(-100, 100, number)
    eccentricity[::5] = 0.0
    torque[::7] = 0.0
    return turn, eccentricity, torque


def curve(geometry, turn, eccentricity, arc_offset=0.0, compliance=COMPLIANCE):
    contact = clearance.contacts(geometry, turn, eccentricity, arc_offset)
    return load_sharing.torque_curve(contact.rotation, load_sharing.flank_stiffness(contact, compliance))


def numpy_torsion(geometry, compliance, turn, eccentricity, arc_offset, torque):
    torque = np.broadcast_to(torque, turn.shape)[:, None]
    return load_sharing.torsion(curve(geometry, turn, eccentricity, arc_offset, compliance), torque)[:, 0]


@needs_numba
@pytest.mark.parametrize("name", drives.DRIVES)
def test_torsion_is_that_of_the_numpy_modules(name):
    geometry = drives.geometry(drives.DRIVES[name])
    arguments = (geometry, COMPLIANCE, *moments(1, 300)[:2], 2e-5, moments(1, 300)[2])
    expected = numpy_torsion(*arguments)
    assert np.all(np.isfinite(expected))
    np.testing.assert_allclose(compiled.torsion(*arguments), expected, rtol=0, atol=ROUNDING)


@needs_numba
@pytest.mark.parametrize("farthest", [None, 60e-6])
@pytest.mark.parametrize("name", drives.DRIVES)
def test_contacts_are_those_of_the_numpy_modules(name, farthest):
    geometry = drives.geometry(drives.DRIVES[name])
    turn, eccentricity, _ = moments(2, 100)
    found = compiled.contacts(geometry, turn, eccentricity, -1e-5, farthest)
    expected = clearance.contacts(geometry, turn, eccentricity, -1e-5, farthest)
    np.testing.assert_array_equal(found.teeth, expected.teeth)
    np.testing.assert_array_equal(found.slots, expected.slots)
    np.testing.assert_allclose(found.rotation, expected.rotation, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(found.radius, expected.radius, rtol=1e-14)
    # Centres of conformal arcs are 0.03 mm apart, a thousandth of the radius whose rounding turns the normal.
    np.testing.assert_allclose(found.pressure_angle, expected.pressure_angle, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.position, expected.position, rtol=0, atol=ROUNDING)


@needs_numba
@pytest.mark.parametrize("name", drives.DRIVES)
def test_state_of_the_teeth_is_that_of_the_numpy_modules(name):
    """Runout too; some angles and torques that are no numbers."""
    mesh = drives.mesh(drives.DRIVES[name], (6e-6, -11e-6), (2e-6, 9e-6), arc_offset=-1e-5)
    ratio = mesh.geometry.reduction
    drive = Drive(mesh, Kinematics(ratio), 50.0)
    turn, _, torque = moments(12, 100)
    turn[3], torque[5] = math.nan, math.nan
    with np.errstate(invalid="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        found, expected = (way(mesh_state, drive, turn, torque) for way in (by_kernels, by_numpy))
    np.testing.assert_allclose(found.torsion, expected.torsion, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(found.backlash, expected.backlash, rtol=0, atol=ROUNDING * 0.05)
    stiffest = 0.05 / COMPLIANCE  # of a pair, force by angle [N/rad]
    np.testing.assert_allclose(found.load, expected.load, rtol=0, atol=2 * ROUNDING * stiffest)
    np.testing.assert_allclose(found.pressure_angle, expected.pressure_angle, rtol=0, atol=1e-12)
    rest = ~np.isnan(turn)
    np.testing.assert_allclose(found.lost_motion[rest], expected.lost_motion[rest], rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(found.overlap[rest], expected.overlap[rest], rtol=0, atol=ROUNDING * 0.05)
    assert np.isnan(found.backlash[3]).all()
    assert not found.load[[3, 5]].any()


@needs_numba
def test_state_of_one_moment_is_that_of_many_and_has_the_torsion_of_the_map():
    turn, eccentricity, torque = moments(13, 30)
    arguments = drives.geometry(), COMPLIANCE
    many = compiled.mesh_state(*arguments, turn, eccentricity, 0.0, torque)
    for i in range(turn.size):
        at = slice(i, i + 1)
        one = compiled.mesh_state(*arguments, turn[at], eccentricity[at], 0.0, torque[at])
        for values, value in zip(many, one, strict=True):
            np.testing.assert_array_equal(value[0], values[i])
    np.testing.assert_array_equal(many.torsion, compiled.torsion(*arguments, turn, eccentricity, 0.0, torque))


@needs_numba
@hypothesis.given(
    turn=st.floats(-100, 100),
    size=st.floats(0, 150e-6),
    direction=st.floats(-4, 4),
    torque=st.floats(-500, 500),
    arc_offset=st.floats(-1e-3, 1e-3),
    compliance=st.floats(1e-8, 1e-4),
)
def test_any_moment(turn, size, direction, torque, arc_offset, compliance):
    eccentricity = np.array([size * np.exp(1j * direction)])
    arguments = (
        drives.geometry(), compliance, np.array([turn]), eccentricity, arc_offset, np.array([torque])
    )  # fmt: skip
    expected = numpy_torsion(*arguments)
    np.testing.assert_allclose(compiled.torsion(*arguments), expected, rtol=1e-13, atol=10 * ROUNDING)


@needs_numba
@pytest.mark.parametrize("branch", [-1, 0, 1])
def test_table_is_one_torsion_per_torque(branch):
    geometry = drives.geometry()
    turn, eccentricity, _ = moments(3, 60)
    torque = np.sort(np.concatenate((np.random.default_rng(4).uniform(-300, 300, 50), [0.0, 0.0, 1e-9])))
    table = compiled.torsion_table(geometry, COMPLIANCE, turn, eccentricity, 0.0, torque, branch)
    expected = load_sharing.torsion(curve(geometry, turn, eccentricity), torque)
    rest = torque != 0.0
    np.testing.assert_allclose(table[:, rest], expected[:, rest], rtol=0, atol=ROUNDING)
    if branch == 0:
        np.testing.assert_allclose(table, expected, rtol=0, atol=ROUNDING)


@needs_numba
def test_branches_are_the_limits_at_zero_torque():
    geometry, torque = drives.geometry(), np.array([-1e-9, 0.0, 1e-9])
    turn, eccentricity = np.linspace(0, 6, 40), np.linspace(0, 30e-6, 40) * 1j
    gap = curve(geometry, turn, eccentricity).gap
    free = gap[:, 1] > gap[:, 0]
    assert free.any()
    assert not free.all()
    lower, upper = (
        compiled.torsion_table(geometry, COMPLIANCE, turn, eccentricity, 0.0, torque, branch)
        for branch in (-1, 1)
    )
    # One pair of this drive is never softer than 500 N m/rad.
    np.testing.assert_allclose(lower[:, 1], lower[:, 0], rtol=0, atol=1e-9 / 500)
    np.testing.assert_allclose(upper[:, 1], upper[:, 2], rtol=0, atol=1e-9 / 500)
    np.testing.assert_allclose((upper - lower)[:, 1], np.where(free, gap[:, 1] - gap[:, 0], 0), atol=ROUNDING)


@needs_numba
def test_table_refuses_torques_that_do_not_rise():
    for torque in ([1.0, 0.0], [0.0, math.nan]):
        with pytest.raises(ValueError, match="cup_torque must rise"):
            compiled.torsion_table(drives.geometry(), COMPLIANCE, np.zeros(1), 0j, 0.0, np.array(torque))


def by_numpy(function, *arguments):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiled, "available", lambda: False)
        return function(*arguments)


def by_kernels(function, *arguments):
    assert compiled.available()
    return function(*arguments)


@needs_numba
@pytest.mark.parametrize("name", drives.DRIVES)
def test_limited_curves_are_those_of_the_numpy_modules(name):
    """As curves: the numpy modules leave some points in between, in lines and in gaps."""
    mesh = drives.mesh(drives.DRIVES[name], (6e-6, -11e-6), (2e-6, 9e-6))
    turn, limit = moments(9, 60)[0], 80.0
    both = [np.stack(solve(limited_curves, mesh, turn, limit), axis=1) for solve in (by_numpy, by_kernels)]
    for expected, found in zip(*both, strict=True):
        assert found[0, 0] == -limit
        assert found[0, -1] == limit
        assert np.all(np.diff(found) >= 0)
        torque = np.concatenate((expected[0], found[0], [-1e-9, 1e-9]))
        torque = torque[torque != 0.0]  # where a gap's ends stand above each other
        np.testing.assert_allclose(
            np.interp(torque, *found), np.interp(torque, *expected), rtol=0, atol=ROUNDING
        )


@pytest.fixture(scope="module", params=["aligned", "astray"])
def table(request):
    """Maps with a true gap everywhere, and with preload over part of the turn."""
    astray = {"eccentricity": (4e-6, -13e-6), "runout": (2e-6, 1e-6)}
    mesh = drives.mesh(drives.COARSE, **(astray if request.param == "astray" else {}))
    return by_numpy(build, mesh, 8.0)


def places(table: TorsionMap):
    """Random places of a map, and all that could be told apart by a last bit."""
    random, n = np.random.default_rng(10), 100_000
    turn, torque = random.uniform(-50, 50, n), random.uniform(-1, 1, n) * table.torque_limit
    torque[: n // 10] = np.where(random.random(n // 10) < 0.5, 0.0, -0.0)
    steps, width = table.torque.shape[0] - 1, table.torque.shape[1]
    row = random.integers(0, steps, n // 10)
    turn[n // 5 : n // 5 + row.size] = 2 * np.pi / steps * row
    torque[n // 5 : n // 5 + row.size] = table.torque[row, random.integers(0, width, row.size)]
    turn[-1000:] = random.uniform(-1e9, 1e9, 1000)
    limit = table.torque_limit
    special = [0.0, -0.0, 1e-300, limit, -limit, np.nextafter(limit, 999), np.inf, -np.inf, np.nan]
    angles = [0.0, -0.0, -1e-20, 1e-300, 2 * np.pi, -2 * np.pi, np.nextafter(2 * np.pi, 0), np.nan]
    pairs = np.array(np.meshgrid(angles, special)).reshape(2, -1)
    return np.concatenate((turn, pairs[0])), np.concatenate((torque, pairs[1]))


@needs_numba
def test_map_gives_the_same_by_numpy_to_the_last_bit(table):
    turn, torque = places(table)
    expected, found = by_numpy(table, turn, torque), by_kernels(table, turn, torque)
    known = ~np.isnan(expected)
    assert 80_000 < known.sum() < turn.size
    np.testing.assert_array_equal(np.isnan(found), ~known)
    np.testing.assert_array_equal(found[known].view(np.int64), expected[known].view(np.int64))


@needs_numba
def test_map_gives_one_place_as_it_gives_many(table):
    turn, torque = (values[::97] for values in places(table))
    many = by_kernels(table, turn, torque)
    one = [by_kernels(table, turn[i : i + 1], torque[i : i + 1])[0] for i in range(turn.size)]
    np.testing.assert_array_equal(one, many)


@needs_numba
@pytest.mark.parametrize("rows", [2, 64, 65, 66, 150])
def test_map_of_few_rows_gives_the_same_by_numpy(table, rows):
    """Whole and broken numbers of rows of its index."""
    part = dataclasses.replace(table, torque=table.torque[:rows], torsion=table.torsion[:rows])
    turn, torque = (values[::20] for values in places(part))
    np.testing.assert_array_equal(by_kernels(part, turn, torque), by_numpy(part, turn, torque))


@needs_numba
def test_a_copy_of_a_map_answers_by_its_own_rows(table):
    turn, torque = (values[::97] for values in places(table))
    found = by_kernels(table, turn, torque)
    doubled = dataclasses.replace(table, torsion=2.0 * table.torsion)
    np.testing.assert_array_equal(by_kernels(doubled, turn, torque), 2.0 * found)


@needs_numba
@pytest.mark.parametrize("solve", ["torsion", "mesh_state", "interpolate"])
def test_several_threads_give_the_same_to_the_last_bit(table, solve, monkeypatch):
    turn, eccentricity, torque = moments(14, 1003)
    turn[3], torque[5] = math.nan, math.nan
    mesh = (drives.geometry(), COMPLIANCE, turn, eccentricity, 0.0, torque)
    ways = {
        "torsion": lambda: [compiled.torsion(*mesh)],
        "mesh_state": lambda: list(compiled.mesh_state(*mesh)),
        "interpolate": lambda: [table(*places(table))],
    }
    calls, kernel, found = [], getattr(compiled._kernel(), solve), []
    monkeypatch.setattr(compiled._kernel(), solve, lambda *rest: (calls.append(rest[-2:]), kernel(*rest)))
    for cores in (1, 3):
        monkeypatch.setattr(threads, "cores", lambda cores=cores: cores)
        calls.clear()
        found.append(ways[solve]())
        assert (len(calls) == 1) == (cores == 1)
    for one, three in zip(*found, strict=True):
        np.testing.assert_array_equal(three, one)


@needs_numba
def test_map_refuses_angles_and_torques_of_different_number(table):
    with pytest.raises(ValueError, match="3 wave generator angles, but 2 torques"):
        by_kernels(table, np.zeros(3), np.zeros(2))


@needs_numba
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_nan_where_no_flank_bears_the_torque(side):
    """Teeth that at times reach no slot: at zero torque, the gap then has no end on one side."""
    geometry, turn = drives.geometry(drives.shallow()), np.arange(40) * 2 * np.pi / 32 / 40
    contact = clearance.contacts(geometry, turn, 0j)
    lost = np.isnan(contact.rotation).all(axis=2)
    loaded, idle = lost[:, 0 if side > 0 else 1], lost.any(axis=1)
    assert 0 < loaded.sum() < idle.sum() < 40
    mesh = (geometry, COMPLIANCE, turn, 0j, 0.0)
    torque = np.sort([0.0, side, 2 * side])
    expected = np.where(torque == 0.0, idle[:, None], loaded[:, None])
    np.testing.assert_array_equal(np.isnan(compiled.torsion_table(*mesh, torque)), expected)
    for column, value in enumerate(torque):
        beta, _, gradient = compiled.torsion_and_gradient(*mesh, value)
        np.testing.assert_array_equal(np.isnan(beta), expected[:, column])
        np.testing.assert_array_equal(np.isnan(gradient[:, :3]).all(axis=1), expected[:, column])
    assert np.isfinite(compiled.limited_curves(*mesh, 1.0)[0]).all(axis=1).sum() == (~idle).sum()


@needs_numba
def test_kernels_are_compiled_once():
    """Warmed up for what comes: also for columns of other arrays and arrays that cannot be written to."""
    compiled.warm_up()
    geometry, table = drives.geometry(), by_numpy(build, drives.mesh(drives.COARSE), 6.0)
    turn, eccentricity, torque = (np.repeat(values, 2)[::2] for values in moments(11, 5))
    for values in (turn, eccentricity, torque):
        values.flags.writeable = False
    mesh = (geometry, COMPLIANCE, turn, eccentricity, 0.0)
    compiled.torsion(*mesh, torque)
    compiled.torsion_table(*mesh, np.sort(torque))
    compiled.limited_curves(*mesh, 40)
    compiled.contacts(geometry, turn, eccentricity)
    compiled.mesh_state(*mesh, torque)
    by_kernels(table, turn, np.broadcast_to(0.5, 5))
    kernels = compiled._kernel()
    for name in ("torsion", "torsion_table", "curves", "contacts", "mesh_state", "index", "interpolate"):
        assert len(getattr(kernels, name).signatures) == 1, name


@needs_numba
def test_numbers_that_are_not_spoil_their_own_moment_only():
    turn, eccentricity, torque = moments(5, 12)
    turn[2], eccentricity[4], eccentricity[5], torque[6] = math.nan, complex(0, math.nan), math.inf, math.nan
    spoilt = np.isin(np.arange(12), [2, 4, 5, 6])
    arguments = (drives.geometry(), COMPLIANCE, turn, eccentricity, 0.0, torque)
    beta, stiffness, gradient = compiled.torsion_and_gradient(*arguments)
    np.testing.assert_array_equal(np.isnan(compiled.torsion(*arguments)), spoilt)
    np.testing.assert_array_equal(np.isnan(beta), spoilt)
    np.testing.assert_array_equal(np.isnan(gradient[:, :3]).all(axis=1), spoilt)
    assert np.all(stiffness[~spoilt] >= 0.0)


@needs_numba
def test_one_moment_is_a_moment_of_many():
    geometry = drives.geometry()
    turn, eccentricity, torque = moments(6, 50)
    whole = compiled.torsion(geometry, COMPLIANCE, turn, eccentricity, 0.0, torque)
    single = [
        compiled.torsion(
            geometry, COMPLIANCE, turn[i : i + 1], eccentricity[i : i + 1], 0.0, torque[i : i + 1]
        )[0]
        for i in range(50)
    ]
    np.testing.assert_array_equal(whole, single)
    np.testing.assert_array_equal(
        compiled.torsion(geometry, COMPLIANCE, turn[::2], eccentricity[::2], 0.0, torque[::2]), whole[::2]
    )
    np.testing.assert_array_equal(
        compiled.torsion_and_gradient(geometry, COMPLIANCE, turn, eccentricity, 0.0, torque)[0], whole
    )


def along(mesh, place, torque, nodes=257):
    """Torsion and its derivatives by E_x, E_y, r_0 and M side by side, at places in numbers of nodes."""
    angle = np.linspace(0.0, 2.0 * np.pi, nodes)
    beta, gradient = compiled.torsion_along(
        mesh.geometry, mesh.tooth_compliance, angle, mesh.displacement(angle), mesh.arc_offset, place, torque
    )
    return np.column_stack((beta, gradient))


@needs_numba
@pytest.mark.parametrize("outward", [0.0, 30e-6], ids=["preload", "gap"])
def test_torsion_along_samples_is_exact_at_nodes_and_straight_between(outward):
    mesh = drives.mesh()
    datum = mesh.geometry.circular_spline_datum + outward
    geometry = dataclasses.replace(mesh.geometry, circular_spline_datum=datum)
    mesh = dataclasses.replace(mesh, geometry=geometry, eccentricity=9e-6 - 7e-6j, runout=3e-6 + 1e-6j)
    random = np.random.default_rng(8)
    node, torque = random.integers(0, 256, 400), random.uniform(-90.0, 90.0, 400)
    angle = 2.0 * np.pi / 256 * node
    pose = (geometry, mesh.tooth_compliance, angle, mesh.displacement(angle), mesh.arc_offset)
    beta, _, gradient = compiled.torsion_and_gradient(*pose, torque)
    at_node, half = along(mesh, 1.0 * node, torque), along(mesh, node + 0.5, torque)
    expected = np.column_stack((beta, gradient[:, [0, 1, 2, 5]]))
    rounding = 1e-12 * np.abs(expected).max(axis=0)
    assert np.all(np.abs(at_node - expected) < rounding)
    assert np.all(np.abs(half - 0.5 * (at_node + along(mesh, node + 1.0, torque))) < rounding)
    order = random.permutation(400)
    np.testing.assert_array_equal(along(mesh, node[order] + 0.5, torque[order]), half[order])
    idle, _, gradient = compiled.torsion_and_gradient(*pose, 0.0)
    at_node = along(mesh, 1.0 * node, np.zeros(400))
    np.testing.assert_allclose(at_node[:, 0], idle, rtol=0, atol=ROUNDING)
    if outward:
        assert np.all(np.abs(at_node[:, 1:4] - gradient[:, :3]) < rounding[1:4])


@needs_numba
def test_torsion_along_samples_is_nan_where_no_flank_bears_the_torque():
    mesh = drives.mesh(drives.shallow())
    lost = np.isnan(along(mesh, np.arange(256.0), np.full(256, 1e-3)))
    assert 0 < lost[:, 0].sum() < 256
    np.testing.assert_array_equal(lost.any(axis=1), lost[:, 0])


STEPS = {
    "eccentricity.x": 1e-9,
    "eccentricity.y": 1e-9,
    "circular_spline_datum": 1e-9,
    "tooth_compliance": 1e-10,
    "arc_offset": 1e-9,
    "torque": 1e-3,
    "wave_generator_angle": 1e-7,
}


def shifted(geometry, turn, eccentricity, torque, name, step):
    """Torsion by the numpy modules with one parameter moved."""
    move = {name: step}
    datum = geometry.circular_spline_datum + move.get("circular_spline_datum", 0.0)
    if name == "circular_spline_datum":
        geometry = dataclasses.replace(geometry, circular_spline_datum=datum)
    return numpy_torsion(
        geometry,
        COMPLIANCE + move.get("tooth_compliance", 0.0),
        turn + move.get("wave_generator_angle", 0.0),
        eccentricity + complex(move.get("eccentricity.x", 0.0), move.get("eccentricity.y", 0.0)),
        move.get("arc_offset", 0.0),
        torque + move.get("torque", 0.0),
    )


@needs_numba
@pytest.mark.parametrize("loaded", [True, False])
@pytest.mark.parametrize("name", compiled.PARAMETERS)
def test_gradient_is_that_of_finite_differences(name, loaded):
    """Also at zero torque, preloaded or in a gap; eccentric, so that no two flanks bound the gap together."""
    geometry = drives.geometry()
    turn, eccentricity, torque = moments(7, 300)
    eccentric = eccentricity != 0.0
    turn, eccentricity, torque = turn[eccentric], eccentricity[eccentric], torque[eccentric]
    torque = torque if loaded else np.zeros_like(torque)
    _, stiffness, gradient = compiled.torsion_and_gradient(
        geometry, COMPLIANCE, turn, eccentricity, 0.0, torque
    )
    at = (torque != 0.0) == loaded
    if name == "torque" and not loaded:
        at &= stiffness > 0.0
    step = STEPS[name]
    above = shifted(geometry, turn, eccentricity, torque, name, step)[at]
    below = shifted(geometry, turn, eccentricity, torque, name, -step)[at]
    expected = (above - below) / (2 * step)
    error = np.abs(gradient[at, compiled.PARAMETERS.index(name)] - expected)
    scale = np.sqrt(np.mean(expected**2))
    # Where a flank begins to bear within the step, beta has a kink and no derivative: at few moments.
    assert np.quantile(error, 0.98) <= 1e-7 * scale + 1e-15 / step


@needs_numba
def test_stiffness_is_that_of_the_load_distribution():
    geometry = drives.geometry()
    turn, eccentricity, torque = moments(8, 100)
    _, stiffness, gradient = compiled.torsion_and_gradient(
        geometry, COMPLIANCE, turn, eccentricity, 0.0, torque
    )
    contact = clearance.contacts(geometry, turn, eccentricity)
    expected = load_sharing.share_load(contact, COMPLIANCE, torque)
    # In a gap no flank bears, or the first one just not.
    in_gap = (torque == 0.0) & (expected.lost_motion > 0.0)
    assert in_gap.any()
    np.testing.assert_allclose(stiffness[~in_gap], expected.stiffness[~in_gap], rtol=1e-12)
    np.testing.assert_array_equal(stiffness[in_gap], 0.0)
    np.testing.assert_array_equal(gradient[in_gap, compiled.PARAMETERS.index("torque")], math.inf)


@needs_numba
def test_a_cache_that_cannot_be_written_is_done_without(monkeypatch):
    import numba

    from hd_diag.model import kernel

    njit = numba.njit

    def refuse(*, cache=False, **options):
        if cache:
            raise RuntimeError("cannot cache function: no locator available for file")
        return njit(**options)

    monkeypatch.setattr(numba, "njit", refuse)
    assert kernel.entry_point(lambda x: x + 1)(2) == 3


def run(code):
    return subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True, timeout=120
    ).stdout.strip()


def test_numba_is_imported_only_when_asked_for():
    code = "import sys; from hd_diag.model import compiled; print('numba' in sys.modules)"
    assert run(code) == "False"


def test_without_numba_the_path_is_not_available():
    code = (
        "import sys; sys.modules['numba'] = None;"
        "from hd_diag.model import compiled; compiled.warm_up(); print(compiled.available())"
    )
    assert run(code) == "False"

"""Tabulated torsion against the exact solution."""

import threading
from typing import Any

import drives
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from reference import polyline

from hd_diag.model.mesh import Mesh
from hd_diag.model.torsion import torsion, torsion_table
from hd_diag.model.torsion_map import TOLERANCE, BuildCancelled, TorsionMap, build

Array = polyline.Array


@pytest.fixture(scope="module")
def astray() -> TorsionMap:
    return build(drives.mesh(eccentricity=(4e-6, -13e-6), runout=(2e-6, 1e-6), arc_offset=3e-6), 112.0)


@pytest.fixture(scope="module")
def gap(paper_mesh: Mesh) -> TorsionMap:
    return build(paper_mesh, 60.0)


@pytest.fixture(params=["astray", "gap"])
def table(request: pytest.FixtureRequest) -> TorsionMap:
    return request.getfixturevalue(request.param)  # type: ignore[no-any-return]


def points(table: TorsionMap, count: int, seed: int) -> tuple[Array, Array]:
    generator = np.random.default_rng(seed)
    angle = generator.uniform(-30, 30, count)
    return angle, generator.uniform(-1, 1, count) ** 3 * table.torque_limit


def test_error_is_bounded(table: TorsionMap) -> None:
    angle, torque = points(table, 2000, 1)[0], np.append(points(table, 24, 2)[1], 0.0)
    found = table(np.repeat(angle, torque.size), np.tile(torque, angle.size))
    error = np.abs(found - torsion_table(table.mesh, angle, torque).reshape(-1))
    assert error.max() <= table.error_bound
    assert error.max() > 0.2 * table.error_bound  # the bound is not too wide
    assert table.error_bound <= 4 * TOLERANCE
    limit = table.torque_limit
    angle = np.array([0.0, -0.0, -1e-20, 1e-300, 2 * np.pi, -2 * np.pi, np.nextafter(2 * np.pi, 0), 1e6])
    for torque in np.array([0.0, -0.0, 1e-300, -1e-300, limit, -limit])[:, None] + 0.0 * angle:
        assert np.abs(table(angle, torque) - torsion(table.mesh, angle, torque)).max() <= table.error_bound


def test_bound_holds_in_the_middle_of_the_gap() -> None:
    """With so few teeth the coarse map meets its tolerance at no other torque."""
    table = build(drives.mesh(drives.COARSE), 6.0)
    angle, idle = np.linspace(-30, 30, 500), np.zeros(500)
    assert np.abs(table(angle, idle) - torsion(table.mesh, angle, idle)).max() <= table.error_bound
    assert_array_equal(table(angle, -idle), table(angle, idle))


def test_ends_below_the_torque_at_which_torsion_jumps(astray: TorsionMap, gap: TorsionMap) -> None:
    """Above about 75 N m pairs engage by their tip corners, and torsion is discontinuous in the angle."""
    assert gap.torque_limit == gap.requested_limit == 60
    assert astray.requested_limit == 112
    assert 60 < astray.torque_limit < 90
    angle = np.linspace(0, 2 * np.pi / 202, 1001)
    for torque, jumps in ((0.9 * astray.torque_limit, False), (112.0, True)):
        step = np.abs(np.diff(torsion(astray.mesh, angle, np.full(angle.size, torque))))
        assert (step.max() > 20 * np.median(step)) == jumps


def test_exact_at_its_own_angles(table: TorsionMap) -> None:
    steps = table.repeats * (table.torque.shape[0] - 1)
    # Half a step of torsion [rad], and the same again for a breakpoint moved by half a step.
    single = float(table.lines[:, 2].max())
    assert single < 0.3 * TOLERANCE
    angle = 2 * np.pi / steps * np.arange(0, steps, 97)
    for torque in (-0.9 * table.torque_limit, -0.01, 0.3, table.torque_limit):
        load = np.full(angle.size, torque)
        assert_allclose(table(angle, load), torsion(table.mesh, angle, load), rtol=0, atol=single)


def test_one_at_a_time_equals_a_thousand_to_the_last_bit(table: TorsionMap) -> None:
    angle, torque = points(table, 1000, 2)
    torque[::10] = 0.0
    torque[5::50] = 2 * table.torque_limit
    together = table(angle, torque)
    alone = [table(angle[k : k + 1], torque[k : k + 1])[0] for k in range(angle.size)]
    assert_array_equal(alone, together)
    assert_array_equal(table(angle[::-1], torque[::-1])[::-1], together)


@pytest.mark.filterwarnings("error")
def test_nan_beyond_the_limit(table: TorsionMap) -> None:
    limit = table.torque_limit
    torque = np.array([limit, -limit, np.nextafter(limit, 999), -np.nextafter(limit, 999), np.nan, np.inf])
    assert_array_equal(np.isnan(table(np.zeros(6), torque)), [False, False, True, True, True, True])
    with pytest.raises(ValueError, match="3 wave generator angles, but 2 torques"):
        table(np.zeros(3), np.zeros(2))


@pytest.mark.parametrize("several", [1, 2])
def test_can_be_given_up(several: int) -> None:
    asked: list[float] = []

    def wanted(fraction: float) -> bool:
        asked.append(fraction)
        return len(asked) < 4

    with pytest.raises(BuildCancelled):
        build(drives.mesh(drives.COARSE, arc_offset=1e-6), 6.0, wanted, threads=several)
    assert (len(asked), asked[0]) == (4, 0.0)
    assert np.all(np.diff([*asked, 1.0]) > 0)
    assert not any(thread.name.startswith("torsion map") for thread in threading.enumerate())


@pytest.mark.parametrize(
    ("displaced", "repeats"),
    [
        ({}, 202),
        ({"runout": (3e-6, 8e-6)}, 202),
        ({"eccentricity": (4e-6, -7e-6)}, 2),
        ({"eccentricity": (4e-6, -7e-6), "runout": (3e-6, 8e-6)}, 1),
        ({"arc_offset": 3e-6}, 1),
    ],
)
def test_what_repeats_within_a_turn_is_kept_once(displaced: dict[str, Any], repeats: int) -> None:
    table = build(drives.mesh(**displaced), 20.0)
    assert table.repeats == repeats
    assert table.torque.shape[0] - 1 == 202 * 64 / repeats
    assert table.error_bound <= 4 * TOLERANCE
    angle, torque = points(table, 2000, 5)
    assert np.abs(table(angle, torque) - torsion(table.mesh, angle, torque)).max() <= table.error_bound


@pytest.mark.parametrize("drive", ["100/102", "160/162", "320/322"])
def test_size_follows_the_error(drive: str) -> None:
    """At any ratio a turn takes about the same memory for the error aimed at."""
    displaced = {"eccentricity": (4e-6, -7e-6), "runout": (3e-6, 1e-6)}
    table = build(drives.mesh(drives.DRIVES[drive], **displaced), 20.0)
    assert 4e6 < table.torque.nbytes + table.torsion.nbytes < 8e6
    angle, torque = points(table, 500, 6)
    error = np.abs(table(angle, torque) - torsion(table.mesh, angle, torque))
    assert error.max() <= min(table.error_bound, TOLERANCE)


def test_several_threads_build_the_same_map() -> None:
    mesh = drives.mesh(drives.COARSE, eccentricity=(4e-6, -13e-6))
    one, three = build(mesh, 6.0), build(mesh, 6.0, threads=3)
    for name in ("torque", "torsion", "lines", "torque_limit", "error_bound"):
        assert_array_equal(getattr(one, name), getattr(three, name))


def test_refuses_what_the_teeth_cannot_bear() -> None:
    """Between two engagements no tooth reaches the slots."""
    with pytest.raises(ValueError, match=r"the teeth cannot bear 1 N m at every wave generator angle"):
        build(drives.mesh(drives.shallow()), 1.0)

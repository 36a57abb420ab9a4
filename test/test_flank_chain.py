"""User-defined flanks: chains against the double arc, an involute's closed form and brute force."""

import dataclasses
import math
import runpy
from pathlib import Path

import numpy as np
import pytest
from drives import double_arc, geometry
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from reference import polyline

from hd_diag.config.configuration import dump, resolve
from hd_diag.config.configured_drive import geometry_parameters
from hd_diag.config.parameters import ConfigError
from hd_diag.model.contact import contacts
from hd_diag.model.flank_chain import TOLERANCE, FlankChain, chain_of_points, chained
from hd_diag.model.geometry import Geometry
from hd_diag.model.load_sharing import mesh_state
from hd_diag.model.mesh import Mesh
from hd_diag.model.torsion import torsion

TOOTH, SLOT = double_arc(polyline.DEFAULT.tooth), double_arc(polyline.DEFAULT.slot)
SCRIPT = Path(__file__).resolve().parent.parent / "docs/examples/involute_flanks.py"
EXAMPLE = runpy.run_path(str(SCRIPT))
TURNS = np.array([0.0, 0.31, 1.7, 4.4])


def involute(heights: np.ndarray) -> np.ndarray:
    return np.asarray(EXAMPLE["involute"](0.15e-3, EXAMPLE["LONG_AXIS"], heights))


def with_chains(plain: Geometry, tooth: bool, slot: bool) -> Geometry:
    changes: dict[str, FlankChain] = {}
    if tooth:
        ends = plain.flexspline_root, plain.flexspline_tip
        changes["flexspline_tooth"] = chained(TOOTH, *ends)
    if slot:
        low = plain.circular_spline_tip_radius - plain.circular_spline_datum
        changes["circular_spline_slot"] = chained(SLOT, 0.99 * low, plain.slot_end)
    return dataclasses.replace(plain, **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize(("tooth", "slot"), [(True, True), (True, False), (False, True)])
@pytest.mark.parametrize("eccentricity", [0.0, 10e-6 + 20e-6j])
def test_two_arcs_as_a_chain_are_the_double_arc(tooth: bool, slot: bool, eccentricity: complex) -> None:
    plain = Mesh(geometry(), eccentricity=eccentricity)
    mesh = Mesh(with_chains(geometry(), tooth, slot), eccentricity=eccentricity)
    torque = np.array([1.0, -14.0, 56.0, -100.0])
    assert_allclose(torsion(mesh, TURNS, torque), torsion(plain, TURNS, torque), rtol=1e-9)
    for compiled in (False, True):
        one, other = contacts(mesh, TURNS, compiled), contacts(plain, TURNS, compiled)
        for name in ("rotation", "radius", "pressure_angle", "opening", "softening"):
            assert_allclose(getattr(one, name), getattr(other, name), rtol=1e-7, atol=1e-12)


def flat(heights: np.ndarray, half_widths: np.ndarray) -> tuple[float, ...]:
    return tuple(np.stack((heights, half_widths), axis=1).ravel().tolist())


@pytest.mark.parametrize("noise", [0.0, 15e-9])
def test_a_chain_follows_the_points_of_an_involute(noise: float) -> None:
    known = np.linspace(0.4e-3, 0.85e-3, 80)
    measured = involute(known) + noise * np.random.default_rng(0).standard_normal(80)
    chain = chain_of_points(flat(known, measured))
    assert len(chain.pieces) <= 6
    heights = np.linspace(0.401e-3, 0.849e-3, 997)
    exact = involute(heights)
    assert np.abs([chain.half_width(x) for x in heights] - exact).max() < TOLERANCE
    fine = chain_of_points(flat(known, involute(known)), 1e-9)
    assert np.abs([fine.half_width(x) for x in heights] - exact).max() < 2e-9


@settings(max_examples=25)
@given(
    waves=st.lists(st.floats(-4e-6, 4e-6), min_size=1, max_size=4),
    slope=st.floats(-0.6, -0.1),
    count=st.integers(12, 120),
)
def test_a_chain_stays_near_the_points(waves: list[float], slope: float, count: int) -> None:
    x = np.linspace(0.0, 0.5e-3, count)
    y = 0.3e-3 + slope * x + sum(a * np.cos(k * math.pi * x / 0.5e-3) for k, a in enumerate(waves, 1))
    chain = chain_of_points(flat(x, y))
    inside = (x >= chain.start) & (x <= chain.end)
    away = [chain.half_width(one) for one in x[inside]] - y[inside]
    assert np.abs(away / np.hypot(1.0, np.gradient(y, x)[inside])).max() <= 1.01 * TOLERANCE
    assert len(chain.pieces) <= 2 * (count - 1)


@pytest.mark.parametrize(
    ("numbers", "text"),
    [
        ((0.0, 0.0), "5, 8, 11"),
        ((0.0, 1.0, 0.0, 0.0, 0.5), "turns back at x = 0"),
        ((0.0, 1.0, 0.0, 1.0, 0.5, 0.0, 2.0, 0.5), "corner at x = 1"),
        ((0.0, 1.0, 0.1, 1.0, 0.5), "too small for its ends"),
        ((0.0, math.nan, 0.0, 1.0, 0.5), "finite"),
    ],
)
def test_what_makes_no_chain_is_refused(numbers: tuple[float, ...], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        _ = FlankChain(numbers).pieces


def test_points_that_are_no_flank_are_refused() -> None:
    for points in ((0.0, 1.0, 1.0, 0.5), (0.0, 1.0, 2.0, 0.5, 1.0, 0.2, 3.0, 0.1), (0.0,) * 9):
        with pytest.raises(ValueError, match="point"):
            chain_of_points(points)


@pytest.mark.parametrize("displaced", [0.0, 10e-6])
def test_involute_flanks_bear_as_a_brute_force_has_them(displaced: float) -> None:
    flanks = EXAMPLE["flanks"]()
    given = {f"joint_1.{name}": value for name, value in flanks.items()}
    mesh = dataclasses.replace(resolve(given).joints[0].drive.mesh, eccentricity=1j * displaced)
    tooth, slot = (polyline.Outline(tuple(each)) for each in EXAMPLE["flanks"](400).values())
    drive = dataclasses.replace(polyline.DEFAULT, tooth=tooth, slot=slot)
    for turn in (0.0, 0.8):
        brute = polyline.mesh(turn, (0.0, displaced), drive=drive)
        state = mesh_state(mesh, np.array([turn]), 20.0)
        known = np.isfinite(state.backlash[0]) & np.isfinite(brute.backlash)
        assert np.count_nonzero(known) > 100
        assert np.abs(state.backlash[0] - brute.backlash)[known].max() < 0.25e-6
        for torque in (2.0, 20.0, -56.0):
            expected = polyline.torsion(brute, torque, drive)
            assert torsion(mesh, np.array([turn]), torque)[0] == pytest.approx(expected, rel=2e-3)


def test_a_geometry_with_chains_is_written_as_it_is_read() -> None:
    given = {f"joint_1.{name}": value for name, value in EXAMPLE["flanks"]().items()}
    read = resolve(given).joints[0].drive.mesh.geometry
    again = resolve({f"joint_1.{name}": value for name, value in geometry_parameters(read).items()})
    assert again.joints[0].drive.mesh.geometry == read
    assert "flexspline_tooth" in dump(again)


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("flexspline_tooth.points", [0.0, 1e-3, 1e-3], "flexspline_tooth: a flank needs at least 4 points"),
        ("circular_spline_slot.chain", [0.0, 1e-3, 1e-3], "circular_spline_slot: a chain takes x, y"),
        ("flexspline_tooth.chain", [0.5e-3, 2e-4, 0.0, 0.8e-3, 1e-4], "the chain runs from 0.0005 to 0.0008"),
    ],
)
def test_a_flank_that_is_none_is_refused_by_its_name(name: str, value: list[float], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        resolve({f"joint_1.{name}": value})

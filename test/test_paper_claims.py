"""The claims of the paper as numbers, and a catalogue gear's stiffness.

Dong, Chen, Wang, Dong, "Kinematic Model of Harmonic Drive in Robot Joints with Input Eccentricity Error",
ROMANSY 22, 2019, doi 10.1007/978-3-319-78963-7_18, sections 4.2, 4.3 and 5. The eccentricity stands across
the long axis and tooth 0 is held on the axis (eq. 1); "right" is the half of the engagement region to which
the eccentricity points, counter-clockwise of tooth 0. A tooth's backlash is the lesser of its flanks.
"""

import dataclasses

import drives
import numpy as np
import pytest
from numpy.testing import assert_allclose
from reference import polyline, published
from scipy.optimize import brentq

from hd_diag.drive import Drive, MeshState, mesh_state
from hd_diag.model.mesh import Mesh
from hd_diag.model.neutral_curve import tooth_axes
from hd_diag.model.torsion import torsion
from hd_diag.model.transmission_error import Kinematics

Array = polyline.Array
GROWING = np.linspace(0.0, published.ECCENTRICITY, 6)  # [m]
RATED = published.RATED_TORQUE


def state(mesh: Mesh, torque: float, angles: Array) -> MeshState:
    """State at wave generator angles [rad] and a torque on the cup [N m]."""
    return mesh_state(Drive(mesh, Kinematics(-100.0), RATED), angles, np.full(angles.size, torque))


def anchored(eccentricity: float, datum: float = published.DATUM_OF_INTERFERENCE) -> Mesh:
    """The paper's own arrangement at its initial moment."""
    moment = published.anchored(eccentricity)
    drive = dataclasses.replace(drives.PAPER, circular_spline_datum=datum)
    return drives.mesh(drive, moment.eccentricity, arc_offset=moment.arc_offset)


def backlash(mesh: Mesh) -> Array:
    """Lesser of both flanks of all teeth at the initial moment [m]."""
    return np.asarray(np.fmin(*state(mesh, 0.0, np.zeros(1)).backlash[0]))


# (a) Motion of the neutral layer ---


def radial_displacement(mesh: Mesh, from_long_axis: Array) -> tuple[Array, Array]:
    """Displacement of points of the neutral layer off the circle [m], their directions in the housing [rad].

    Shape (turns, points): every point is looked at while it stands at the same places on the wave generator.
    """
    turned = 2 * np.pi * np.arange(36)[:, None] / 36
    angle, height, offset = tooth_axes(mesh.geometry.curve, from_long_axis)
    point = (height + 1j * offset) * np.exp(1j * (angle + turned)) + mesh.displacement(turned)
    return np.abs(point) - mesh.geometry.curve.radius, np.angle(point)


def test_points_of_the_neutral_layer_no_longer_share_one_motion() -> None:
    place = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    shared, _ = radial_displacement(drives.mesh(), place)
    assert np.ptp(shared, axis=0).max() < 1e-15
    for eccentricity in GROWING[1:]:
        apart, _ = radial_displacement(drives.mesh(eccentricity=(0.0, eccentricity)), place)
        assert_allclose(np.ptp(apart, axis=0), 2 * eccentricity, rtol=0.01)


def test_the_change_is_greatest_where_deformation_and_eccentricity_are_aligned() -> None:
    place = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    shared, _ = radial_displacement(drives.mesh(), place)
    found, direction = radial_displacement(drives.mesh(eccentricity=(0.0, published.ECCENTRICITY)), place)
    change = found - shared
    greatest, least = direction.flat[np.argmax(change)], direction.flat[np.argmin(change)]
    assert_allclose([greatest, least], [np.pi / 2, -np.pi / 2], atol=0.01)
    assert_allclose([change.max(), change.min()], np.array([1, -1]) * published.ECCENTRICITY, rtol=1e-3)
    assert np.abs(change[np.abs(np.cos(direction)) > 0.999]).max() < 0.05 * published.ECCENTRICITY


# (b) Backlash distribution ---

# Nearer to the long axis the other flank is the lesser one and the change is below 0.5 um.
RIGHT = np.arange(7, 25)
LEFT = 200 - RIGHT


def test_backlash_is_symmetric_without_eccentricity() -> None:
    found = backlash(anchored(0.0))
    assert_allclose(found[LEFT], found[RIGHT], rtol=0, atol=1e-13)


def test_backlash_grows_on_the_left_and_shrinks_on_the_right() -> None:
    steps = np.diff([backlash(anchored(eccentricity)) for eccentricity in GROWING], axis=0)
    assert np.all(steps[:, LEFT] > 0)
    assert np.all(steps[:, RIGHT] < 0)
    near_axis = steps.sum(axis=0)[np.r_[0:7, 194:200]]
    assert np.abs(near_axis).max() < 0.7e-6


# (c) Interference ---


def first_interference(datum: float) -> float:
    """Eccentricity at which the first tooth of the engagement region has no backlash left [m]."""
    engaged = np.array(published.ENGAGEMENT_TEETH)
    return float(
        brentq(lambda e: np.nanmin(backlash(anchored(e, datum))[engaged]), 0.0, 40e-6, xtol=1e-12, rtol=1e-12)
    )


def test_interference_first_appears_at_23_um() -> None:
    eccentricity = first_interference(published.DATUM_OF_INTERFERENCE)
    assert_allclose(eccentricity, published.ECCENTRICITY, atol=0.05e-6)
    engaged = np.array(published.ENGAGEMENT_TEETH)
    found = state(anchored(eccentricity), 0.0, np.zeros(1)).backlash[0][:, engaged]
    flank, tooth = np.unravel_index(np.nanargmin(found), found.shape)
    assert (flank, engaged[tooth]) == (0, published.FIRST_TO_INTERFERE)


def test_interference_with_the_datum_rounded_to_a_micrometre() -> None:
    found = first_interference(drives.PAPER.circular_spline_datum)
    assert_allclose(found, published.ECCENTRICITY_AT_ROUNDED_DATUM, atol=0.01e-6)


# (d) Load distribution ---


def test_fewer_pairs_bear_more_as_eccentricity_grows() -> None:
    states = [state(anchored(eccentricity), RATED, np.zeros(1)) for eccentricity in GROWING]
    loaded = np.array([found.loaded_pairs[0] for found in states])
    peak = np.array([found.peak_load[0] for found in states])
    assert np.all(np.diff(loaded) <= 0)
    assert (loaded[0], loaded[-1]) == (70, 64)
    assert np.all(np.diff(peak) > 3)
    assert_allclose(peak[[0, -1]], [39.8, 60.1], atol=0.05)


def test_load_concentrates_towards_the_eccentricity() -> None:
    direction = 2 * np.pi * np.arange(200) / 200
    lever = []
    for eccentricity in GROWING:
        load = state(anchored(eccentricity), RATED, np.zeros(1)).load[0].sum(axis=0)
        lever.append((load * np.sin(direction)).sum() / load.sum())
    assert_allclose(lever[0], 0, atol=1e-12)
    assert np.all(np.diff(lever) > 0.04)
    assert lever[-1] > 0.2


# (e) One tooth over time ---

PASSAGE = np.arange(*published.PASSAGE, 0.002)


def passage(eccentricity: float) -> tuple[float, float]:
    """Least backlash [m] and largest force [N] of tooth 0 while a lobe passes it, eccentricity along it."""
    found = state(drives.mesh(eccentricity=(eccentricity, 0.0)), RATED, PASSAGE)
    return float(np.nanmin(found.backlash[:, :, 0])), float(found.load[:, :, 0].max())


@pytest.mark.parametrize("turn", published.TURNS)
def test_published_passages_of_one_tooth(turn: published.Turn) -> None:
    least, largest = passage(turn.eccentricity)
    assert_allclose(least, turn.least_backlash, atol=0.01e-6)
    assert_allclose(largest, turn.largest_force, atol=0.05)


def test_away_from_the_eccentricity_backlash_grows_and_load_falls() -> None:
    least, largest = np.transpose([passage(-eccentricity) for eccentricity in GROWING])
    assert np.all(np.diff(least) > 1.5e-6)
    assert np.all(np.diff(largest) < -1)
    assert_allclose(least[[0, -1]], [0.9e-6, 9.6e-6], atol=0.05e-6)
    assert_allclose(largest[[0, -1]], [39.8, 31.0], atol=0.05)


# (f) Assembly tolerance ---

TURN = np.linspace(0, np.pi, 101)  # a static eccentricity repeats every half turn


def worst(eccentricity: float) -> tuple[float, float]:
    """Greatest overlap at zero torque [m] and greatest force at the rated torque [N] over a turn."""
    mesh = drives.mesh(eccentricity=(eccentricity, 0.0))
    return float(state(mesh, 0.0, TURN).overlap.max()), float(state(mesh, RATED, TURN).peak_load.max())


def test_overlap_and_peak_load_rise_with_eccentricity() -> None:
    overlap, peak = np.transpose([worst(eccentricity) for eccentricity in GROWING])
    assert np.all(np.diff(overlap) > 0)
    assert np.all(np.diff(peak) > 0)


@pytest.mark.parametrize(
    ("quantity", "limit", "expected"),
    [(0, 0.0, 0.89e-6), (1, 50.0, 10.7e-6)],
    ids=["the lobes just clear of each other", "50 N on a tooth"],
)
def test_a_largest_eccentricity_follows_from_a_limit(quantity: int, limit: float, expected: float) -> None:
    largest = brentq(lambda e: worst(e)[quantity] - limit, 0.0, published.ECCENTRICITY, xtol=1e-9)
    assert_allclose(largest, expected, atol=0.06e-6)
    assert worst(largest - 0.1e-6)[quantity] < limit < worst(largest + 0.1e-6)[quantity]


# Catalogue ---


def test_stiffness_is_a_catalogue_gear_s(paper_mesh: Mesh) -> None:
    for (low, high), k in zip(
        published.SECANT_STIFFNESS, (published.K1, published.K2, published.K3), strict=True
    ):
        beta = torsion(paper_mesh, np.zeros(2), np.array([low, high]))
        stiffness = (high - low) / (beta[1] - beta[0])
        assert_allclose(stiffness, published.SECANT_STIFFNESS[low, high], atol=0.05e4)
        assert_allclose(stiffness, k, rtol=0.08)

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

from hd_diag.model.load_sharing import MeshState, mesh_state
from hd_diag.model.mesh import Mesh
from hd_diag.model.neutral_curve import tooth_axes

Array = polyline.Array
GROWING = np.linspace(0.0, published.ECCENTRICITY, 6)  # [m]
ENGAGED = np.array(published.ENGAGEMENT_TEETH)
RATED = published.RATED_TORQUE


def state(mesh: Mesh, torque: float, angles: Array) -> MeshState:
    """State at wave generator angles [rad] and a torque on the cup [N m]."""
    return mesh_state(mesh, angles, np.full(angles.size, torque))


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
    # The change is greatest where deformation and eccentricity are aligned.
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


def test_backlash_is_symmetric_and_with_eccentricity_grows_on_the_left_and_shrinks_on_the_right() -> None:
    found = [backlash(anchored(eccentricity)) for eccentricity in GROWING]
    assert_allclose(found[0][LEFT], found[0][RIGHT], rtol=0, atol=1e-13)
    steps = np.diff(found, axis=0)
    assert np.all(steps[:, LEFT] > 0)
    assert np.all(steps[:, RIGHT] < 0)
    near_axis = steps.sum(axis=0)[np.r_[0:7, 194:200]]
    assert np.abs(near_axis).max() < 0.7e-6


# (c) Interference ---


def first_interference(datum: float) -> float:
    """Eccentricity at which the first tooth of the engagement region has no backlash left [m]."""

    def least(eccentricity: float) -> float:
        return float(np.nanmin(backlash(anchored(eccentricity, datum))[ENGAGED]))

    return float(brentq(least, 0.0, 40e-6, xtol=1e-12, rtol=1e-12))


def test_interference_first_appears_at_23_um() -> None:
    eccentricity = first_interference(published.DATUM_OF_INTERFERENCE)
    assert_allclose(eccentricity, published.ECCENTRICITY, atol=0.05e-6)
    found = state(anchored(eccentricity), 0.0, np.zeros(1)).backlash[0][:, ENGAGED]
    flank, tooth = np.unravel_index(np.nanargmin(found), found.shape)
    assert (flank, ENGAGED[tooth]) == (0, published.FIRST_TO_INTERFERE)
    rounded = first_interference(drives.PAPER.circular_spline_datum)
    assert_allclose(rounded, published.ECCENTRICITY_AT_ROUNDED_DATUM, atol=0.01e-6)


# (d) Load distribution ---


def test_fewer_pairs_bear_more_as_eccentricity_grows() -> None:
    states = [state(anchored(eccentricity), RATED, np.zeros(1)) for eccentricity in GROWING]
    loaded = np.array([found.loaded_pairs[0] for found in states])
    peak = np.array([found.peak_load[0] for found in states])
    assert np.all(np.diff(loaded) <= 0)
    assert (loaded[0], loaded[-1]) == (70, 64)
    assert np.all(np.diff(peak) > 3)
    assert_allclose(peak[[0, -1]], [39.8, 60.1], atol=0.05)
    # The load concentrates towards the eccentricity.
    loads = np.array([found.load[0].sum(axis=0) for found in states])
    lever = loads @ np.sin(2 * np.pi * np.arange(200) / 200) / loads.sum(axis=1)
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
    assert np.all(np.diff([worst(eccentricity) for eccentricity in GROWING], axis=0) > 0)


@pytest.mark.parametrize(
    ("quantity", "limit", "expected"),
    [(0, 0.0, 0.89e-6), (1, 50.0, 10.7e-6)],
    ids=["the lobes just clear of each other", "50 N on a tooth"],
)
def test_a_largest_eccentricity_follows_from_a_limit(quantity: int, limit: float, expected: float) -> None:
    largest = brentq(lambda e: worst(e)[quantity] - limit, 0.0, published.ECCENTRICITY, xtol=1e-9)
    assert_allclose(largest, expected, atol=0.06e-6)
    assert worst(largest - 0.1e-6)[quantity] < limit < worst(largest + 0.1e-6)[quantity]

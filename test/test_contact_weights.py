"""Effect of tooth errors on the transmission error, against displaced teeth in the reference."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import drives
import numpy as np
import pytest
from joint_records import ARCSEC
from numpy.testing import assert_allclose, assert_array_equal
from reference import polyline

from hd_diag.drive import Drive
from hd_diag.effects.contact_table import ContactTable, contact_table
from hd_diag.effects.contact_weights import ContactWeights
from hd_diag.model.contact import FLANKS, contacts
from hd_diag.model.load_sharing import flank_stiffness
from hd_diag.model.torsion import torsion
from hd_diag.model.transmission_error import Kinematics

Array = polyline.Array
Moments = tuple[Array, Array]
OneMesh = Callable[[float], polyline.Mesh]

ECCENTRICITY = (9e-6, 4e-6)
DRIVE = Drive(drives.mesh(eccentricity=ECCENTRICITY), Kinematics(100.0), 56.0)
LIMIT = 60.0
ANGLES = np.array([0.3, 1.9, 7.7, -4.0, 11.2])
TORQUES = np.array([-50.0, -12.0, 20.0, 45.0])
PITCH = 2 * math.pi / 202
SLOTS = PITCH * np.arange(202)
# Shares step where pairs come into load. The grid and the displacement itself smear these steps: a few pairs
# of about fifty.
TOLERANCE = 0.05


def weights(drive: Drive, angle: Array, torque: Array) -> ContactWeights:
    return ContactWeights(contact_table(drive, LIMIT), angle, torque)


def product(angle: Array = ANGLES, torque: Array = TORQUES) -> Moments:
    return np.repeat(angle, torque.size), np.tile(torque, angle.size)


def moved_outward(angle: float, outward: Array) -> polyline.Mesh:
    """The reference's mesh with radial displacements of slots [m], along each slot's axis."""
    wall = polyline._slot_polar(drives.PAPER, 1600)
    x, y = wall[0] * np.cos(wall[1]), wall[0] * np.sin(wall[1])
    walls = {d: (np.hypot(x + d, y), np.arctan2(y, x + d)) for d in np.unique(outward)}
    origin, normal = polyline.tooth_axes(angle, ECCENTRICITY)
    flank = polyline._flank(drives.PAPER.tooth, drives.PAPER.tooth_root, drives.PAPER.tooth_tip, 1600)
    middle = origin + 0.5 * (drives.PAPER.tooth_root + drives.PAPER.tooth_tip) * normal
    slot = np.rint(np.arctan2(middle[1], middle[0]) / PITCH).astype(int)
    out = np.full((3, 2, 200), np.nan)
    for side, sign in enumerate((1, -1)):
        across = np.array([-normal[1], normal[0]]) * sign
        body = origin[:, :, None] + normal[:, :, None] * flank[0] + across[:, :, None] * flank[1]
        radius = np.hypot(body[0], body[1])
        for i in np.flatnonzero(radius[:, -1] > wall[0][0]):
            c, s = np.cos(slot[i] * PITCH), np.sin(slot[i] * PITCH)
            place = np.arctan2(c * body[1, i] - s * body[0, i], c * body[0, i] + s * body[1, i])
            out[:, side, i] = polyline._contact((radius[i], sign * place), walls[outward[slot[i]]])
    return polyline.Mesh(out[0], out[0] * out[1], out[1], out[2])


def turned(mesh: OneMesh) -> Array:
    """Rotation of the cup through displaced teeth, at all moments and torques [rad]: the drive's TE."""
    result = []
    for angle in ANGLES:
        before, after = polyline.mesh(angle, ECCENTRICITY), mesh(angle)
        result += [polyline.torsion(after, -t) - polyline.torsion(before, -t) for t in TORQUES]
    return np.array(result)


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def worn(angle: float, clearance: float) -> polyline.Mesh:
    mesh = polyline.mesh(angle, ECCENTRICITY)
    return dataclasses.replace(mesh, rotation=mesh.rotation + clearance / mesh.radius)


@pytest.mark.parametrize(("member", "order"), [("slot", 4), ("radial", 2)])
def test_moved_slots_and_slots_out_of_round(member: str, order: int) -> None:
    size, place = 1e-6, 0.7
    moved = size * np.cos(order * (SLOTS - place))
    response = weights(DRIVE, *product()).harmonics(member, (order,))[:, 0]
    if member == "slot":
        expected = turned(lambda angle: polyline.mesh(angle, ECCENTRICITY, slot_shift=moved))
    else:
        expected = turned(lambda angle: moved_outward(angle, moved))
    found = (size * np.exp(-1j * order * place) * response).real
    assert rms(found - expected) < TOLERANCE * rms(expected)


def test_odd_pitch_errors_show_with_an_eccentricity() -> None:
    angle, torque = np.linspace(0.0, 2.0 * math.pi, 400), np.full(400, 20.0)
    centred = Drive(drives.mesh(), Kinematics(100.0), 56.0)
    even, odd = np.abs(weights(centred, angle, torque).harmonics("slot", (2, 3))).T
    assert np.max(odd) < 1e-3 * np.mean(even)
    even, odd = np.abs(weights(DRIVE, angle, torque).harmonics("slot", (2, 3))).T
    assert np.mean(odd) > 0.05 * np.mean(even)


SHIFT = 4e-6 * np.cos(2 * (SLOTS - 0.7))  # large enough to load and unload pairs


@pytest.mark.parametrize(
    ("errors", "mesh"),
    [
        ({"circumferential": SHIFT}, lambda angle: polyline.mesh(angle, ECCENTRICITY, slot_shift=SHIFT)),
        ({"radial": SHIFT}, lambda angle: moved_outward(angle, SHIFT)),
        ({"clearance": 4e-6}, lambda angle: worn(angle, 4e-6)),
    ],
)
def test_full_size_is_far_closer_than_the_first_order(errors: dict[str, Any], mesh: OneMesh) -> None:
    expected = turned(mesh)
    assert rms(weights(DRIVE, *product()).displaced(**errors) - expected) < 0.02 * rms(expected)


def exact(angle: Array, torque: Array) -> tuple[Array, Array, Array, Array]:
    contact = contacts(DRIVE.mesh, angle)
    beta = torsion(DRIVE.mesh, angle, DRIVE.frame.cup_torque(torque))
    loaded = FLANKS * beta[:, None, None] > contact.rotation
    share = np.where(loaded, FLANKS * flank_stiffness(contact, DRIVE.mesh.tooth_compliance), 0.0)
    share /= np.abs(share).sum(axis=(1, 2), keepdims=True)
    return share, np.where(np.isnan(contact.rotation), 1.0, contact.radius), contact.slots, contact.teeth


@pytest.fixture(scope="module")
def many() -> Moments:
    rng = np.random.default_rng(0)
    angle, torque = rng.uniform(-300.0, 300.0, 2000), rng.uniform(-LIMIT, LIMIT, 2000)
    return angle, torque


@pytest.mark.parametrize("order", [2, 6])
def test_harmonics_are_sums_of_shares(many: Moments, order: int) -> None:
    share, radius, slots, teeth = exact(*many)
    found, places = weights(DRIVE, *many), {"slot": PITCH * slots, "tooth": 2 * math.pi / 200 * teeth}
    for member, sign in (("slot", 1), ("tooth", -1)):
        waves = np.exp(1j * order * places[member])
        expected = sign * np.einsum("nfp,np->n", np.abs(share) / radius, waves)
        assert rms(np.abs(found.harmonics(member, (order,))[:, 0] - expected)) < 0.04 * np.abs(expected).max()


@pytest.mark.parametrize(
    ("member", "pitch", "number"),
    [("slot", PITCH, 0), ("slot", PITCH, 60), ("tooth", 2 * math.pi / 200, 199)],
)
def test_single_teeth_are_their_shares(many: Moments, member: str, pitch: float, number: int) -> None:
    share, radius, slots, teeth = exact(*many)
    own = ((slots if member == "slot" else teeth) == number)[:, None, :]
    expected = np.sum(np.where(own, share / radius, 0.0), axis=2)
    away = getattr(weights(DRIVE, *many), f"one_{member}")(number * pitch) - expected
    assert np.abs(expected).max() > 0.3
    assert rms(away) < 0.05 * np.abs(expected).max()


def test_all_teeth_together_turn_the_output_and_single_ones_add_up(many: Moments) -> None:
    """If all slots, or all teeth, move by c, the output turns by c over the contacts' radius."""
    found, radius = weights(DRIVE, *many), 30.9e-3
    assert_allclose(found.harmonics("slot", (0,))[:, 0], 1 / radius, rtol=5e-3)
    assert_allclose(found.harmonics("tooth", (0,))[:, 0], -1 / radius, rtol=5e-3)
    few = weights(DRIVE, *product())
    for response, count in ((few.one_slot, 202), (few.one_tooth, 200)):
        together = sum(response(number * 2 * math.pi / count) for number in range(count))
        assert_allclose(np.sum(together, axis=1), few.clearance(), atol=1e-9)


def test_reversed_torque_mirrors_pitch_and_reverses_form() -> None:
    """Without eccentricity the drive is symmetric; in its mirror image a radial error changes sign."""
    drive = Drive(drives.mesh(), Kinematics(100.0), 56.0)
    angle = 2 * math.pi / 404 * np.arange(404)
    sides = [weights(drive, angle, np.full(404, torque)) for torque in (30.0, -30.0)]
    for order in (2, 4):
        turning = np.exp(-1j * order * angle)
        pitch = [np.mean(side.harmonics("slot", (order,))[:, 0] * turning) for side in sides]
        form = [np.mean(side.harmonics("radial", (order,))[:, 0] * turning) for side in sides]
        assert_allclose(pitch[0], np.conj(pitch[1]), rtol=1e-6)
        assert_allclose(form[0], -np.conj(form[1]), rtol=1e-6)
        assert abs(pitch[0]) > 10.0
        assert abs(form[0]) > 5.0


def test_output_at_the_circular_spline_lags() -> None:
    other, (angle, torque) = Drive(DRIVE.mesh, Kinematics(101.0, "circular_spline"), 56.0), product()
    lagging, leading = weights(other, angle, -torque), weights(DRIVE, angle, torque)
    assert_allclose(lagging.harmonics("slot", (2,)), -leading.harmonics("slot", (2,)), atol=1e-12)


def test_idle_is_the_middle_of_both_sides_and_beyond_the_limit_the_response_stays() -> None:
    angle = np.linspace(0.0, 6.0, 30)
    above, below, idle, at, beyond = (
        weights(DRIVE, angle, np.full(30, torque)).harmonics("slot", (2,))[:, 0]
        for torque in (1e-12, -1e-12, 0.0, LIMIT, 2 * LIMIT)
    )
    assert_allclose(idle, 0.5 * (above + below), rtol=1e-4)
    assert_allclose(beyond, at, rtol=1e-12)


def test_refuses_a_limit() -> None:
    for limit in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match=r"torque_limit must be positive, not .* N m"):
            ContactTable(DRIVE, limit)


FAR = (30e-6, 8e-6)


@pytest.mark.parametrize(
    ("eccentricity", "beyond", "most"),
    [(ECCENTRICITY, 1.15, 0.01), (FAR, 1.15, 0.05), (ECCENTRICITY, 3.0, 0.2), (FAR, 10.0, 0.7)],
)
def test_torsion_is_by_maps_far_beyond_the_limit(
    eccentricity: tuple[float, float], beyond: float, most: float, many: Moments
) -> None:
    """Error of 0.01 arcsec at the limit; larger beyond it and where pairs touch with tip corners."""
    angle, torque = many[0], beyond * many[1]
    drive = dataclasses.replace(DRIVE, mesh=drives.mesh(eccentricity=eccentricity))
    table = contact_table(drive, LIMIT)
    away = table.torsion_under(angle, torque) - torsion(drive.mesh, angle, torque)
    assert 0.0 < rms(away) < most * ARCSEC
    assert_array_equal(table.torsion_under(angle[:9], torque[:9]), table.torsion_under(angle, torque)[:9])


def test_torsion_beyond_all_maps_is_exact(many: Moments) -> None:
    angle, torque = many[0][:20], np.linspace(-60.0, 60.0, 20) * LIMIT
    torque[3] = np.nan
    found = contact_table(DRIVE, LIMIT).torsion_under(angle, torque)
    exact = torsion(DRIVE.mesh, angle, torque)
    assert_array_equal(found[np.abs(torque) > 11.0 * LIMIT], exact[np.abs(torque) > 11.0 * LIMIT])
    assert np.isnan(found[3])


def test_ripple_is_the_error_less_its_mean_over_a_turn() -> None:
    turn = 2 * math.pi / 1000 * np.arange(1000)
    for drive in (DRIVE, dataclasses.replace(DRIVE, cup_compliance=2e-5)):
        for torque in (-45.0, 8.0, 1.1 * LIMIT):
            load = np.full(1000, torque)
            beta = torsion(drive.mesh, turn, drive.frame.cup_torque(load))
            error = drive.frame.transmission_error(beta, load)
            found = weights(drive, turn, load).ripple
            assert rms(found) > 0.5 * ARCSEC
            assert rms(found - (error - error.mean())) < 0.03 * ARCSEC


def test_ripple_of_parts_and_of_a_known_torsion(many: Moments) -> None:
    whole, rows = weights(DRIVE, *many), slice(100, 300)
    alone = whole.part(rows).ripple
    assert_allclose(alone, whole.ripple[rows], rtol=0, atol=1e-15)
    assert_array_equal(whole.part(rows).ripple, whole.ripple[rows])
    beta = whole.table.torsion_under(many[0], DRIVE.frame.cup_torque(whole.torque))
    given = ContactWeights(whole.table, *many, beta)
    assert_allclose(given.part(rows).ripple, alone, rtol=1e-12, atol=1e-18)
    moved = ContactWeights(whole.table, *many, beta + 1e-5)
    assert_allclose(np.abs(moved.ripple - whole.ripple), 1e-5, rtol=1e-6)

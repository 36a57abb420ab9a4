"""A damaged tooth at full size: a parted pair adds nothing more; choice of the next teeth."""

import math

import drives
import numpy as np
import pytest
from joint_records import ARCSEC
from numpy.testing import assert_allclose

from hd_diag.drive import Drive
from hd_diag.effects.contact_table import contact_table
from hd_diag.effects.contact_weights import ContactWeights
from hd_diag.effects.signals import Signals
from hd_diag.effects.tooth_damage import ARCS, EFFECT, SLOT, TOOTH
from hd_diag.model.transmission_error import Kinematics

DRIVE = Drive(drives.mesh(eccentricity=(9e-6, 4e-6)), Kinematics(100.0), 56.0)
PITCH = {SLOT: 2 * math.pi / 202, TOOTH: 2 * math.pi / 200}
MEMBERS = pytest.mark.parametrize("member", PITCH)
NUMBER = 77


@pytest.fixture(scope="module")
def signals() -> Signals:
    rng = np.random.default_rng(0)
    angle, torque = rng.uniform(-300.0, 300.0, 3000), rng.uniform(-60.0, 60.0, 3000)
    time, none, run = np.arange(3000.0), np.zeros(3000), np.zeros(3000, dtype=np.int64)
    contact = ContactWeights(contact_table(DRIVE, 60.0), angle, torque)
    return Signals(time, angle, -angle / 101.0, none, torque, None, run, none, none, none, contact)


def place(member: float, arc: float = 0.0) -> tuple[float, float, float]:
    return member, NUMBER * PITCH[member], arc


def response(signals: Signals, member: float, *flanks: float) -> np.ndarray:
    return EFFECT.response(signals, np.array(flanks), place(member))


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.parametrize("clearance", [2e-6, 1e-5, 4e-5, 1.6e-4])
@pytest.mark.parametrize("flank", [0, 1])
def test_a_worn_slot_is_the_contact_solved_with_it(signals: Signals, clearance: float, flank: int) -> None:
    opened = np.zeros((2, 202))
    opened[flank, NUMBER] = clearance
    expected = signals.contact.displaced(clearance=opened)
    flanks = np.where(np.arange(2) == flank, clearance, 0.0)
    assert rms(expected) > 0.05 * ARCSEC
    assert rms(response(signals, SLOT, *flanks) - expected) < 0.02 * rms(expected)
    if clearance >= 1e-5:
        linear = EFFECT.columns(signals, place(SLOT)) @ flanks
        assert rms(linear - expected) > 0.3 * rms(expected)


@MEMBERS
def test_the_response_grows_until_the_pair_parts(signals: Signals, member: float) -> None:
    """Then it stays: no torque in this record bends the other pairs by the largest of these sizes."""
    sizes = [0.0, 1e-6, 4e-6, 1e-5, 2e-5, 4e-5, 8e-5, 1.6e-4]
    for way in ([1.0, 0.0], [0.0, 1.0]):
        found = np.abs([response(signals, member, *(size * np.array(way))) for size in sizes])
        assert np.all(np.diff(found, axis=0) >= -1e-15)
        assert rms(found[3]) > 1.5 * rms(found[1])
        assert_allclose(found[-1], found[-2], rtol=1e-9, atol=1e-18)
        assert 1.0 * ARCSEC < found[-1].max() < 10.0 * ARCSEC


@MEMBERS
def test_flanks_bear_one_torque_each(signals: Signals, member: float) -> None:
    both = response(signals, member, 5e-5, 3e-5)
    parts = response(signals, member, 5e-5, 0.0), response(signals, member, 0.0, 3e-5)
    assert_allclose(both, parts[0] + parts[1], rtol=1e-12, atol=1e-18)
    loaded = np.abs(signals.torque) > 5.0
    assert not np.any((parts[0] != 0.0) & (parts[1] != 0.0) & loaded)


@pytest.mark.parametrize("arc", ARCS)
@MEMBERS
def test_pairs_of_an_arc_share_the_whole_load(signals: Signals, member: float, arc: float) -> None:
    """With equal clearance on all flanks the gear turns by clearance over radius, as in the contact."""
    loaded, count = np.abs(signals.torque) > 20.0, round(2.0 * math.pi / PITCH[member])
    every = [EFFECT.columns(signals, (member, number * PITCH[member], arc)) for number in range(count)]
    found = np.sum(every, axis=(0, 2))[loaded]
    assert_allclose(np.abs(found), 1.0 / DRIVE.mesh.geometry.curve.radius, rtol=0.02)
    assert_allclose(found, signals.contact.clearance()[loaded], rtol=0.05)


@pytest.mark.parametrize("arc", ARCS)
@MEMBERS
def test_a_pulse_is_looked_for_where_it_is(signals: Signals, member: float, arc: float) -> None:
    left = EFFECT.columns(signals, place(member, arc)) @ np.array([2e-5, 1e-5])
    found = [at for own, at, width in EFFECT.starts(signals, left).points if (own, width) == (member, arc)]
    away = np.remainder(np.array(found) - NUMBER * PITCH[member] + 0.5 * math.pi, math.pi) - 0.5 * math.pi
    assert np.abs(away) == pytest.approx(0.0, abs=0.05)

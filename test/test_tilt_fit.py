"""Tilt of a wave generator, fitted together with its eccentricity, on independent records."""

import dataclasses

import numpy as np
import pytest
from challenge import motion
from challenge.contact import Gear, balanced
from challenge.design import Design
from challenge.truth import NOMINAL
from joint_records import NOISE, RATIO, joint
from reference import polyline

from hd_diag.diagnosis.diagnosis import diagnose
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.refit import FEW_STARTS, refit
from hd_diag.diagnosis.judgement import Answer
from hd_diag.diagnosis.record import Record, prepare
from hd_diag.diagnosis.verdict import as_json, sentence
from hd_diag.drive import Drive

WIDTH = 11e-3
PLACES, SHARES = np.polynomial.legendre.leggauss(3)
ECCENTRICITY, TILT = 7e-6 * np.exp(0.9j), 1.1e-3 * np.exp(2.3j)


def configured(cup_length: float = 0.0) -> Drive:
    return joint(face_width=WIDTH, cup_length=cup_length, sections=3).drive


def recorded(tilt: complex, cup_length: float = 0.0, rate: float = 60.0, loaded: bool = False) -> Record:
    """Record of parallel sections; each is a generator's drive with its own eccentricity and curve."""
    rng = np.random.default_rng(0)
    moves = motion.standard(rng)
    time = np.arange(round(60.0 * rate)) / rate
    angle, torque = moves.angle(time), moves.torque(time)
    if loaded:
        torque = 45.0 + 0.2 * torque
    gears = []
    for place, share in zip(0.5 * WIDTH * PLACES, 0.5 * SHARES, strict=True):
        moved = ECCENTRICITY + tilt * place
        curve = polyline.deformed(polyline.DEFAULT, cup_length, float(place))
        design = Design(f"section {1e3 * place:.1f}", curve) if cup_length else NOMINAL.design
        base = dataclasses.replace(NOMINAL, e=abs(moved), psi=np.angle(moved), design=design)
        base = dataclasses.replace(base, compliance=base.compliance / share)
        gears.append(Gear(base))
    flank = np.concatenate([gear.flank for gear in gears])
    beta = []
    for part in np.array_split(np.arange(time.size), time.size // 500):
        closed = [gear.clearance(-angle[part]) for gear in gears]
        both = (np.concatenate(each, axis=1) for each in zip(*closed, strict=True))
        beta.append(balanced(*both, flank, -torque[part]))
    output = angle / RATIO + np.concatenate(beta) + NOISE * rng.standard_normal(time.size)
    return prepare(time, angle, output, torque, None, np.zeros(time.size, np.int64), RATIO)


def test_a_tilt_is_found_beside_an_eccentricity() -> None:
    drive = configured()
    record = recorded(TILT, rate=20.0)
    found = refit(record, drive, np.random.default_rng(0), starts=FEW_STARTS)
    mesh = dataclasses.replace(drive.mesh, eccentricity=ECCENTRICITY, tilt=TILT)
    true = fit_parameters.vector(dataclasses.replace(drive, mesh=mesh), drive)
    off = np.array([found.parameters - one for one in fit_parameters.alike(true, drive)])
    most = [1.0, 1.0, 2.0, 1.0, 3.0, 2.0, 0.5, 2.0, 3.0]  # of a search with an approximate model
    assert np.any(np.all(np.abs(off) < most, axis=1))
    assert found.trustworthy  # a ring with opposite tilt is the same


@pytest.mark.slow
@pytest.mark.parametrize(("cup_length", "side"), [(0.0, 1.0), (40e-3, 1.0), (40e-3, -1.0)])
def test_a_diagnosis_gives_the_tilt(cup_length: float, side: float) -> None:
    """For a cup, a tilt to the other side is another drive, and the fit distinguishes them."""
    drive = configured(cup_length)
    record = recorded(side * TILT, cup_length, rate=120.0)  # half the record leaves the tilt open
    found = diagnose(record, drive, np.random.default_rng(0))
    answer, told = Answer(found), as_json(found, "joint_1")["refit"]["parameters"]
    assert [change.name for change in answer.changes] == ["eccentricity", "tilt"]
    assert not found.causes
    assert told["tilt.magnitude"]["unit"] == "rad"
    size, turned = told["tilt.magnitude"], told["tilt.direction"]
    assert abs(size["value"] - abs(TILT)) < 3.0 * size["std"] < 0.5 * abs(TILT)
    period = fit_parameters.direction_period("tilt", drive)
    off = np.mod(turned["value"] - np.angle(side * TILT) + 0.5 * period, period) - 0.5 * period
    assert abs(off) < 3.0 * turned["std"]
    assert "the wave generator's tilt is 1." in sentence(answer)
    assert "mrad" in sentence(answer)


@pytest.mark.slow
def test_a_tilt_that_a_record_does_not_show_has_a_bound() -> None:
    """Above a quarter of the rated torque the teeth of all sections carry load."""
    found = diagnose(recorded(TILT, loaded=True), configured(), np.random.default_rng(0))
    assert abs(TILT) < found.kept["tilt"] < 5e-3
    assert "tilt" not in {change.name for change in Answer(found).changes}

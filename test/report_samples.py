"""Reports for the tests of pages: diagnoses of the independent generator's records, each computed once."""

import dataclasses
import functools
from pathlib import Path

import numpy as np
from challenge import families, motion, records
from challenge.records import Recording, simulate
from challenge.truth import drawn
from live import config

from hd_diag.config.configuration import Config
from hd_diag.diagnosis.diagnosis import Diagnosis, diagnose
from hd_diag.diagnosis.record import prepare
from hd_diag.report.facts import JointReport, of_diagnosis

CAUSES = {"output_runout": 0, "input_encoder_eccentricity": 12}  # effect and development seed
HOSTILE = "<script>alert(1)</script><img src=x onerror=alert(2)>$\\frac{1}{2}$]]>\"'&\u202egnp\x07"


@functools.cache
def made(name: str, duration: float = 5.0) -> records.Record:
    """Record with one cause."""
    rng = families.generator("one_effect", CAUSES[name])
    standard = motion.standard(rng)
    moved = motion.Motion(tuple(dataclasses.replace(each, duration=duration) for each in standard.runs))
    causes = [families.draw(rng, name, moved)]
    return simulate(drawn(rng), causes, moved, rng, Recording(rate=200.0))


@functools.cache
def diagnosis(name: str) -> Diagnosis:
    record = made(name)
    data = (record.time, record.input_angle, record.output_angle, record.torque, record.temperature)
    prepared = prepare(*data, np.zeros(record.time.size, dtype=np.int64), 100.0)
    return diagnose(prepared, config().joints[0].drive, np.random.default_rng(0))


@functools.cache
def joint_report(name: str, **names: str) -> JointReport:
    """Report of that diagnosis, as of a joint with these names in JointState."""
    whole = configured(**names)
    return of_diagnosis(diagnosis(name), whole.joints[0], whole.flat)


def configured(**names: str) -> Config:
    return config(**{f"joint_1__{key}": value for key, value in names.items()})


def without_output(path: Path, joint: str) -> None:
    """A bag whose joint reports its input and torque only."""
    record = made("output_runout")
    silent = dataclasses.replace(record, output_angle=np.full_like(record.output_angle, np.nan))
    records.write_bag(silent, path, joint)

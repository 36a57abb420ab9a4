"""Reports for tests of pages: diagnoses of the independent generator's records, each computed once."""

import dataclasses
import functools
import re
from pathlib import Path

import numpy as np
import pytest
from challenge import families, motion, records
from challenge.records import Recording, simulate
from challenge.truth import drawn
from joint_records import columns, joint, prepared
from live import config

from hd_diag.config.configuration import Config
from hd_diag.diagnosis.diagnosis import Diagnosis, diagnose
from hd_diag.diagnosis.record import Record, prepare
from hd_diag.drive import Drive
from hd_diag.effects import Catalogue
from hd_diag.report.facts import Fact, JointReport, of_diagnosis
from hd_diag.report.page import page
from hd_diag.tolerance.study import with_allowed

CAUSES = {"output_runout": 0, "input_encoder_eccentricity": 12}  # effect and development seed
HOSTILE = "<script>alert(1)</script><img src=x onerror=alert(2)>$\\frac{1}{2}$]]>\"'&\u202egnp\x07"
RATE = 200.0  # [Hz]
RUN = 5.0  # [s]; twelve runs, half as long as the benchmark's


def generated(family: str, seed: int, *names: str, run: float = RUN) -> records.Record:
    """Record of a family's seed with the named causes."""
    rng = families.generator(family, seed)
    standard = motion.standard(rng)
    moved = motion.Motion(tuple(dataclasses.replace(each, duration=run) for each in standard.runs))
    causes = [families.draw(rng, name, moved) for name in names]
    return simulate(drawn(rng), causes, moved, rng, Recording(rate=RATE))


def diagnosed(made: records.Record) -> Diagnosis:
    data = (made.time, made.input_angle, made.output_angle, made.torque, made.temperature)
    one_run = np.zeros(made.time.size, dtype=np.int64)
    drive, rng = config().joints[0].drive, np.random.default_rng(0)
    return diagnose(prepare(*data, one_run, 100.0), drive, rng)


@functools.cache
def made(name: str) -> records.Record:
    """Record with the named cause."""
    return generated("one_effect", CAUSES[name], name)


@functools.cache
def diagnosis(name: str) -> Diagnosis:
    return diagnosed(made(name))


@functools.cache
def eccentric() -> Diagnosis:
    """Diagnosis of a record of the package's own drive with an eccentricity only."""
    return diagnose(prepared(columns(8.0)), joint().drive, np.random.default_rng(0))


@functools.cache
def joint_report(name: str, **names: str) -> JointReport:
    return report_of(diagnosis(name), **names)


def report_of(found: Diagnosis, **names: str) -> JointReport:
    """Report of a diagnosis for a joint with these names in JointState."""
    whole = configured(**names)
    return of_diagnosis(found, whole.joints[0], whole.flat, np.random.default_rng(0))


def configured(**names: str) -> Config:
    return config(**{f"joint_1__{key}": value for key, value in names.items()})


@functools.cache
def hostile_page() -> str:
    """Page of two joints whose names look like markup."""
    names = {"input_joint": HOSTILE, "output_joint": HOSTILE + "2"}
    return page([joint_report("output_runout", **names)] * 2, [Fact(HOSTILE, HOSTILE)])


@functools.cache
def judged(name: str) -> Diagnosis:
    """Diagnosis with the allowed eccentricity, as a verb reports it."""
    return with_allowed(diagnosis(name), config().flat, "joint_1")


def known_to_the_command_line(monkeypatch: pytest.MonkeyPatch, name: str) -> list[tuple[Record, Catalogue]]:
    """From now on `hd-diag` returns this diagnosis without computing it; returns the list of requests."""
    asked: list[tuple[Record, Catalogue]] = []

    def known(
        record: Record, drive: Drive, rng: np.random.Generator, progress: object, catalogue: Catalogue
    ) -> Diagnosis:
        asked.append((record, catalogue))
        return judged(name)

    monkeypatch.setattr("hd_diag.cli.record.screened", lambda record, _: record)
    monkeypatch.setattr("hd_diag.cli.record.diagnose", known)
    monkeypatch.setattr("hd_diag.cli.record.with_allowed", lambda found, *_: found)
    return asked


def letters(text: str) -> str:
    """Letters and digits of a text, so that layout does not matter."""
    return re.sub(r"\W+", "", text).lower()


def without_output(path: Path, joint: str) -> None:
    """Write a bag whose joint reports only input and torque."""
    record = made("output_runout")
    silent = dataclasses.replace(record, output_angle=np.full_like(record.output_angle, np.nan))
    records.write_bag(silent, path, joint)

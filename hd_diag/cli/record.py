"""What ``hd-diag diagnose``, ``report`` and ``ripple`` share: options, each joint's diagnosis, JSON, page."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hd_diag.bag.reader import BagReader
from hd_diag.cli.joints import chosen_joints, configured, tell_assumed
from hd_diag.cli.lines import tell
from hd_diag.cli.progress import Advance
from hd_diag.cli.targets import Problem, write_json, writing
from hd_diag.cli.topics import of_table, tell_contents
from hd_diag.config.catalogue import load
from hd_diag.config.configuration import Config, JointConfig
from hd_diag.diagnosis.diagnosis import Diagnosis, diagnose
from hd_diag.diagnosis.fit.fit_parameters import warm_up
from hd_diag.diagnosis.orders_only import orders_only
from hd_diag.diagnosis.record import Record, RecordError
from hd_diag.diagnosis.ripple.ripple import NO_TORQUE, Ripple, ripple
from hd_diag.diagnosis.screening import screened
from hd_diag.diagnosis.work import Work
from hd_diag.effects import Catalogue
from hd_diag.memory import give_back
from hd_diag.records.joint_record import InputRecord, nothing, read_bags, read_motion
from hd_diag.records.tables import Table, read_table_motion, read_tables
from hd_diag.records.text_table import WHITE, is_table
from hd_diag.report.facts import JointReport, sources
from hd_diag.tolerance.study import with_allowed

PREPARING = "preparing the model (a minute, the first time on a machine)"
"""Message while kernels are compiled."""

_DELIMITERS = {"tab": "\t", "space": WHITE}


@dataclass(frozen=True)
class Records:
    """Records that a verb was given: files, chosen joints, and the effects to search among."""

    bags: tuple[Path, ...]
    config: Config
    joints: list[JointConfig]
    table: Table | None
    catalogue: Catalogue
    time_limit: float = math.inf
    orders_only: bool = False

    def diagnosed(self, joint: JointConfig, advance: Advance) -> Diagnosis:
        """Diagnosis of a joint; BagError or RecordError if nothing can be judged."""
        advance(0, 0, "reading")
        # The record has no name, so that its memory is freed after screening.
        looked = screened(self._record(joint), joint.configured)
        rng = np.random.default_rng(0)
        if self.orders_only:
            return orders_only(looked, joint.configured, rng)
        advance(0, 0, PREPARING)
        warm_up()  # compiling does not count towards the time limit
        give_back()
        work = Work(self.time_limit, lambda share, text: advance(share, 1.0, text))
        found = diagnose(looked, joint.configured, rng, work, self.catalogue)
        return with_allowed(found, self.config.flat, joint.name)

    def motion(self, joint: JointConfig) -> InputRecord:
        """A joint's motion and torque, from two angles or one; RecordError if there is none."""
        if self.table is None:
            found = read_motion(self.bags, joint)
        else:
            found = read_table_motion(self.bags, self.table, joint)
        if found is None:
            raise RecordError(nothing(self.bags, joint))
        return found

    def ripple(self, joint: JointConfig, motion: InputRecord) -> Ripple:
        """Lines of a joint's torque over a motion; RecordError if nothing can be judged."""
        columns = motion.time, motion.input_angle, motion.torque, motion.bag
        try:
            if motion.no_torque:
                raise RecordError(f"the torque {motion.no_torque}: {NO_TORQUE}")
            return ripple(*columns, joint.configured.kinematics)
        except RecordError as error:
            raise RecordError(motion.stamps.after(str(error))) from error

    def _record(self, joint: JointConfig) -> Record:
        if self.table is None:
            return read_bags(self.bags, joint)
        return read_tables(self.bags, self.table, joint)


def table_of(columns: str, divided: bool, rate: float, delimiter: str) -> Table:
    """How to read CSV files, from the options."""
    pairs = [item.split("=", 1) for item in columns.split(",")]
    if any(len(pair) != 2 for pair in pairs):
        raise Problem("--columns takes pairs like time=t,input=motor_position[deg],output=joint_position")
    if len(delimiter) > 1 and delimiter not in _DELIMITERS:
        raise Problem(f"--delimiter takes one character, tab or space, not {delimiter!r}")
    names = {key.strip(): name.strip() for key, name in pairs}
    if len(names) < len(pairs):
        raise Problem(f"--columns names something twice: {columns}")
    return Table(names, divided, rate, _DELIMITERS.get(delimiter, delimiter))


def on_records(function: Callable[..., int], teeth: bool = True) -> Callable[..., int]:
    """Wrap a verb's function, which then gets the options on records as :class:`Records`.

    Without `teeth`, and for orders only, the configured ratio need not be that of the configured teeth.
    """

    @functools.wraps(function)
    def run(
        bags: tuple[Path, ...],
        config_file: str | None,
        names: tuple[str, ...],
        columns: str | None,
        rate: float | None,
        delimiter: str,
        divided: bool,
        effect_files: tuple[Path, ...],
        time_limit: float = math.inf,
        **own: Any,
    ) -> int:
        for path in bags if columns is None else ():
            if is_table(path):
                tell_contents(found := of_table(path, function.__name__))
                more = (
                    f", such as: {found['mapping']}" if found["mapping"] else " time=...,input=...,output=..."
                )
                raise Problem(f"{path}: a table needs --columns{more}")
        catalogue = load(effect_files)
        config = configured(config_file, catalogue, teeth and not own.get("orders_only"))
        joints = chosen_joints(config, names)
        table = None if columns is None else table_of(columns, divided, rate or 0.0, delimiter)
        code = function(Records(bags, config, joints, table, catalogue, time_limit), **own)
        tell_assumed(config_file, config)
        return code

    return run


Judged = tuple[dict[str, Any], list[str], JointReport | None]
"""A joint's JSON, lines for the terminal, and part of the page if there is to be one."""


def judge_each(
    records: Records, judge: Callable[[JointConfig], Judged], page_file: Path | None, json_file: str | None
) -> tuple[list[dict[str, Any]], int]:
    """Judge all joints; show the lines, write page and JSON; return the joints' JSON and the exit code.

    A joint that cannot be judged is reported on stderr and in the JSON, and the others go on; a single joint
    is a Problem.
    """
    contents, pages, complete = [], [], True
    # Read now: a log's file may be gone once its joints are judged.
    files = [_span(bag, records.table is None) for bag in records.bags] if json_file else []
    for joint in records.joints:
        try:
            content, lines, page = judge(joint)
        except RecordError as error:
            if len(records.joints) == 1:
                raise Problem(f"{joint.name}: {error}") from error
            tell(f"hd-diag: {joint.name}: not judged: {' '.join(str(error).split())}", err=True)
            content, lines, page, complete = not_judged(joint.name, error), [], None, False
        complete &= content.get("judgement") != "not_judged"  # its signals are wrong: the lines say how
        contents.append(content)
        pages += [page] if page is not None else []
        for line in lines if json_file != "-" else ():
            tell(f"{joint.name}: {line}")
    written = page_file if pages else None
    if written is not None:
        from hd_diag.report.page import page as drawn  # late: matplotlib takes its time

        with writing(written) as place:
            place.write_text(drawn(pages, sources(records.bags)), encoding="utf-8")
        tell(f"report written: {written}", err=json_file == "-")
    several = {"schema": "hd_diag/diagnoses/1", "joints": contents}
    result = contents[0] if len(contents) == 1 else several
    write_json(json_file, result | {"files": files, "report": written and str(written.absolute())})
    return contents, 0 if complete else Problem.exit_code


def _span(path: Path, is_bag: bool) -> dict[str, Any]:
    """A file with the times of its first and last message in the log [s since 1970]; a table has none."""
    begin = end = math.nan
    if is_bag:
        with BagReader(path) as reader:
            begin, end = 1e-9 * reader.start, 1e-9 * reader.end
    return {"path": str(path.absolute()), "from": begin, "to": end}


def not_judged(joint: str, error: Exception) -> dict[str, Any]:
    """JSON of a joint whose record cannot be judged."""
    return {"schema": "hd_diag/not_judged/1", "joint": joint, "error": str(error)}

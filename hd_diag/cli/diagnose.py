"""``hd-diag diagnose``, ``report`` and ``ripple``: judge records of joints."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hd_diag import __version__
from hd_diag.cli.lines import show_table
from hd_diag.cli.options import check_files
from hd_diag.cli.progress import showing
from hd_diag.cli.record import PREPARING, Judged, Records, judge_each, not_judged, on_records
from hd_diag.cli.targets import Problem
from hd_diag.config.configuration import JointConfig
from hd_diag.config.model_file import document, write
from hd_diag.config.parameters import of_joint
from hd_diag.diagnosis.diagnosis import Diagnosis
from hd_diag.diagnosis.record import RecordError
from hd_diag.diagnosis.ripple import verdict as ripple_verdict
from hd_diag.diagnosis.verdict import as_json, summary
from hd_diag.effects.order_line import ORDER_LINE
from hd_diag.formatting import json_ready
from hd_diag.report.facts import digests, of_diagnosis, of_motion


@on_records
def diagnose(
    records: Records,
    fail_on_cause: bool,
    orders_only: bool,
    model_file: Path | None,
    report_file: Path | None,
    json_file: str | None,
) -> int:
    """Run ``hd-diag diagnose``."""
    models = _model_files(model_file, records.joints)
    check_files((*models.values(), report_file, json_file))
    records = replace(records, orders_only=orders_only)
    if orders_only and (model_file or report_file):
        raise Problem("--orders-only has no tooth model: it takes neither --model nor --report")

    def judge(joint: JointConfig) -> Judged:
        with showing() as part:
            found = records.diagnosed(joint, part(joint.name))
        lines, written, page = summary(found), None, None
        if model_file is not None and found.model is None:
            lines.append("no model was written: the record does not allow one")
        elif model_file is not None:
            written = str(models[joint.name])
            write(written, model_document(found, joint.name, records), records.catalogue)
            lines.append(f"model written: {written}")
        if report_file is not None:
            page = of_diagnosis(found, joint, records.config.flat, np.random.default_rng(0))
        return as_json(found, joint.name, written), lines, page

    results, code = judge_each(records, judge, report_file, json_file)
    named = any(result.get("causes") or result.get("unexplained") for result in results)
    return 1 if fail_on_cause and named else code


def _model_files(file: Path | None, joints: Sequence[JointConfig]) -> dict[str, Path]:
    """Path of each joint's model; with several joints the file name contains the joint's name."""
    if file is None:
        return {}
    if len(joints) == 1:
        return {joints[0].name: file}
    return {joint.name: file.with_name(f"{file.stem}_{joint.name}{file.suffix}") for joint in joints}


def model_document(found: Diagnosis, joint: str, records: Records) -> dict[str, Any]:
    """Content that `hd-diag diagnose --model` writes for a diagnosis with a model."""
    assert found.model is not None
    assert found.found is not None
    own = of_joint(records.config.flat, joint)
    spreads = {name: value["std"] for name, value in found.parameters.items()}
    effects = [
        (cause.effect.standard_deviations(cause.coefficients, cause.nonlinear, cause.covariance), cause.alike)
        for cause in found.found.causes
    ]
    motor = [term.effect.name for term in found.model.effects if term.effect.given]
    effects += [(found.motor_std, (name,)) for name in motor]
    effects += [({}, (one.effect.name,)) for one in found.functions if one.is_described]
    effects += [
        (ORDER_LINE.standard_deviations(row.coefficients, row.nonlinear, row.covariance), (ORDER_LINE.name,))
        for row in found.order_table
        if row.in_model
    ]
    content = as_json(found, joint)
    evidence = {key: content[key] for key in ("record", "gain", "noise_floor", "extended", "unexplained")}
    evidence["trustworthy"] = content["refit"]["trustworthy"]
    evidence["bags"] = [{"path": str(path), "sha256": digests(path)} for path in records.bags]
    return dict(json_ready(document(joint, own, found.model, spreads, effects, evidence, __version__)))


@on_records
def report(records: Records, out: Path | None, json_file: str | None) -> int:
    """Run ``hd-diag report``."""
    target = out or Path(f"{records.bags[0].stem}.html")
    check_files((target, json_file))

    def judge(joint: JointConfig) -> Judged:
        flat = records.config.flat
        with showing() as part:
            advance = part(joint.name)
            try:
                diagnosis = records.diagnosed(joint, advance)
            except RecordError as error:
                motion = found = None
                with contextlib.suppress(RecordError):
                    motion = records.motion(joint)
                    found = records.ripple(joint, motion)
                if motion is None:
                    raise
                advance(0, 0, PREPARING)
                page = of_motion(motion, joint, flat, str(error), found)
                content = {"ripple": ripple_verdict.as_json(found, joint.name)} if found else {}
                content |= motion.stamps.reported
                return not_judged(joint.name, error) | content, page.lines, page
            advance(0, 0, "gathering the report's numbers")
            page = of_diagnosis(diagnosis, joint, flat, np.random.default_rng(0))
            return as_json(diagnosis, joint.name), page.lines, page

    return judge_each(records, judge, target, json_file)[1]


@partial(on_records, teeth=False)
def ripple(records: Records, json_file: str | None) -> int:
    """Run ``hd-diag ripple``."""
    from rich.table import Table

    tables: list[Table] = []

    def judge(joint: JointConfig) -> Judged:
        with showing() as part:
            part(joint.name)(0, 0, "looking at the torque")
            motion = records.motion(joint)
            found = records.ripple(joint, motion)
        tables.append(Table(*ripple_verdict.TITLES, title=f"{joint.name}: torque over position"))
        for line in (*found.lines, *found.others):
            tables[-1].add_row(*ripple_verdict.row(line))
        for one in found.unseen:
            tables[-1].add_row(f"{one.order:g}", "not seen here")
        content = ripple_verdict.as_json(found, joint.name) | motion.stamps.reported
        return content, [*motion.stamps.lines, ripple_verdict.sentence(found)], None

    _, code = judge_each(records, judge, None, json_file)
    for table in tables if json_file != "-" else ():
        show_table(table)
    return code

"""``hd-diag report``: a bag on a page, judged where its output was measured."""

from __future__ import annotations

import sys
from pathlib import Path

import click
import numpy as np

from hd_diag.bag.joint_record import InputRecord
from hd_diag.cli.options import FILE, JSON, Problem, check_targets, verb
from hd_diag.cli.progress import showing
from hd_diag.cli.record import Judged, Records, judge_each, not_judged, on_records
from hd_diag.config.configuration import JointConfig
from hd_diag.diagnosis.record import RecordError
from hd_diag.diagnosis.ripple.ripple import Ripple
from hd_diag.diagnosis.ripple.verdict import as_json as ripple_json
from hd_diag.diagnosis.verdict import as_json
from hd_diag.report.facts import of_diagnosis, of_motion


@verb("report joint.mcap --config arm.yaml --out joint.html")
@on_records
@click.option("--out", type=FILE, help="Write the page here. [default: the first bag's name with .html]")
@JSON
def report(records: Records, out: Path | None, json_file: str | None) -> None:
    """Draw a bag: verdict, what to inspect, measured against simulated, teeth, data.

    Diagnoses the bag as `hd-diag diagnose` does, with the same JSON, and writes one HTML file that needs
    nothing else. Where a bag does not hold the output angle, or its record cannot be judged, it shows the
    model's side of the motion and says so; the JSON then has the reason as "error". Several bags are runs of
    the same joint. A joint of which nothing can be shown is reported on stderr, the others go on, and the
    exit code is 2.
    """
    target = out or Path(f"{records.bags[0].stem}.html")
    check_targets((target, json_file), *records.bags)

    def judge(joint: JointConfig) -> Judged:
        flat = records.config.flat
        with showing() as part:
            advance = part(joint.name)
            try:
                found = records.diagnosed(joint, advance)
            except RecordError as error:
                motion, ripple = _motion(records, joint)
                if motion is None:
                    raise
                page = of_motion(motion, joint, flat, str(error), ripple)
                told = {"ripple": ripple_json(ripple, joint.name)} if ripple else {}
                return not_judged(joint.name, error) | told, [page.verdict], page
            advance(0, 0, "gathering the report's numbers")
            page = of_diagnosis(found, joint, flat, np.random.default_rng(0))
            return as_json(found, joint.name), [page.verdict], page

    _, complete = judge_each(records, judge, target, json_file)
    sys.exit(0 if complete else Problem.exit_code)


def _motion(records: Records, joint: JointConfig) -> tuple[InputRecord | None, Ripple | None]:
    """A joint's motion and the ripple of its torque, as far as there are any."""
    motion = None
    try:
        motion = records.motion(joint)
        return motion, records.ripple(joint, motion)
    except RecordError:
        return motion, None

"""``hd-diag report``: a bag on a page, judged where its output was measured."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hd_diag.cli.options import check_files
from hd_diag.cli.progress import showing
from hd_diag.cli.record import Judged, Records, judge_each, not_judged, on_records
from hd_diag.config.configuration import JointConfig
from hd_diag.diagnosis.record import RecordError
from hd_diag.diagnosis.ripple.ripple import Ripple
from hd_diag.diagnosis.ripple.verdict import as_json as ripple_json
from hd_diag.diagnosis.verdict import as_json
from hd_diag.records.joint_record import InputRecord
from hd_diag.report.facts import of_diagnosis, of_motion


@on_records
def report(records: Records, out: Path | None, json_file: str | None) -> int:
    """Do what ``hd-diag report`` is asked for."""
    target = out or Path(f"{records.bags[0].stem}.html")
    check_files((target, json_file))

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
                content = {"ripple": ripple_json(ripple, joint.name)} if ripple else {}
                content |= motion.stamps.reported
                return not_judged(joint.name, error) | content, [page.verdict], page
            advance(0, 0, "gathering the report's numbers")
            page = of_diagnosis(found, joint, flat, np.random.default_rng(0))
            return as_json(found, joint.name), [page.verdict], page

    return judge_each(records, judge, target, json_file)[1]


def _motion(records: Records, joint: JointConfig) -> tuple[InputRecord | None, Ripple | None]:
    """A joint's motion and the ripple of its torque, as far as there are any."""
    motion = None
    try:
        motion = records.motion(joint)
        return motion, records.ripple(joint, motion)
    except RecordError:
        return motion, None

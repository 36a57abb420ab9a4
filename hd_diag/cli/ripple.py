"""``hd-diag ripple``: lines of a joint's torque over its position, where there is one angle only."""

from __future__ import annotations

from rich.table import Table

from hd_diag.cli.lines import show_table
from hd_diag.cli.progress import showing
from hd_diag.cli.record import Judged, Records, judge_each, on_records
from hd_diag.config.configuration import JointConfig
from hd_diag.diagnosis.ripple.ripple import Ripple
from hd_diag.diagnosis.ripple.verdict import TITLES, as_json, row, sentence
from hd_diag.diagnosis.stamps import UNTOLD


@on_records
def ripple(records: Records, json_file: str | None) -> int:
    """Do what ``hd-diag ripple`` is asked for."""
    tables: dict[str, Ripple] = {}

    def judge(joint: JointConfig) -> Judged:
        with showing() as part:
            part(joint.name)(0, 0, "looking at the torque")
            motion = records.motion(joint)
            found = records.ripple(joint, motion)
        tables[joint.name], stamps = found, motion.stamps if motion else UNTOLD
        return as_json(found, joint.name) | stamps.reported, [*stamps.lines, sentence(found)], None

    _, code = judge_each(records, judge, None, json_file)
    for name, found in tables.items() if json_file != "-" else ():
        show_table(_table(name, found))
    return code


def _table(name: str, found: Ripple) -> Table:
    table = Table(*TITLES, title=f"{name}: torque over position")
    for line in (*found.lines, *found.others):
        table.add_row(*row(line))
    return table

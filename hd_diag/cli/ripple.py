"""``hd-diag ripple``: lines of a joint's torque over its position, where there is one angle only."""

from __future__ import annotations

import sys

from rich.console import Console
from rich.table import Table

from hd_diag.cli.options import JSON, Problem, check_targets, verb
from hd_diag.cli.progress import showing
from hd_diag.cli.record import Judged, Records, judge_each, on_records
from hd_diag.config.configuration import JointConfig
from hd_diag.diagnosis.ripple.ripple import Ripple
from hd_diag.diagnosis.ripple.verdict import TITLES, as_json, row, sentence


@verb("ripple joint.mcap --config arm.yaml")
@on_records
@JSON
def ripple(records: Records, json_file: str | None) -> None:
    """Look for lines of the torque, or of a current, at the gear's orders over a turn of the output.

    For robots that report one angle a joint, with a torque or a current: no transmission error can be had of
    it, and no eccentricity. Friction, gravity and inertia are taken off as smooth parts. A line must have the
    same phase in all stretches of the motion, and stand out of the orders beside its own. Several bags are
    recordings of the same joint. A joint that cannot be judged is reported on stderr, the others go on, and
    the exit code is 2.
    """
    check_targets((json_file,), *records.bags)
    tables: dict[str, Ripple] = {}

    def judge(joint: JointConfig) -> Judged:
        with showing() as part:
            part(joint.name)(0, 0, "looking at the torque")
            found = records.ripple(joint, records.motion(joint))
        tables[joint.name] = found
        return as_json(found, joint.name), [sentence(found)], None

    _, complete = judge_each(records, judge, None, json_file)
    for name, found in tables.items() if json_file != "-" else ():
        Console().print(_table(name, found))
    sys.exit(0 if complete else Problem.exit_code)


def _table(name: str, found: Ripple) -> Table:
    table = Table(*TITLES, title=f"{name}: torque over position")
    for line in (*found.lines, *found.others):
        table.add_row(*row(line))
    return table

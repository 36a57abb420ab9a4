"""A ripple in words and in JSON."""

from __future__ import annotations

import math
from typing import Any

from hd_diag.diagnosis.ripple.lines import FALSE_ALARM, Line
from hd_diag.diagnosis.ripple.ripple import Ripple, not_seen
from hd_diag.formatting import json_ready, number, si, spread_number

TITLES = ("per output turn", "amplitude [N m]", "phase", "runs agree", "repeats", "or")
"""Titles of the columns of `row`."""


def as_json(found: Ripple, joint: str) -> dict[str, Any]:
    """Content of `hd-diag ripple --json`: schema ``hd_diag/ripple/1``; SI, orders per turn of the output."""
    content = {
        "schema": "hd_diag/ripple/1",
        "joint": joint,
        "unit": "N m",
        "ratio": found.ratio,
        "record": {
            "windows": found.windows,
            "runs": found.runs,
            "records": found.records,
            "input_turns": found.turns,
            "output_turns": found.reach,
        },
        "false_alarm": FALSE_ALARM,
        "filter": {"corner": found.corner},
        "delay": None if found.delay is None else found.delay._asdict(),
        "lines": [_line(line) for line in found.lines],
        "unseen": [vars(one) for one in found.unseen],
        "others": [_line(line) for line in found.others],
        "verdict": sentence(found),
    }
    return dict(json_ready(content))


def _line(line: Line) -> dict[str, Any]:
    content = {name: value for name, value in vars(line).items() if name not in ("alike", "records")}
    alike = [{"order": order, "reverses": reverses} for order, reverses in line.alike]
    return {**content, "alike": alike, "records": [part._asdict() for part in line.records]}


def sentence(found: Ripple) -> str:
    """Result of the torque's ripple in a few sentences."""
    ratio = number(found.ratio)
    if found.found:
        text = f"The torque ripples with the gear of ratio {ratio}: {_listed(found.found)}."
    else:
        least = max(line.least for line in found.lines)
        text = f"The torque shows no line of a gear of ratio {ratio} above {number(least)} N m."
    if found.others:
        question = "" if found.found else " Is the ratio right?"
        text += f" Lines that are none of its orders: {_listed(found.others)}.{question}"
    hidden = [one for one in found.unseen if one.order not in {line.order for line in found.found}]
    if hidden:
        text += f" {not_seen(hidden)}."
    if any(line.filtered for line in found.found):
        text += f" The torque is filtered at about {found.corner:.2g} Hz: lines that it takes off are larger."
    if found.delay is not None:
        late = "late" if found.delay.value > 0.0 else "early"
        value = spread_number(1e3 * abs(found.delay.value), 1e3 * found.delay.std, "ms")
        text += f" The torque is {value} {late} against the angle; the lines are given without that."
    if found.found and found.runs == 1:
        text += " All of it is one run: a vibration in time would look the same."
    return text


def _listed(lines: tuple[Line, ...]) -> str:
    return ", ".join(
        f"{number(line.order)} per output turn ({'at least ' if line.filtered else ''}"
        f"{si(line.amplitude, line.std, 'N m')}"
        f"{', with the sign of the direction' if line.reverses else ''}"
        f"{', not repeated' if line.repeats is False else ''})"
        for line in lines
    )


def row(line: Line) -> tuple[str, ...]:
    """Cells of a table row, by `TITLES`; for a line that was not found, the detection limit."""
    order = number(line.order) + (", reverses" if line.reverses else "")
    if not line.found:
        return order, f"< {number(line.least, digits=2)}", "", "", "", ""
    repeats = {True: "yes", False: "no", None: "one run"}[line.repeats]
    phase = "another in each" if math.isnan(line.phase) else f"{math.degrees(line.phase):.0f}°"
    alike = (number(other) + (", reverses" if reverses else "") for other, reverses in line.alike)
    return (
        order,
        f"{'≥ ' if line.filtered else ''}{spread_number(line.amplitude, line.std, '')}",
        phase,
        f"{line.agreement:.2f}",
        repeats,
        " or ".join(alike),
    )

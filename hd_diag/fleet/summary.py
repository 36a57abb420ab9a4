"""What a run shows: JSON, and tables and sentences for people."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Sequence
from datetime import datetime, timezone
from typing import Any

from rich.table import Table
from rich.text import Text

from hd_diag.bag import BagError
from hd_diag.fleet.rows import SCHEMA, Row, readable
from hd_diag.fleet.series import ECCENTRICITY
from hd_diag.fleet.steps import FALSE_ALARM, Change
from hd_diag.fleet.trend import CHANGED, Trend
from hd_diag.formatting import ARCSEC, json_ready, words

SHOWN = {"m": (1e-6, "µm"), "rad": (ARCSEC, "arcsec"), "N m": (1.0, "N m")}
"""Size and name of the unit that people read, by the unit inside."""

_MONTH = 30.0 * 86400.0  # [s]


def as_json(out: str, rows: Sequence[Row], trends: Sequence[Trend]) -> dict[str, Any]:
    """What `hd-diag fleet --json` writes, with the table's path: SI, times in ISO 8601 UTC."""
    errors = [row for row in rows if row.get("error")]
    content = {
        "schema": SCHEMA,
        "out": readable(out),
        "bags": len({row["bag"] for row in rows}),
        "rows": len(rows),
        "errors": [{name: readable(row.get(name)) for name in ("bag", "joint", "error")} for row in errors],
        "false_alarm": FALSE_ALARM,
        "trends": [_trend(trend) for trend in trends],
    }
    return dict(json_ready(content))


def _trend(trend: Trend) -> dict[str, Any]:
    series, slope = trend.series, trend.slope
    last = None
    if series.value.size:
        last = {"time": moment(series.time[-1]), "value": series.value[-1], "std": series.std[-1]}
    return {
        "robot": series.robot or None,
        "joint": series.joint,
        "quantity": series.quantity,
        "unit": series.unit,
        "bags": series.value.size,
        "needed": trend.needed,
        "form": trend.form,
        "last": last,
        "steps": {"p_value": trend.step_p, "q_value": trend.step_q},
        "drift": {"p_value": trend.drift_p, "q_value": trend.drift_q},
        "changes": [_change(change) for change in trend.changes],
        "slope": slope
        and {"value": slope.value, "low": slope.low, "high": slope.high, "unit": f"{series.unit}/s"},
        "limit": _limit(trend),
        "statement": statement(trend),
    }


def _change(change: Change) -> dict[str, Any]:
    return {
        "after": moment(change.before),
        "before": moment(change.after),
        "low": moment(change.low),
        "high": moment(change.high),
        "size": {"value": change.size, "low": change.size_low, "high": change.size_high},
        "p_value": change.p_value,
    }


def _limit(trend: Trend) -> dict[str, Any] | None:
    if math.isnan(trend.series.limit):
        return None
    when, low, high = map(moment, trend.crossing or (math.inf,) * 3)
    return {"value": trend.series.limit, "reached": when, "reached_low": low, "reached_high": high}


def moment(time: float) -> str | None:
    """A time [s since 1970] in ISO 8601; None where it is no date."""
    try:
        return datetime.fromtimestamp(time, timezone.utc).isoformat(timespec="seconds")
    except (ValueError, OverflowError, OSError):
        return None


# For people ---


def statement(trend: Trend) -> str:
    """What a series says, in words."""
    if trend.form == "unknown":
        return f"cannot tell yet: needs {trend.needed} bags, has {trend.series.value.size}"
    if trend.form == "steps":
        return "stepped " + "; ".join(_step(trend, change) for change in trend.changes)
    if trend.form == "drift":
        return _drift(trend)
    p = min(trend.step_q, trend.drift_q)
    return f"no step and no trend (p = {p:.2g})"


def _step(trend: Trend, change: Change) -> str:
    scale, unit = SHOWN[trend.series.unit]
    size, low, high = (value / scale for value in (change.size, change.size_low, change.size_high))
    return (
        f"by {size:+.3g} {unit} ({low:.3g} to {high:.3g}) between {_day(change.before)} and "
        f"{_day(change.after)} (95 %: {_day(change.low)} to {_day(change.high)}), p = {change.p_value:.2g}"
    )


def _drift(trend: Trend) -> str:
    slope, (scale, unit) = trend.slope, SHOWN[trend.series.unit]
    assert slope is not None
    rate, low, high = (value * _MONTH / scale for value in (slope.value, slope.low, slope.high))
    text = (
        f"drifts by {rate:+.3g} {unit} ({low:.3g} to {high:.3g}) in 30 days, "
        f"p = {trend.drift_q:.2g} with all series"
    )
    limit = trend.series.limit
    if trend.crossing is None:
        return text if math.isnan(limit) else f"{text}; no date for the limit of {limit / scale:.4g} {unit}"
    when, first, last = trend.crossing
    word = "passed" if when < trend.series.time[-1] else "reaches"
    return (
        f"{text}; {word} the limit of {limit / scale:.4g} {unit} on {_day(when)} "
        f"({_day(first)} to {_day(last)})"
    )


def _day(time: float) -> str:
    text = moment(time)
    return text[:16].replace("T", " ") if text else "never"


def table(rows: Sequence[Row], trends: Sequence[Trend]) -> Table:
    """One line for each joint of each robot."""
    joints: dict[tuple[str, str], list[Row]] = defaultdict(list)
    for row in rows:
        if row.get("joint"):
            joints[row.get("robot") or "", row["joint"]].append(row)
    titles = ["robot", "joint", "bags", "judged", "eccentricity", "causes", "changes"]
    first = 0 if any(robot for robot, _ in joints) else 1  # column
    result = Table(*titles[first:])
    for (robot, joint), own in sorted(joints.items()):
        of_joint = [t for t in trends if (t.series.robot, t.series.joint) == (robot, joint)]
        judged = [row for row in own if not row.get("error")]
        cells = [robot, joint, str(len(own)), str(len(judged))]
        cells += [_eccentricity(of_joint), _all_causes(judged), _changes(of_joint)]
        result.add_row(*map(Text, cells[first:]))
    return result


def _eccentricity(trends: Sequence[Trend]) -> str:
    for trend in trends:
        series = trend.series
        if series.quantity == ECCENTRICITY and series.value.size:
            return f"{series.value[-1] * 1e6:.1f} ± {series.std[-1] * 1e6:.1f} µm"
    return "-"


def _all_causes(rows: Sequence[Row]) -> str:
    counts = Counter(name for row in rows for name in row.get("causes") or [])
    most = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
    return ", ".join(f"{words(name)} ({count})" for name, count in most) or "none"


def _changes(trends: Sequence[Trend]) -> str:
    if changed := [words(t.series.quantity) for t in trends if t.form in CHANGED]:
        return ", ".join(changed)
    unknown = [trend for trend in trends if trend.form == "unknown"]
    return statement(unknown[0]) if unknown else "none" if trends else "-"


def sentences(trends: Sequence[Trend]) -> list[str]:
    """One for each series that changes."""
    return [
        f"{f'{t.series.robot} ' if t.series.robot else ''}{t.series.joint}: "
        f"{words(t.series.quantity)} {statement(t)}"
        for t in trends
        if t.form in CHANGED
    ]


def error_line(row: Row) -> str:
    """A row's error in one line, whatever its bag is called."""
    joint = f"{row['joint']}: " if row.get("joint") else ""
    return str(BagError(row["bag"], f"{joint}{row['error']}"))

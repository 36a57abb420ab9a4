"""Output of a run: JSON, and tables and sentences for people."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from datetime import datetime, timezone
from typing import Any

from rich.box import SIMPLE
from rich.table import Table
from rich.text import Text

from hd_diag.bag import BagError
from hd_diag.diagnosis.action import GREEN, GREY, LIGHTS
from hd_diag.fleet.rows import PAGE, SCHEMA, Row, readable
from hd_diag.fleet.series import ECCENTRICITY, ERROR, began
from hd_diag.fleet.standing import Colour, Health, Standing, left_out, missing
from hd_diag.fleet.trend import FALSE_ALARM, Trend
from hd_diag.formatting import SCALES, json_ready, number, words

_LINES = 24  # joints in a terminal's table, beyond which green ones are left out
_MONTH = 30.0 * 86400.0  # [s]


def as_json(out: str, found: Health) -> dict[str, Any]:
    """Content of `hd-diag fleet --json`; `out` is the table's path. SI units, times in ISO 8601 UTC."""
    rows = found.rows
    content = {
        "schema": SCHEMA,
        "out": readable(out),
        "bags": len({row["bag"] for row in rows}),
        "rows": len(rows),
        "errors": _with(rows, "error"),
        "problems": _with(rows, "problems"),
        "refused": _with(rows, "refused", "last_refusal"),
        "joints": [_joint(one) for one in found.standings],
        "false_alarm": FALSE_ALARM,
        "trends": [_trend(trend) for trend in found.trends],
    }
    return dict(json_ready(content))


def _with(rows: Sequence[Row], *names: str) -> list[dict[str, Any]]:
    """Bag, joint and these columns of the rows in which the first column has a value."""
    shown = "bag", "joint", *names
    return [{name: readable(row.get(name)) for name in shown} for row in rows if row.get(names[0])]


def _joint(one: Standing) -> dict[str, Any]:
    return {
        "robot": one.robot or None,
        "joint": one.joint,
        "state": one.colour.state,
        "since": moment(one.since),
        "recordings": one.count,
        "before": one.before,
        "reasons": one.colour.reasons,
        "limits": [{**each._asdict(), "place": each.place} for each in one.colour.limited],
        "changes": [words(trend.series.quantity) for trend in one.changes],
        "recorded": moment(began(one.row)),
        "bag": readable(one.row["bag"]),
        "page": one.row.get(PAGE),
    }


def _trend(trend: Trend) -> dict[str, Any]:
    series, line = trend.series, trend.line
    last = limit = slope = None
    if series.value.size:
        last = {"time": moment(series.time[-1]), "value": series.value[-1], "std": series.std[-1]}
    if line:
        unit = f"{series.unit}/s"
        slope = {"value": line.slope, "low": line.low_slope, "high": line.high_slope, "unit": unit}
    if not math.isnan(series.limit):
        when, low, high = map(moment, trend.crossing or (math.inf,) * 3)
        limit = {"value": series.limit, "reached": when, "reached_low": low, "reached_high": high}
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
        "changes": [
            {
                "after": moment(change.before),
                "before": moment(change.after),
                "low": moment(change.low),
                "high": moment(change.high),
                "size": {"value": change.size, "low": change.size_low, "high": change.size_high},
                "p_value": change.p_value,
            }
            for change in trend.changes
        ],
        "slope": slope,
        "limit": limit,
        "statement": statement(trend),
    }


def moment(time: float) -> str | None:
    """A time [s since 1970] in ISO 8601; None if it is not a date."""
    try:
        return datetime.fromtimestamp(time, timezone.utc).isoformat(timespec="seconds")
    except (ValueError, OverflowError, OSError):
        return None


# For people ---


def statement(trend: Trend) -> str:
    """A trend in words."""
    if trend.form == "unknown":
        return f"cannot tell yet: needs {trend.needed} bags, has {trend.series.value.size}"
    if trend.form == "constant":
        return f"no step and no trend (p = {min(trend.step_q, trend.drift_q):.2g})"
    return _steps(trend) if trend.form == "steps" else _drift(trend)


def _steps(trend: Trend) -> str:
    scale, unit = SCALES[trend.series.unit]
    told = []
    for change in trend.changes:
        size, low, high = (value / scale for value in (change.size, change.size_low, change.size_high))
        told.append(
            f"by {size:+.3g} {unit} ({low:.3g} to {high:.3g}) between {day(change.before)} and "
            f"{day(change.after)} (95 %: {day(change.low)} to {day(change.high)}), p = {change.p_value:.2g}"
        )
    return f"stepped {'; '.join(told)}"


def _drift(trend: Trend) -> str:
    line, (scale, unit) = trend.line, SCALES[trend.series.unit]
    rate, low, high = (v * _MONTH / scale for v in (line.slope, line.low_slope, line.high_slope))
    text = (
        f"drifts by {rate:+.3g} {unit} ({low:.3g} to {high:.3g}) in 30 days, "
        f"p = {trend.drift_q:.2g} with all series"
    )
    if math.isnan(trend.series.limit):
        return text
    limit = f"the limit of {trend.series.limit / scale:.4g} {unit}"
    if trend.crossing is None:
        return f"{text}; no date for {limit}"
    when, first, last = trend.crossing
    word = "passed" if when < trend.series.time[-1] else "reaches"
    return f"{text}; {word} {limit} on {day(when)} ({day(first)} to {day(last)})"


def day(time: float) -> str:
    """A time [s since 1970] to the minute, UTC; "never" if it is not a date."""
    text = moment(time)
    return text[:16].replace("T", " ") if text else "never"


def headline(found: Health) -> str:
    """Numbers of joints by state, of those that changed, and of unusable or incomplete bags."""
    standings, rows = found.standings, [found.rows[n] for n in found.attention[0]]
    if not standings:
        return "No joint was found in any recording."
    counts = Counter(one.colour.state for one in standings)
    states = ", ".join(f"{counts[state]} {words(state)}" for state in LIGHTS if counts[state])
    changed = sum(bool(one.changes) for one in standings)
    unknown = [trend for trend in found.trends if trend.form == "unknown"]
    over_time = f"{changed or 'None'} changed over time"
    if unknown and not changed:
        over_time = f"Changes over time: {statement(max(unknown, key=lambda t: t.series.value.size))}"
    lost = {
        "without a joint that could be judged": {row["bag"] for row in rows if not row.get("joint")},
        "cut off": {row["bag"] for row in rows if missing(row)},
        "with samples left out": {row["bag"] for row in rows if left_out(row)},
    }
    bags = ", ".join(f"{len(bags)} {what}" for what, bags in lost.items() if bags)
    total = f"{len(standings)} joint{'s' * (len(standings) > 1)}"
    return f"Of {total}: {states}. {over_time}.{f' Of the bags: {bags}.' if bags else ''}"


def notes(found: Health) -> list[str]:
    """Doubts about the whole run: recordings of one joint at the same time."""
    pairs = found.overlapping
    if not pairs:
        return []
    more = f", and {len(pairs) - 1} more pairs" if len(pairs) > 1 else ""
    first, second = (readable(row["bag"]) for row in pairs[0])
    return [
        f"recorded at the same time: one joint in {first} and {second}{more}. Are they of several robots? "
        "--robot distinguishes them; now they count as one."
    ]


def recorded(row: Row) -> str:
    """When a row's recording began, in words."""
    return "date unknown" if row.get("start") is None else f"recorded {day(began(row))}"


def table(found: Health) -> Table:
    """One line for each joint of each robot, the worst first; beyond `_LINES` green ones are left out."""
    shown = [one for n, one in enumerate(found.standings) if n < _LINES or one.colour.state != GREEN]
    titles = ["robot", "joint", "state", "recorded", "error\narcsec", "eccentr.\nµm", "bags", "what"]
    first = 0 if any(one.robot for one in shown) else 1  # column
    left = len(found.standings) - len(shown)
    caption = f"and {left} more green" if left else None
    result = Table(caption=caption, box=SIMPLE, padding=(0, 1, 0, 0), caption_justify="left")
    for title in titles[first:]:
        result.add_column(title, no_wrap=title in ("state", "recorded", "bags"))
    for one in shown:
        name = one.robot, one.joint
        own = [row for row in found.rows if (row.get("robot") or "", row.get("joint")) == name]
        judged = sum(not row.get("error") for row in own)
        bags = str(judged) if judged == len(own) else f"{judged} of {len(own)}"
        date = recorded(one.row).removeprefix("recorded ")[:10]
        sizes = _last(one, ERROR), _last(one, ECCENTRICITY)
        cells = (*name, words(one.colour.state), date, *sizes, bags, _what(one, own))
        result.add_row(*map(Text, cells[first:]))
    return result


def _last(one: Standing, quantity: str) -> str:
    """The last recording's value, and its limit if it has one, without the unit."""
    for trend in one.trends:
        series, at = trend.series, began(one.row)
        if series.quantity == quantity and at in series.time:
            scale = SCALES[series.unit][0]
            limits = [each.limit for each in one.colour.limited if each.quantity == quantity]
            return " of ".join(number(value / scale) for value in (float(series.value[-1]), *limits))
    return "-"


def _what(one: Standing, rows: Sequence[Row]) -> str:
    """Causes with their numbers of bags, and the quantities that change."""
    counts = Counter(name for row in rows for name in row.get("causes") or [])
    most = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
    parts = [f"{words(name)} ({count})" for name, count in most]
    parts += [f"{words(trend.series.quantity)} changes" for trend in one.changes]
    return ", ".join(parts) or "-"


def sentences(trends: Sequence[Trend]) -> list[str]:
    """A sentence for each series that changes."""
    return [
        f"{f'{t.series.robot} {t.series.joint}'.strip()}: {words(t.series.quantity)} {statement(t)}"
        for t in trends
        if t.changed
    ]


def attention_lines(row: Row, colour: Colour) -> list[str]:
    """Why a row is not judged, what is cut off or refused: a line each, whatever the bag's name."""
    joint = f"{row['joint']}: " if row.get("joint") else ""
    date = f" ({recorded(row)})" if row.get("start") is not None else ""
    parts = [("cut off", problem) for problem in missing(row)] + [("refused", each) for each in left_out(row)]
    if colour.state == GREY:
        parts.insert(0, ("not judged", colour.reasons[0]))
    return [f"{what}: {BagError(row['bag'], f'{joint}{text}')}{date}" for what, text in parts]

"""The weekly page of a fleet: a row per joint, the worst first; no network, no script, no picture to load."""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Sequence
from importlib.resources import files
from typing import NamedTuple
from urllib.parse import quote

import numpy as np

from hd_diag.diagnosis.action import GREEN, LIGHTS
from hd_diag.fleet.rows import readable
from hd_diag.fleet.series import ECCENTRICITY, ERROR
from hd_diag.fleet.standing import Health, Standing, natural
from hd_diag.fleet.summary import day, headline, notes, recorded, statement
from hd_diag.formatting import si, size, words
from hd_diag.report.facts import Fact, versions

_SIGNS = {"red": "✕", "amber": "!", "green": "✓", "not_judged": "?"}
_STALE = 8.0  # lag behind the fleet's newest recording above which a row says so [days]
_WIDTH, _HEIGHT, _EDGE = 132.0, 40.0, 4.0  # of a small trend
_TOP = 2.0  # highest end of its axis over the limit; larger values are drawn there
_LEAST_TOP = 1.25


class Small(NamedTuple):
    """A small trend: dots with their states, the line through them, the limit if any, and what it shows."""

    dots: list[tuple[float, float, str]]
    line: str
    limit: float | None
    about: str


def health_page(found: Health, facts: Sequence[Fact]) -> str:
    """HTML of the page; `facts` say how it was made."""
    from hd_diag.report.page import rendered  # imported late: matplotlib takes its time

    rows, colours, standings = found.rows, found.colours, found.standings
    names = sorted({one.robot for one in standings}, key=natural)
    numbered = sorted(enumerate(standings), key=lambda pair: natural(pair[1].joint))
    times = [time for one in standings for time, _ in one.history if not math.isnan(time)]
    ends = (min(times), max(times)) if times else None
    counts = Counter(one.colour.state for one in standings)
    present, past = ([(rows[n], colours[n]) for n in numbers] for numbers in found.attention)
    style = (files("hd_diag.report") / "templates/fleet.css").read_text(encoding="utf-8")
    return rendered(
        "fleet.html.jinja",
        styles=style + _filters(len(names)),
        title="Harmonic drives: how each joint stands",
        headline=headline(found),
        notes=notes(found),
        prefix=_prefix({one.joint for one in standings}),
        dates=tuple(map(day, ends)) if ends else None,
        bags=len({row["bag"] for row in rows}),
        present=present,
        past=past,
        standings=standings,
        names=names,
        robots=[(name, [pair for pair in numbered if pair[1].robot == name]) for name in names],
        counts=[(state, counts[state]) for state in LIGHTS if counts[state]],
        changed=sum(bool(one.changes) for one in standings),
        signs=_SIGNS,
        beside=_beside,
        small=lambda one: _small(one, ends),
        days_behind=lambda one: (ends[1] - one.history[-1][0]) / 86400.0 if ends else 0.0,
        stale=_STALE,
        quote=quote,
        day=day,
        statement=statement,
        recorded=recorded,
        facts=(*facts, *versions()),
        readable=readable,
        width=_WIDTH,
        height=_HEIGHT,
        error=ERROR,
        eccentricity=ECCENTRICITY,
    )


def _prefix(joints: set[str]) -> str:
    """Common beginning of all names, without final digits; empty if it is the whole of a name."""
    prefix = os.path.commonprefix(list(joints)).rstrip("0123456789") if len(joints) > 1 else ""
    return "" if prefix in joints else prefix


def _beside(one: Standing, quantity: str) -> tuple[str, str, str] | None:
    """A quantity's value, its limit and the limit's criterion in words; None if the quantity has no limit."""
    found = next((each for each in one.colour.limited if each.quantity == quantity), None)
    if found is None:
        return None
    # A limit given by the user has no criterion.
    own = quantity == ECCENTRICITY and found.limit == one.row.get("eccentricity_allowed_m")
    criterion = words(one.row["eccentricity_criterion"] or "") if own else ""
    return si(found.value, found.std, found.unit), size(found.limit, found.unit), criterion


def _small(one: Standing, ends: tuple[float, float] | None) -> Small | None:
    """Trend of the quantity nearest to its limit, over all recordings; without limits the first series."""
    nearest = one.nearest
    known = [trend.series for trend in one.trends if trend.series.value.size]
    series = next((s for s in known if not nearest or s.quantity == nearest.quantity), None)
    if series is None or ends is None:
        return None
    share = series.value / (nearest.limit if nearest else max(series.value.max(), 1e-300))
    top = min(max(1.1 * float(share.max()), _LEAST_TOP), _TOP)
    across = (_WIDTH - 2.0 * _EDGE) * (series.time - ends[0]) / max(ends[1] - ends[0], 1.0)
    up = (_HEIGHT - 2.0 * _EDGE) * np.minimum(share, top) / top
    x, y = np.round(_EDGE + across, 1).tolist(), np.round(_HEIGHT - _EDGE - up, 1).tolist()
    states = dict(one.history)
    dots = list(zip(x, y, (states.get(time, GREEN) for time in series.time.tolist()), strict=True))
    first, last = (size(float(series.value[n]), series.unit) for n in (0, -1))
    about = (
        f"{words(series.quantity)}, {len(dots)} recordings, {day(series.time[0])} to {day(series.time[-1])}: "
        f"{first} to {last}" + (f"; the limit is {size(nearest.limit, nearest.unit)}" if nearest else "")
    )
    level = round(_HEIGHT - _EDGE - (_HEIGHT - 2.0 * _EDGE) / top, 1) if nearest else None
    return Small(dots, " ".join(f"{x},{y}" for x, y, _ in dots), level, about)


def _filters(robots: int) -> str:
    """Style rules by which the page's choices hide rows."""
    hidden = {f"show-{state}": f":not(.{state})" for state in LIGHTS}
    hidden |= {"show-look": ".green", "show-changed": ":not(.changed)"}
    hidden |= {f"robot-{n}": f":not(.robot-{n})" for n in range(robots)}
    return "".join(
        f"body:has(#{choice}:checked) .joints tbody tr{rows}:not(:target) {{ display: none; }}\n"
        for choice, rows in hidden.items()
    )

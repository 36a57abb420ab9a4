"""The weekly page of a fleet: a row a joint, the worst first; no network, no script, no picture to load."""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import NamedTuple
from urllib.parse import quote

import numpy as np

from hd_diag.diagnosis.judgement import Limited
from hd_diag.fleet.rows import PAGE, readable
from hd_diag.fleet.series import ECCENTRICITY, ERROR
from hd_diag.fleet.standing import Health, Standing, natural
from hd_diag.fleet.summary import day, headline, notes, recorded, statement
from hd_diag.formatting import si, size, words
from hd_diag.report.facts import Fact, versions
from hd_diag.report.limits import GREEN, STATES

SIGNS = {"red": "✕", "amber": "!", "green": "✓", "not_judged": "?"}
_STALE = 8.0 * 86400.0  # behind the newest recording of the fleet, from which a row says so [s]
_WIDTH, _HEIGHT, _EDGE = 132.0, 40.0, 4.0  # of a small trend
_TOP = 2.0  # of its axis, in limits; what is larger is drawn there
_LEAST_TOP = 1.25


class Small(NamedTuple):
    """A small trend: dots with their states, the line through them, the limit if any, and what it shows."""

    dots: list[tuple[float, float, str]]
    line: str
    limit: float | None
    about: str


@dataclass(frozen=True)
class PageRow:
    """A row of the page."""

    standing: Standing
    robot: int
    trend: Small | None
    link: str | None
    age: str

    def value(self, quantity: str) -> tuple[str, str] | None:
        """A quantity's value and limit in words; None where it is not known."""
        for one in self.standing.colour.limited:
            if quantity in one.quantity.split(" or "):
                return si(one.value, one.std, one.unit), size(one.limit, one.unit)
        return None

    @property
    def criterion(self) -> str | None:
        """By which criterion the eccentricity has its limit; None where a user gave it."""
        row = self.standing.row
        own = [one.limit for one in self.standing.colour.limited if one.quantity == ECCENTRICITY]
        return row.get("eccentricity_criterion") if own == [row.get("eccentricity_allowed_m")] else None

    @property
    def others(self) -> tuple[Limited, ...]:
        """What has a limit beside error and eccentricity."""
        return tuple(o for o in self.standing.colour.limited if o.quantity not in (ERROR, ECCENTRICITY))

    @property
    def since(self) -> str:
        """Since when it has its state, in words."""
        one = self.standing
        if math.isnan(one.since):
            return ""
        times = f"{one.count} recording{'s' * (one.count > 1)}"
        before = f", before that {words(one.before)}" if one.before else ""
        return f"since {day(one.since)[:10]} ({times}{before})"


def health_page(found: Health, facts: Sequence[Fact]) -> str:
    """HTML of the page; `facts` say how it was made."""
    from hd_diag.report.page import rendered  # here, because matplotlib takes its time

    rows, colours, standings = found.rows, found.colours, found.standings
    robots = sorted({one.robot for one in standings}, key=natural)
    times = [time for one in standings for time, _ in one.history if not math.isnan(time)]
    ends = (min(times), max(times)) if times else None
    lines = [_line(one, robots.index(one.robot), ends) for one in standings]
    present, past = found.attention
    counts = Counter(one.colour.state for one in standings)
    style = (files("hd_diag.report") / "templates/fleet.css").read_text(encoding="utf-8")
    return rendered(
        "fleet.html.jinja",
        styles=style + _filters(len(robots)),
        title="Harmonic drives: how each joint stands",
        headline=headline(found),
        notes=notes(found),
        prefix=_prefix({one.joint for one in standings}),
        dates=tuple(map(day, ends)) if ends else None,
        bags=len({row["bag"] for row in rows}),
        present=[(rows[n], colours[n]) for n in present],
        past=[(rows[n], colours[n]) for n in past],
        lines=lines,
        robots=[
            (name, sorted((one for one in lines if one.robot == n), key=lambda o: natural(o.standing.joint)))
            for n, name in enumerate(robots)
        ],
        counts=[(state, counts[state]) for state in STATES if counts[state]],
        changed=sum(bool(one.changes) for one in standings),
        signs=SIGNS,
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
    """What all names begin with, but for their numbers; empty where one would have no name without it."""
    prefix = os.path.commonprefix(list(joints)).rstrip("0123456789") if len(joints) > 1 else ""
    return "" if prefix in joints else prefix


def _line(one: Standing, robot: int, ends: tuple[float, float] | None) -> PageRow:
    behind = ends[1] - one.history[-1][0] if ends else 0.0
    age = f"{behind / 86400.0:.0f} days before the newest recording" if behind > _STALE else ""
    link = one.row.get(PAGE)
    return PageRow(one, robot, _small(one, ends), quote(link) if link else None, age)


def _small(one: Standing, ends: tuple[float, float] | None) -> Small | None:
    """What comes nearest to its limit, over all recordings; without limits the first series."""
    nearest = one.nearest
    wanted = [
        t.series
        for t in one.trends
        if t.series.value.size and (not nearest or t.series.quantity == nearest.quantity)
    ]
    if not wanted or ends is None:
        return None
    series = wanted[0]
    limit = nearest.limit if nearest else float(max(series.value.max(), 1e-300))
    share = series.value / limit
    top = min(max(1.1 * float(share.max()), _LEAST_TOP), _TOP)
    states = dict(one.history)
    across = (_WIDTH - 2.0 * _EDGE) * (series.time - ends[0]) / max(ends[1] - ends[0], 1.0)
    up = (_HEIGHT - 2.0 * _EDGE) * np.minimum(share, top) / top
    places = zip((_EDGE + across).tolist(), (_HEIGHT - _EDGE - up).tolist(), strict=True)
    dots = [
        (round(x, 1), round(y, 1), states.get(time, GREEN))
        for (x, y), time in zip(places, series.time.tolist(), strict=True)
    ]
    about = (
        f"{words(series.quantity)}, {len(dots)} recordings, {day(series.time[0])} to {day(series.time[-1])}: "
        f"{size(float(series.value[0]), series.unit)} to {size(float(series.value[-1]), series.unit)}"
        + (f"; the limit is {size(nearest.limit, nearest.unit)}" if nearest else "")
    )
    line = " ".join(f"{x},{y}" for x, y, _ in dots)
    level = round(_HEIGHT - _EDGE - (_HEIGHT - 2.0 * _EDGE) / top, 1) if nearest else None
    return Small(dots, line, level, about)


def _filters(robots: int) -> str:
    """Rules by which the choices of the page hide rows."""
    chosen = [f"body:has(#show-{state}:checked) .joints tbody tr:not(.{state})" for state in STATES]
    chosen += ["body:has(#show-look:checked) .joints tbody tr.green"]
    chosen += ["body:has(#show-changed:checked) .joints tbody tr:not(.changed)"]
    chosen += [f"body:has(#robot-{n}:checked) .joints tbody tr:not(.robot-{n})" for n in range(robots)]
    return "".join(f"{rule}:not(:target) {{ display: none; }}\n" for rule in chosen)

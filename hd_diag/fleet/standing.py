"""How each joint stands: the colour of its last recording, the limits behind it, since when, and changes.

The colour of a recording is the traffic light of the joint's own page (`hd_diag.diagnosis.action`). It is
worse only for reasons that this page does not know:

* ``red``: the whole 95 % interval of a quantity is beyond a limit that the user gives.
* ``amber``: the interval holds such a limit, or the recording is cut off, lacks the joint for more than half
  of its time, or has more than a twentieth of its samples refused.

A joint with one angle has no light: limits of its ripple decide; without a limit it is ``not_judged``.
"""

from __future__ import annotations

import itertools
import math
import re
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import NamedTuple

import numpy as np

from hd_diag.diagnosis.action import AMBER, GREEN, GREY, LIGHTS, RED
from hd_diag.diagnosis.judgement import Limited
from hd_diag.fleet.rows import Row
from hd_diag.fleet.series import ECCENTRICITY, ERROR, Limits, Series, began, limit_of
from hd_diag.fleet.trend import Trend
from hd_diag.formatting import si, size, words

_COVERED = 0.5  # least share of a bag with samples of a joint: drivers may start late, or stop early
_REFUSED = 0.05  # share of refused samples that changes the colour; fewer are in the verdict only
_NO_LIGHT = "it was not judged"
_ONE_ANGLE = "one angle alone: no transmission error, only lines of the torque"


class Colour(NamedTuple):
    """State of a recording, why it is not green, and what was compared."""

    state: str
    reasons: tuple[str, ...]
    limited: tuple[Limited, ...]


@dataclass(frozen=True)
class Standing:
    """A joint of a robot.

    `row` and `colour` are those of its last recording. It has had that state `since` a time [s since 1970,
    nan: not known], in `count` recordings without another state between (except for those not judged);
    `before` is the state before. `history` has times and states of all recordings in time order.
    """

    robot: str
    joint: str
    row: Row
    colour: Colour
    since: float
    count: int
    before: str | None
    history: tuple[tuple[float, str], ...]
    trends: tuple[Trend, ...]

    @property
    def changes(self) -> tuple[Trend, ...]:
        """The trends that step or drift."""
        return tuple(trend for trend in self.trends if trend.changed)

    @property
    def nearest(self) -> Limited | None:
        """The quantity nearest to its limit, or farthest beyond; None without limits."""
        return max(self.colour.limited, key=lambda one: one.value / one.limit, default=None)


@dataclass(frozen=True)
class Health:
    """A run's rows, each with its colour, its trends, and how each joint stands, the worst first."""

    rows: Sequence[Row]
    colours: Sequence[Colour]
    trends: Sequence[Trend]
    standings: Sequence[Standing]

    def fails(self, least: str) -> bool:
        """Whether a joint is ``red``; for ``amber``: is not green, or a bag was not judged or is cut off."""
        if least == RED:
            return any(one.colour.state == RED for one in self.standings)
        return any(one.colour.state != GREEN for one in self.standings) or bool(self.attention[0])

    @property
    def attention(self) -> tuple[list[int], list[int]]:
        """Indices of rows that were not judged or are incomplete: those that still matter, and older ones.

        Older ones are followed by a recording of the same joint or, if a bag has no usable joint, of the same
        robot.
        """
        last: dict[tuple[str | None, str | None], int] = {}
        for row in self.rows:
            for joint in (row.get("joint"), None) if row.get("joint") else ():
                key = row.get("robot"), joint
                last[key] = max(last.get(key, 0), row.get("start") or 0)
        found: tuple[list[int], list[int]] = [], []
        for place, (row, colour) in enumerate(zip(self.rows, self.colours, strict=True)):
            if colour.state == GREY or missing(row) or left_out(row):
                start, newest = row.get("start"), last.get((row.get("robot"), row.get("joint")), 0)
                found[start is not None and start < newest].append(place)
        return found

    @property
    def overlapping(self) -> list[tuple[Row, Row]]:
        """Pairs of rows of one joint that were recorded at the same time, except for copies of a bag."""
        known = [row for row in self.rows if row.get("joint") and row.get("start") is not None]
        return [
            (one, other)
            for one, other in itertools.pairwise(sorted(known, key=lambda row: (_joint(row), row["start"])))
            if _joint(one) == _joint(other)
            and one.get("bag_sha256") != other.get("bag_sha256")
            and other["start"] < one["start"] + 1e9 * (one.get("duration_s") or 0.0)
        ]


def limits_of(rows: Iterable[Row]) -> dict[tuple[str, str], float]:
    """Limits in the rows themselves: accuracy, and the eccentricity that the assembly may have."""
    columns = ((ERROR, "accuracy_rad"), (ECCENTRICITY, "eccentricity_allowed_m"))
    return {
        (row["joint"], quantity): row[column]
        for row in rows
        for quantity, column in columns
        if row.get(column) is not None
    }


def health(rows: Sequence[Row], trends: Sequence[Trend], limits: Limits) -> Health:
    """Rows and trends of a run judged by limits; the rows get the column ``state``."""
    of_joint: dict[tuple[str, str], list[Trend]] = defaultdict(list)
    for trend in trends:
        of_joint[trend.series.robot, trend.series.joint].append(trend)
    colours = [_colour(row, [trend.series for trend in of_joint[_joint(row)]], limits) for row in rows]
    judged = [{**row, "state": colour.state} for row, colour in zip(rows, colours, strict=True)]
    recordings: dict[tuple[str, str], list[tuple[Row, Colour]]] = defaultdict(list)
    for row, colour in zip(judged, colours, strict=True):
        if row.get("joint"):
            recordings[_joint(row)].append((row, colour))
    standings = [_standing(joint, own, of_joint[joint]) for joint, own in recordings.items()]
    return Health(judged, colours, trends, sorted(standings, key=_order))


def _joint(row: Row) -> tuple[str, str]:
    return row.get("robot") or "", row.get("joint") or ""


def _colour(row: Row, series: Sequence[Series], limits: Limits) -> Colour:
    """The joint's light, made worse by a limit or an incomplete bag."""
    cut = (*missing(row), *left_out(row))
    if row.get("error"):
        return Colour(GREY, (row["error"], *cut), ())
    limited = tuple(one for each in series if (one := _limited(row, each, limits)))
    light, advice = row.get("light") or GREY, row.get("advice") or _NO_LIGHT
    if row.get("ripple_orders"):
        light, advice = GREEN if limited else GREY, _ONE_ANGLE
    beside = [told for one in limited if (told := _beside(one))]
    state = min([light, *(colour for colour, _ in beside), *[AMBER] * bool(cut)], key=LIGHTS.index)
    own = [advice.removesuffix(".")] if state == light != GREEN else []
    return Colour(state, (*(own or [text for colour, text in beside if colour == state]), *cut), limited)


def _beside(one: Limited) -> tuple[str, str] | None:
    """Colour and reason of a value that is not within its limit; None if it is."""
    limit, value = f"its limit of {size(one.limit, one.unit)}", si(one.value, one.std, one.unit)
    if one.place == "beyond":
        return RED, f"{words(one.quantity)} {value}, beyond {limit}"
    return (
        (AMBER, f"{words(one.quantity)} {value}, too near to {limit} to judge")
        if one.place == "near"
        else None
    )


def missing(row: Row) -> list[str]:
    """Sentences on what is unfinished about a row's bag, or missing of the joint in it."""
    name, own = PurePath(row["bag"]).name, [problem.split(": ", 1) for problem in row.get("problems") or []]
    reasons = [" ".join(("the bag" if parts[0] == name else parts[0], *parts[1:])) for parts in own]
    judged, whole = row.get("duration_s"), row.get("bag_duration_s") or 0.0
    if judged is not None and judged < _COVERED * whole:
        reasons.append(f"only {judged:.0f} of the bag's {whole:.0f} s hold this joint")
    return reasons


def left_out(row: Row) -> list[str]:
    """A sentence if more than `_REFUSED` of a row's samples were refused."""
    refused = row.get("refused") or 0
    whole = refused + (row.get("samples") or 0)
    text = f"{refused} of {whole} samples are left out, the last because: {row.get('last_refusal')}"
    return [text] if refused > _REFUSED * whole else []


def _limited(row: Row, series: Series, limits: Limits) -> Limited | None:
    """A series' value in a row with its limit; None if either is missing."""
    limit, at = limit_of(limits, series.joint, series.quantity), np.flatnonzero(series.time == began(row))
    if math.isnan(limit) or not at.size:
        return None
    # The deviation from a model that does not describe the record says nothing about the gear.
    unsure = series.quantity == ECCENTRICITY and row.get("judgement") == "misfit"
    std = math.nan if unsure else float(series.std[at[-1]])
    return Limited(series.quantity, float(series.value[at[-1]]), std, limit, series.unit)


def _standing(joint: tuple[str, str], own: Sequence[tuple[Row, Colour]], trends: Sequence[Trend]) -> Standing:
    own = sorted(own, key=lambda one: one[0].get("start") or 0)
    history = tuple((began(row), colour.state) for row, colour in own)
    row, colour = own[-1]
    known = [one for one in history if colour.state == GREY or one[1] != GREY]
    count = next((n for n, (_, state) in enumerate(reversed(known)) if state != colour.state), len(known))
    before = known[-count - 1][1] if count < len(known) else None
    return Standing(*joint, row, colour, known[-count][0], count, before, history, tuple(trends))


def _order(one: Standing) -> tuple[int, bool, float, list[object], list[object]]:
    """Sort key: the worst first, then those that changed, then the nearest to a limit."""
    worst = one.nearest.value / one.nearest.limit if one.nearest else 0.0
    return LIGHTS.index(one.colour.state), not one.changes, -worst, natural(one.robot), natural(one.joint)


def natural(name: str) -> list[object]:
    """A key that sorts robot_2 before robot_10."""
    return [(0, int(part), "") if part.isdigit() else (1, 0, part) for part in re.split(r"(\d+)", name)]

"""Checks that come before any fit: a wrong ratio, swapped joints, steps between the encoders."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.diagnosis.blocks import blocks
from hd_diag.diagnosis.noise import bounds
from hd_diag.diagnosis.record import Record, encoder_bits
from hd_diag.diagnosis.regression import centered

_FOLLOWS = 0.3  # largest deviation over the output's travel, rms
_RATIO_MISS = 2e-3  # relative; no transmission error is as large over a turn
_STEP, _WIDTH = 0.25, 15  # least step, in tooth pitches, over so many rows
_WHOLE = 0.05  # tolerance of a step of whole teeth [tooth pitches]
_MOST_STEPS = 20  # the search for steps ends beyond this number
_DEGREES = math.degrees(1.0)

Torsion = Callable[[Floats, Floats], Floats]


@dataclass(frozen=True)
class Finding:
    """A finding before any fit: catalogue name, one sentence, value, unit; if fatal, the diagnosis ends."""

    name: str
    text: str
    value: float
    unit: str
    fatal: bool


def check_ratio(record: Record, ratio: float) -> Finding | None:
    """A finding if the output does not follow the input at the configured ratio [-], apart from torsion."""
    slope = _usual_slope(record)
    if not follows(record, slope, _FOLLOWS):
        text = "the output does not follow the input at any fixed ratio: are the joints' names swapped?"
        return Finding("ratio_error", text, math.nan, "-", True)
    # The error itself may have a slope of its own size over the range.
    reach = float(np.ptp(centered(record.output_angle, record.run)))
    off = abs(slope * ratio - 1.0) > max(_RATIO_MISS, 0.02 / max(reach, 1e-9))
    return wrong_ratio(1.0 / slope, ratio) if off else None


def follows(record: Record, slope: float, share: float) -> bool:
    """Whether the output is the input times a slope [-] plus an offset per run, to a share of its rms."""
    angle, output = (centered(column, record.run) for column in (record.input_angle, record.output_angle))
    return float(np.std(output - slope * angle)) <= share * float(np.std(output))


def wrong_ratio(found: float, configured: float) -> Finding:
    """The finding that the ratio [-] differs from the configured one."""
    check = "check the ratio, its sign, a belt that was not declared, or swapped joints"
    text = f"the output follows the input at a ratio of {found:.6g}, not the configured {configured:g}: "
    return Finding("ratio_error", text + (_unit_of(found, configured) or check), found, "-", True)


def _unit_of(found: float, configured: float) -> str:
    """Wrong unit that explains a ratio off by a known factor, in words; empty for other ratios."""
    factor = abs(found / configured)
    for value, name in ((_DEGREES, "input"), (1.0 / _DEGREES, "output")):
        if abs(factor / value - 1.0) < 0.02:
            return f"the {name} angle is in degrees: {declared(name, 'deg')}"
    for times, name in ((factor, "input"), (1.0 / max(factor, 1e-300), "output")):
        if bits := encoder_bits(times):
            unit = declared(name, f"counts/{2**bits}")
            return f"the {name} angle is in counts of {bits} bits a turn: {unit}"
    return ""


def declared(role: str, unit: str) -> str:
    """What the user writes for a signal that is not in SI, for a table column and for a topic."""
    owner = "input" if role == "input" else f"{role}_signal"
    return f"write {role}=COLUMN[{unit}] in --columns, or unit: {unit} under the joint's {owner}"


def _usual_slope(record: Record) -> float:
    """Output over input [-]: median over short stretches, weighted by travel, so steps do not affect it.

    Stretches are no longer than half a usual run. The result is nan if nothing moves within a run.
    """
    usual_run = int(np.median(np.bincount(record.run)[record.run]))
    lag = max(min(record.size // 400, usual_run // 2), 1)
    same = record.run[lag:] == record.run[:-lag]
    angle, output = (
        (column[lag:] - column[:-lag])[same][::lag] for column in (record.input_angle, record.output_angle)
    )
    moved = np.abs(angle) > 1e-9
    if not moved.any():
        return math.nan
    slope, way = output[moved] / angle[moved], np.abs(angle[moved])
    order = np.argsort(slope)
    half = np.searchsorted(np.cumsum(way[order]), 0.5 * way.sum())
    return float(slope[order][min(int(half), order.size - 1)])


def find_steps(
    record: Record, ratio: float, tooth_pitch: float, torsion: Torsion | None = None
) -> tuple[Floats, list[Finding]]:
    """Steps of the error: skipped teeth or lost encoder counts.

    Parameters
    ----------
    record : Record
    ratio : float
    tooth_pitch : float
        Angle by which the flexspline turns when it skips a tooth [rad]: one of its own pitches.
    torsion : callable, optional
        The error of a drive [rad] at input angles [rad] and torques [N m], (n,) each. It corrects for the
        spring-back when the torque drops as teeth skip.

    Returns
    -------
    correction : ndarray, shape (n,)
        Steps to subtract from the output angle [rad].
    findings : list of Finding
    """
    error = record.output_angle - record.input_angle / ratio
    correction, findings, least = np.zeros(record.size), list[Finding](), _STEP * tooth_pitch
    for begin, end in bounds(record.run):
        part = error[begin:end]
        while part.size >= 4 * _WIDTH and len(findings) <= _MOST_STEPS:
            jump, at = _largest_jump(part)
            if jump <= least:
                break
            inner = part[at - _WIDTH : at + 1]
            place = at - _WIDTH + int(np.argmax(np.abs(np.diff(inner)))) + 1
            first = max(place - _WIDTH, 0)
            near, rows = part[first : place + _WIDTH], slice(begin + first, begin + place + _WIDTH)
            if torsion is not None:
                twist = torsion(record.input_angle[rows], record.torque[rows])
                near = near - np.nan_to_num(twist)[: near.size]
            before, after = near[: place - first], near[place - first :]
            size = float(np.median(after) - np.median(before))
            if abs(size) < least:
                break
            teeth = round(size / tooth_pitch)
            whole = teeth != 0 and abs(size / tooth_pitch - teeth) < _WHOLE
            exact = teeth * tooth_pitch if whole else size  # the same flanks meet after whole teeth
            correction[begin + place :] += exact
            part[place:] -= exact
            error[end:] -= exact
            findings.append(_step(size, teeth if whole else 0, float(record.time[begin + place])))
    return correction, findings


def _largest_jump(values: Floats) -> tuple[float, int]:
    """Largest change over `_WIDTH` rows [rad], and the row where it ends."""
    found = []
    for rows, _, _ in blocks(_WIDTH, values.size):
        jump = np.abs(values[rows] - values[rows.start - _WIDTH : rows.stop - _WIDTH])
        found.append((float(np.max(jump)), rows.start + int(np.argmax(jump))))
    return max(found, key=lambda one: one[0])


def _step(size: float, teeth: int, time: float) -> Finding:
    what = "encoder counts lost, or a hub slipped: no whole tooth"
    if teeth:
        what = f"{teeth} {'tooth' if abs(teeth) == 1 else 'teeth'} skipped"
    text = f"a step of {np.degrees(size) * 3600:.0f} arcsec at {time:.3f} s: {what}"
    return Finding("tooth_skip", text, size, "rad", False)

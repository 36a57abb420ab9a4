"""What must be said before anything else: a wrong ratio, swapped joints, steps between the encoders."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hd_diag.criticism.noise import bounds
from hd_diag.criticism.record import Record

Floats = npt.NDArray[np.float64]

_RATIO_MISS = 2e-3  # relative; more than any transmission error can make of a turn
_STEP = 0.25  # of a tooth pitch


@dataclass(frozen=True)
class Finding:
    """A finding that comes before the model: catalogue name, one sentence, value and unit."""

    name: str
    text: str
    value: float
    unit: str
    fatal: bool


def check_ratio(record: Record, ratio: float) -> Finding | None:
    """Whether the output follows the input at the configured ratio.

    Parameters
    ----------
    record : Record
    ratio : float
        Configured [-].

    Returns
    -------
    Finding or None
    """
    angle = record.input_angle - record.input_angle.mean()
    output = record.output_angle - record.output_angle.mean()
    slope = float(angle @ output / (angle @ angle))
    spread = float(np.std(output))
    left = float(np.std(output - slope * angle))
    if left > 0.3 * spread:
        return Finding(
            "ratio_error",
            "the output does not follow the input at any fixed ratio: are the joints' names swapped?",
            float("nan"),
            "-",
            True,
        )
    # The error itself may lean with the angle by as much as its own size over the range.
    if abs(slope * ratio - 1.0) > max(_RATIO_MISS, 0.02 / max(float(np.ptp(output)), 1e-9)):
        return Finding(
            "ratio_error",
            f"the output follows the input at a ratio of {1.0 / slope:.4f}, not the configured {ratio:g}: "
            "check the ratio, its sign, a belt that was not declared, or swapped joints",
            1.0 / slope,
            "-",
            True,
        )
    return None


def find_steps(record: Record, ratio: float, tooth_pitch: float) -> tuple[Floats, list[Finding]]:
    """Steps of the error: teeth skipped or encoder counts lost.

    Parameters
    ----------
    record : Record
    ratio : float
    tooth_pitch : float
        Angle by which the flexspline turns when it skips a tooth [rad]: after one of its own pitches the mesh
        is the same again.

    Returns
    -------
    correction : ndarray, shape (n,)
        What to take off the output angle to close the steps [rad].
    findings : list of Finding
    """
    error = record.output_angle - record.input_angle / ratio
    correction = np.zeros(record.size)
    findings = []
    width = 15
    for begin, end in bounds(record.run):
        part = error[begin:end]
        if part.size < 4 * width:
            continue
        jump = part[width:] - part[:-width]
        while np.max(np.abs(jump)) > _STEP * tooth_pitch:
            at = int(np.argmax(np.abs(jump))) + width
            inner = part[max(at - width, 0) : at + 1]
            place = max(at - width, 0) + int(np.argmax(np.abs(np.diff(inner)))) + 1
            size = float(
                np.median(part[place : place + width]) - np.median(part[max(place - width, 0) : place])
            )
            if abs(size) < _STEP * tooth_pitch:
                break
            correction[begin + place :] += size
            part[place:] -= size
            error[end:] -= size
            findings.append(_step(size, tooth_pitch, float(record.time[begin + place])))
            jump = part[width:] - part[:-width]
            if len(findings) > 20:
                return correction, findings
    return correction, findings


def _step(size: float, tooth_pitch: float, time: float) -> Finding:
    teeth = size / tooth_pitch
    whole = abs(teeth - round(teeth)) < 0.05 and round(teeth) != 0
    name = "tooth_skip"
    text = f"a step of {np.degrees(size) * 3600:.0f} arcsec at {time:.3f} s: " + (
        f"{round(teeth)} teeth skipped" if whole else "encoder counts lost, or a hub slipped: no whole tooth"
    )
    return Finding(name, text, size, "rad", False)

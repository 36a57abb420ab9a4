"""Samples of all joints with their predictions, kept until the next report."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import astuple, fields
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.drive import transmission_error
from hd_diag.model.transmission_error import Frame
from hd_diag.monitor.joint import Joint
from hd_diag.streams.alignment import Aligned

_PLACE = ("breakpoints", "values", "lines", "near", "rows", "columns", "repeats")
_LIMITS = ("limit", "greatest")
_DRIVE = np.dtype(
    [
        *((each.name, np.float64) for each in fields(Frame)),
        *((name, np.int64) for name in _PLACE),
        *((name, np.float64) for name in _LIMITS),
    ]
)
_NO_MAP = (0,) * len(_PLACE) + (0.0,) * len(_LIMITS)
SAMPLE = np.dtype(
    [
        *((name, np.int64) for name in ("joint", "stamp", "paired")),
        *((name, np.float64) for name in ("input_angle", "output_angle", "torque", "speed", "residual")),
    ]
)
_NOTHING = np.empty(0)


class Errors(NamedTuple):
    """Aligned samples and their transmission error: predicted, measured and the difference [rad], each (m,).

    Measured error and residual are nan where no output angle is reported.
    """

    samples: Aligned
    predicted: Floats
    measured: Floats
    residual: Floats


def together(parts: Sequence[tuple[int, Errors]]) -> Errors:
    """Errors of messages taken in parts, joined; each part has the position at which its rows begin."""
    if len(parts) == 1 and parts[0][0] == 0:
        return parts[0][1]
    rows = np.concatenate([errors.samples.row + begin for begin, errors in parts])
    samples = Aligned(*map(np.concatenate, zip(*(errors.samples for _, errors in parts), strict=True)))
    columns = (np.concatenate(each) for each in zip(*(errors[1:] for _, errors in parts), strict=True))
    return Errors(samples._replace(row=rows), *columns)


class Comparison:
    """Errors of samples of k joints, predicted by their models, or else by their drives.

    `count` samples are kept; the orders of the residual contain the first `followed` of them.
    """

    def __init__(self) -> None:
        self.count = self.followed = 0
        self._kept = np.empty(1024, SAMPLE)

    @property
    def kept(self) -> Any:
        """Samples since the last report, as records of `SAMPLE`."""
        return self._kept[: self.count]

    def use(self, joints: Sequence[Joint]) -> None:
        """Predict by the joints' present configurations and maps from the next sample on."""
        self._tables = [None if joint.runs else joint.table for joint in joints]  # `place` points into them
        self._drives = {n: joint.config.drive for n, joint in enumerate(joints) if not joint.runs}
        frames = [astuple(joint.config.drive.frame) for joint in joints]
        places = [_NO_MAP if table is None else table.place for table in self._tables]
        both = zip(frames, places, strict=True)
        self._records = np.array([frame + place for frame, place in both], _DRIVE)

    def errors(self, samples: Aligned, known: Floats = _NOTHING, speed: Floats | None = None) -> Errors:
        """Errors of samples, with predictions [rad] and speeds [rad/s] if models have made them already."""
        last = self.count + samples.row.size
        if last > self._kept.size:
            kept, self._kept = self.kept, np.empty(2 * last, SAMPLE)
            self._kept[: self.count] = kept
        given = (
            *(samples.joint, samples.stamp, samples.paired, samples.input_angle, samples.output_angle),
            *(samples.torque, samples.speed if speed is None else speed, self._records),
        )
        found, missing = kernel().compare(*given, known, self._kept, self.count)
        if missing:
            self._solve(samples, found[0])
            found, _ = kernel().compare(*given, found[0], self._kept, self.count)
        self.count = last
        return Errors(samples, *found)

    def _solve(self, samples: Aligned, predicted: Floats) -> None:
        """Solve the predictions that no map gives, in place."""
        missing = np.isnan(predicted)
        for number, drive in self._drives.items():
            rows = np.flatnonzero(missing & (samples.joint == number))
            predicted[rows] = transmission_error(drive, samples.input_angle[rows], samples.torque[rows])


@functools.cache
def kernel() -> ModuleType:
    """The compiled kernels, imported when first needed."""
    from hd_diag.monitor import kernel as compiled

    return compiled

"""Checks of every row of a record, then the subset of rows that the fits get."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from hd_diag.diagnosis.findings import Finding, check_ramp, check_ratio, find_steps
from hd_diag.diagnosis.record import Record
from hd_diag.diagnosis.subsampling import LIMIT, subsample
from hd_diag.drive import Drive


@dataclass(frozen=True)
class Screened:
    """A record short enough to be fitted, without steps, and what was found in all rows."""

    record: Record
    findings: tuple[Finding, ...]


def screened(
    record: Record, configured: Drive, progress: Callable[[str], None] = lambda text: None, limit: int = LIMIT
) -> Screened:
    """Check every row for a wrong ratio, swapped joints and steps, then subsample.

    Parameters
    ----------
    record : Record
    configured : Drive
    progress : callable
        Called with what is being done.
    limit : int
        Rows to keep, at most: a caller who keeps only the result frees a long record.
    """
    ratio = configured.kinematics.ratio
    progress("checking the ratio")
    wrong = check_ratio(record, ratio)
    if wrong is not None:
        return Screened(subsample(record, limit), (wrong,))
    correction, steps = find_steps(record, ratio, configured.mesh.geometry.tooth_pitch)
    if steps:
        record = replace(record, output_angle=record.output_angle - correction)
    del correction
    record = subsample(record, limit)
    wrong = check_ramp(record, ratio)
    return Screened(record, (*([wrong] if wrong else []), *steps))

"""What is looked at in every row of a record, and the rows that everything after it gets."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from hd_diag.diagnosis.findings import Finding, check_ramp, check_ratio, find_steps
from hd_diag.diagnosis.record import Record
from hd_diag.diagnosis.subsampling import LIMIT, thinned
from hd_diag.drive import Drive


@dataclass(frozen=True)
class Screened:
    """A record of a size that can be fitted, its steps closed, and what was found in all rows."""

    record: Record
    findings: tuple[Finding, ...]


def screened(
    record: Record, configured: Drive, progress: Callable[[str], None] = lambda text: None, limit: int = LIMIT
) -> Screened:
    """Look at every row for a wrong ratio, swapped joints and steps, then thin.

    Parameters
    ----------
    record : Record
    configured : Drive
    progress : callable
        Told what is being done.
    limit : int
        Most rows that are kept.

    Returns
    -------
    Screened
        A caller who keeps only this lets a long record go.
    """
    ratio = configured.kinematics.ratio
    progress("checking the ratio")
    wrong = check_ratio(record, ratio)
    if wrong is not None:
        return Screened(thinned(record, limit), (wrong,))
    correction, steps = find_steps(record, ratio, configured.mesh.geometry.tooth_pitch)
    if steps:
        record = replace(record, output_angle=record.output_angle - correction)
    del correction
    record = thinned(record, limit)
    wrong = check_ramp(record, ratio)
    return Screened(record, (*([wrong] if wrong else []), *steps))

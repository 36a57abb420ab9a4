"""Checks of every row of a record, then the subset of rows that the fits get."""

from __future__ import annotations

from dataclasses import dataclass, replace

from hd_diag.diagnosis.drift import check_velocity
from hd_diag.diagnosis.findings import Finding, check_ramp, check_ratio, find_steps
from hd_diag.diagnosis.record import Record
from hd_diag.diagnosis.signal_findings import (
    TORQUE_SIGN,
    check_degrees,
    check_one_sensor,
    check_partner,
    check_sizes,
    check_stamps,
    check_step,
    check_torque,
    repeated_rows,
)
from hd_diag.diagnosis.subsampling import LIMIT, subsample
from hd_diag.drive import Drive


@dataclass(frozen=True)
class Screened:
    """A record short enough to be fitted, without steps, and what was found in all rows."""

    record: Record
    findings: tuple[Finding, ...]


def screened(
    record: Record,
    configured: Drive,
    limit: int = LIMIT,
    *,
    teeth: bool = True,
) -> Screened:
    """Check the signals: sensors, units, signs, ratio and steps, in every row; then subsample.

    Parameters
    ----------
    record : Record
    configured : Drive
    limit : int
        Rows to keep, at most: a caller who keeps only the result frees a long record.
    teeth : bool
        Whether the configured geometry is that of the gear: else its torsion is not compared.
    """
    ratio = configured.kinematics.ratio
    wrong = check_one_sensor(record, ratio) or check_degrees(record)
    wrong = wrong or check_velocity(record, configured.kinematics) or check_step(record, ratio)
    if not record.by_velocity:  # whose slow part is free
        wrong = wrong or check_ratio(record, ratio)
    wrong = wrong or check_partner(record, configured)
    if teeth:
        wrong = wrong or check_sizes(record, configured)
    stamps = check_stamps(record)
    if wrong is not None:
        return Screened(subsample(record, limit), (wrong, *stamps))
    record, again = repeated_rows(record)
    correction, steps = find_steps(record, ratio, configured.mesh.geometry.tooth_pitch)
    if steps:
        record = replace(record, output_angle=record.output_angle - correction)
    del correction
    record = subsample(record, limit)
    torque = check_torque(record, configured) if teeth else None
    ramp = None if record.by_velocity else check_ramp(record, ratio)
    found = [one for one in (ramp, torque, *stamps, again, *steps) if one is not None]
    if torque is not None and torque.name == TORQUE_SIGN:
        record = replace(record, torque=-record.torque, reported_torque=-record.reported_torque)
    return Screened(record, tuple(found))

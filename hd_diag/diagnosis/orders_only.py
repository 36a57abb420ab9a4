"""An order table without a tooth model, for gears of unknown geometry."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Floats
from hd_diag.diagnosis.diagnosis import Diagnosis
from hd_diag.diagnosis.evidence.order_table import order_table, part, refitted_rows
from hd_diag.diagnosis.evidence.unexplained import lines, waves
from hd_diag.diagnosis.evidence.waves import Remainder
from hd_diag.diagnosis.gain import Rms, explained, held_out
from hd_diag.diagnosis.noise import slices
from hd_diag.diagnosis.record import Record
from hd_diag.diagnosis.regression import centered, usual_laws
from hd_diag.diagnosis.screening import Screened
from hd_diag.drive import Drive

_BLOCKS = 24
_SLICE = 1.0  # length of a block of the bootstrap [s]


def orders_only(checked: Screened, configured: Drive, rng: np.random.Generator) -> Diagnosis:
    """Describe the error of a joint by lines over its turn, whatever gear it has.

    Only the ratio, rated torque and accuracy of the drive are used, not its geometry. The generator is for
    the gain's interval. The diagnosis has no parameters and no causes. "nominal" is the error without torsion
    and friction, from a regression on torque and speed; "extended" also omits the table's repeating rows.
    """
    record, findings = checked
    empty = Diagnosis(record, configured, findings)
    if any(finding.fatal for finding in findings):
        return empty
    test, which = held_out(record)
    laws = [centered(law, record.bag) for law in usual_laws(record, configured.rated_torque)]
    columns = np.stack(laws, axis=1)
    error = centered(record.output_angle - record.input_angle / configured.kinematics.ratio, record.bag)
    beta = np.linalg.lstsq(columns[~test], error[~test], rcond=None)[0]
    # Each held-out recording has its own offset.
    rest = error - columns @ beta
    rest[test] = centered(rest[test], record.bag[test])
    trained, rated = _remainder(record, configured, rest, columns, ~test), configured.rated_torque
    table = order_table(trained, waves(trained), rated)
    after = rest - part(table, record.input_angle, record.torque, rated)
    number = slices(record.time[test], record.run[test], _SLICE)
    gain = explained(rest[test], after[test], number, which, rng)
    table = tuple(replace(row, repeats=row.repeats and gain.fraction > 0.0) for row in table)
    whole = _remainder(record, configured, rest, columns, np.ones(record.size, bool))
    rows = refitted_rows(whole, table, rated)
    first, last = (float(np.sqrt(np.mean(one[test] ** 2))) for one in (rest, after))
    return replace(
        empty,
        rms=Rms(first, first, first, last, last, last, *[math.nan] * 3),
        gain=gain,
        orders=rows,
        unexplained=tuple(lines(whole, waves(whole))),
    )


def _remainder(
    record: Record, configured: Drive, rest: Floats, columns: Floats, rows: npt.NDArray[np.bool_]
) -> Remainder:
    way = np.sign(configured.kinematics.ratio)
    some, at = record.select(rows), np.flatnonzero(rows)
    gap = np.concatenate(([False], (np.diff(at) > 1) | (np.diff(some.run) != 0)))
    return Remainder(
        some.time,
        some.input_angle,
        some.torque,
        some.speed * way,
        rest[rows],
        columns[rows],
        np.cumsum(gap).astype(np.int64),
        (np.arange(at.size) * _BLOCKS // max(at.size, 1)).astype(np.int64),
        configured.kinematics.ratio,
    )

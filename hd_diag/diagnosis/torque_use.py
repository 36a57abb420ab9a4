"""Whether a measured torque is that of this joint: a model that knows it must predict better."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Floats
from hd_diag.diagnosis.findings import Finding
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.design import lower_bound, projection
from hd_diag.diagnosis.fit.refit import nuisance, refit
from hd_diag.diagnosis.record import Record
from hd_diag.diagnosis.screening import twisting
from hd_diag.drive import Drive
from hd_diag.effects.quantity import turning
from hd_diag.formatting import ARCSEC

TORQUE_MISLEADS = "torque_misleads"

_WORSE = 1.3  # ratio of the residuals
_BLOCKS = 8
_MOST_ROWS = 2000


def without_misleading_torque(
    record: Record, configured: Drive, test: npt.NDArray[np.bool_], rng: np.random.Generator
) -> tuple[Record, Finding | None]:
    """The record without its torque where fits to other rows predict held-out ones far better without.

    A current is kept: what the motor itself needs of it, these fits do not know. So is a torque that hardly
    changes: it twists nothing, and cannot mislead. Both fits have the same samples and starts, chosen by the
    generator; `test` (n,) are the rows held out.
    """
    if not twisting(record, configured) or record.by_current:
        return record, None
    unloaded = np.zeros(record.size)
    blind = replace(record, torque=unloaded, reported_torque=unloaded, has_torque=False)
    if np.std(_left(record, configured, test)) < np.std(_left(blind, configured, test)):
        return record, None  # as configured it helps already
    seed, squares = int(rng.integers(2**31)), []
    for one in (record, blind):
        train = one.select(~test)
        fit = refit(train, configured, np.random.default_rng(seed), _of_encoders(train))
        squares.append(_left(one, fit.drive, test) ** 2)
    rms = [float(np.sqrt(np.mean(one))) for one in squares]
    parts = [np.array_split(one, _BLOCKS) for one in squares]
    worse = np.array([float(a.sum() - b.sum()) for a, b in zip(*parts, strict=True)])
    if rms[0] < _WORSE * rms[1] or lower_bound(worse) < 0.0:
        return record, None
    text = (
        f"with the torque as measured, held-out data are predicted to {rms[0] / ARCSEC:.0f} arcsec, without "
        f"it to {rms[1] / ARCSEC:.0f}: it is left out here; see whether it is this joint's, and in N m"
    )
    return blind, Finding(TORQUE_MISLEADS, text, rms[0] / rms[1], "-", False)


def _left(record: Record, drive: Drive, test: npt.NDArray[np.bool_]) -> Floats:
    """Residual of a drive on some held-out rows less what any fit carries along [rad]."""
    some = record.select(test).thinned(_MOST_ROWS)
    error, _, _ = fit_parameters.along(drive, drive, some.input_angle, some.torque)
    rest = some.output_angle - some.input_angle / drive.kinematics.ratio - np.nan_to_num(error)
    free = np.concatenate((nuisance(some, drive.kinematics.ratio), _of_encoders(some)), axis=1)
    return np.asarray(rest - projection(free, rest))


def _of_encoders(record: Record) -> Floats:
    """Once and twice per input turn, (n, 4): fitted without them, parameters of the torque imitate them."""
    return np.concatenate([turning(order * record.input_angle) for order in (1, 2)], axis=1)

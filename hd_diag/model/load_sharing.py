"""Load distribution: one torsion for all teeth, solved exactly.

The torque that a torsion beta asks for, ``sum k+ (beta - b+)_+ - sum k- (-beta - b-)_+``, is a rising
piecewise-linear function. Sorting its breakpoints gives it, and its inverse, without iteration.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Floats
from hd_diag.model.clearance import Contact

# Torques are compared with breakpoints for this many (moment, torque, breakpoint) triples at once [-].
_BLOCK = 4_000_000
_SIDES = np.array([1.0, -1.0])[:, None]  # of a torsion: + flanks bear where it is positive


@dataclass(frozen=True)
class TorqueCurve:
    """Torque over torsion, piecewise linear, one row per moment.

    Attributes
    ----------
    torsion : ndarray, shape (moments, breakpoints)
        Breakpoints beta, rising [rad].
    torque : ndarray, shape (moments, breakpoints)
        Torque there [N m].
    stiffness : ndarray, shape (moments, breakpoints + 1)
        Slope before, between and after the breakpoints [N m/rad].
    gap : ndarray, shape (moments, 2)
        Torsion at which the first - flank and the first + flank lose contact [rad]; a true gap if rising.
    """

    torsion: Floats
    torque: Floats
    stiffness: Floats
    gap: Floats


@dataclass(frozen=True)
class LoadSharing:
    """Load distribution at one torque per moment. Flanks are (+, -).

    Attributes
    ----------
    torsion : ndarray, shape (moments,)
        beta [rad]; nan if no flank can bear the torque.
    force : ndarray, shape (moments, 2, teeth)
        F, normal force of each flank [N], zero where it is free.
    stiffness : ndarray, shape (moments,)
        dM/dbeta [N m/rad].
    weight : ndarray, shape (moments, 2, teeth)
        d beta / d b, sensitivity to each flank's clearance; negative for - flanks.
    lost_motion : ndarray, shape (moments,)
        Width of the gap at zero torque [rad], zero where the lobes press against each other.
    """

    torsion: Floats
    force: Floats
    stiffness: Floats
    weight: Floats
    lost_motion: Floats

    @property
    def loaded_pairs(self) -> npt.NDArray[np.int64]:
        """Number of flanks that carry load on the + and - side, shape (moments, 2)."""
        return np.asarray(np.count_nonzero(self.force > 0.0, axis=2), dtype=np.int64)


def flank_stiffness(contact: Contact, tooth_compliance: float) -> Floats:
    """Torsional stiffness that each closed flank adds.

    Parameters
    ----------
    contact : Contact
    tooth_compliance : float
        K1 + K2 [m/N].

    Returns
    -------
    ndarray, shape (moments, 2, teeth)
        ``k = (r cos alpha)^2 / (K1 + K2)`` [N m/rad]; zero where the flanks cannot touch.

    Notes
    -----
    Dong et al. (2019), eq. (8), in the form that agrees with "loaded where the torsion exceeds the backlash":
    ``r cos(alpha) (beta - b) = (K1 + K2) F``.
    """
    arm = contact.radius * np.cos(contact.pressure_angle)
    return np.where(np.isfinite(contact.rotation), arm * arm / tooth_compliance, 0.0)


def torque_curve(rotation: Floats, stiffness: Floats) -> TorqueCurve:
    """Sort the flanks by the torsion at which they begin to bear.

    Parameters
    ----------
    rotation : ndarray, shape (moments, 2, teeth)
        Closing rotation b of each flank [rad]; not finite: cannot touch.
    stiffness : ndarray, shape (moments, 2, teeth)
        k of each flank [N m/rad].

    Returns
    -------
    TorqueCurve
    """
    bears = np.isfinite(rotation)
    signed = np.where(bears, rotation, np.nan) * _SIDES
    start = np.where(bears, signed, 0.0)
    beta = start.reshape(start.shape[0], -1)
    order = np.argsort(beta, axis=1, kind="stable")
    gain = (stiffness * _SIDES).reshape(beta.shape)
    beta, gain = np.take_along_axis(beta, order, axis=1), np.take_along_axis(gain, order, axis=1)
    first = np.sum(stiffness[:, 1, :], axis=1, keepdims=True)
    slope = np.concatenate((first, first + np.cumsum(gain, axis=1)), axis=1)
    offset = np.sum(stiffness[:, 1, :] * start[:, 1, :], axis=1, keepdims=True) + np.cumsum(
        gain * beta, axis=1
    )
    torque = slope[:, 1:] * beta - offset
    gap = np.stack(
        (_extreme(signed[:, 1, :], np.fmax, -np.inf), _extreme(signed[:, 0, :], np.fmin, np.inf)), axis=1
    )
    # Rounding must not give a torque inside a true gap, or one of the wrong sign beside it.
    true_gap = gap[:, 1:] > gap[:, :1]
    torque = np.where(true_gap & (beta <= gap[:, 1:]), np.minimum(torque, 0.0), torque)
    torque = np.where(true_gap & (beta >= gap[:, :1]), np.maximum(torque, 0.0), torque)
    torque = np.maximum.accumulate(torque, axis=1)
    return TorqueCurve(beta, torque, np.maximum(slope, 0.0), gap)


def _extreme(values: Floats, ufunc: np.ufunc, empty: float) -> Floats:
    found: Floats = ufunc.reduce(values, axis=1, initial=empty)
    return found


def torsion(curve: TorqueCurve, torque: Floats) -> Floats:
    """Torsion that carries a torque, for several torques at each moment.

    Parameters
    ----------
    curve : TorqueCurve
    torque : ndarray, shape (moments, torques) or (torques,)
        M [N m].

    Returns
    -------
    ndarray, shape (moments, torques)
        beta [rad]: exact; the middle of a true gap at zero torque; nan if no flank can bear the torque.
    """
    moments = curve.torque.shape[0]
    torque = np.broadcast_to(torque, (moments, np.shape(torque)[-1]))
    result = np.empty(torque.shape)
    step = max(1, _BLOCK // max(1, torque.shape[1] * curve.torque.shape[1]))
    for row in range(0, moments, step):
        rows = slice(row, row + step)
        part = TorqueCurve(curve.torsion[rows], curve.torque[rows], curve.stiffness[rows], curve.gap[rows])
        result[rows] = _torsion(part, torque[rows])
    return result


def _torsion(curve: TorqueCurve, torque: Floats) -> Floats:
    last = curve.torque.shape[1] - 1
    # Positive torque searches from the gap's far end, negative torque from its near end.
    below = curve.torque[:, None, :] < torque[:, :, None]
    reached = curve.torque[:, None, :] <= torque[:, :, None]
    passed = np.where(torque > 0.0, below.sum(axis=2), reached.sum(axis=2))
    anchor = np.clip(np.where(torque > 0.0, passed - 1, passed), 0, last)
    slope = np.take_along_axis(curve.stiffness, passed, axis=1)
    beta_0 = np.take_along_axis(curve.torsion, anchor, axis=1)
    torque_0 = np.take_along_axis(curve.torque, anchor, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        beta = beta_0 + (torque - torque_0) / np.where(slope > 0.0, slope, np.nan)
        width = curve.gap[:, 1:] - curve.gap[:, :1]
        middle = np.where(np.isfinite(width), 0.5 * (curve.gap[:, 1:] + curve.gap[:, :1]), np.nan)
    return np.where((torque == 0.0) & (width > 0.0), middle, beta)


def forces(contact: Contact, tooth_compliance: float, beta: Floats) -> Floats:
    """Normal forces at a torsion.

    Parameters
    ----------
    contact : Contact
    tooth_compliance : float
        K1 + K2 of a tooth pair [m/N].
    beta : ndarray, shape (moments,)
        Torsion [rad].

    Returns
    -------
    ndarray, shape (moments, 2, teeth)
        F of each flank [N], zero where it is free.
    """
    overlap = _SIDES * beta[:, None, None] - contact.rotation
    arm = contact.radius * np.cos(contact.pressure_angle)
    return np.where(overlap > 0.0, overlap * arm / tooth_compliance, 0.0)


def share_load(contact: Contact, tooth_compliance: float, torque: Floats) -> LoadSharing:
    """Load distribution over the tooth pairs at one torque per moment.

    Parameters
    ----------
    contact : Contact
    tooth_compliance : float
        K1 + K2 of a tooth pair [m/N].
    torque : ndarray, shape (moments,)
        M [N m]; positive loads + flanks.

    Returns
    -------
    LoadSharing
    """
    k = flank_stiffness(contact, tooth_compliance)
    curve = torque_curve(contact.rotation, k)
    beta = torsion(curve, torque[:, None])[:, 0]
    force = forces(contact, tooth_compliance, beta)
    loaded = force > 0.0
    total = np.sum(np.where(loaded, k, 0.0), axis=(1, 2))
    share = np.where(loaded, _SIDES * k, 0.0) / np.where(total > 0.0, total, np.inf)[:, None, None]
    lost_motion = np.maximum(curve.gap[:, 1] - curve.gap[:, 0], 0.0)
    return LoadSharing(beta, force, total, share, lost_motion)

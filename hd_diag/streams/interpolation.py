"""Torque between reported ones, for whoever knows the next one as well."""

from __future__ import annotations

import numpy as np

from hd_diag.arrays import Floats, Integers, Times
from hd_diag.streams.rules import LONGEST_HOLD


def torque_between(stamp: Times, stretch: Integers, torque: Floats, torque_stamp: Times) -> Floats:
    """Torque of one joint's samples where the next reported one is known as well: interpolated.

    Parameters
    ----------
    stamp, stretch, torque, torque_stamp : ndarray, shape (m,)
        As in `Aligned`, by stamps in each stretch.

    Returns
    -------
    ndarray, shape (m,)
        [N m]; nan where none is reported nearby, infinite beside an infinite one; by the rules of
        `hd_diag.streams.alignment`.
    """
    found = torque
    for number in np.unique(stretch[torque_stamp != stamp]):
        rows = np.flatnonzero(stretch == number)
        held = rows[~np.isnan(torque[rows])]
        if not held.size:
            continue
        known, first = np.unique(torque_stamp[held], return_index=True)
        at = stamp[rows]
        after = np.minimum(known.searchsorted(at), known.size - 1)
        before = np.maximum(after - 1, 0)
        gap = known[after] - np.minimum(known[before], at)
        near = (at < known[after]) & (gap <= LONGEST_HOLD)
        between = np.interp((at - known[0]) * 1e-9, (known - known[0]) * 1e-9, torque[held[first]])
        found = found.copy() if found is torque else found
        found[rows[near]] = between[near]
    return found

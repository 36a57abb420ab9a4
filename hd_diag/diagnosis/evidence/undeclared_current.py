"""Whether a torque is a motor's current that nobody declared: it bears the motor's friction and inertia."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hd_diag.arrays import Rows
from hd_diag.diagnosis.calibration import ODDS, PRESENT
from hd_diag.diagnosis.evidence.search import begun
from hd_diag.diagnosis.evidence.sets import Set
from hd_diag.diagnosis.fit.linearised_fit import LinearisedFit
from hd_diag.diagnosis.noise import Whitening
from hd_diag.effects.mesh_torque import MeshTorque
from hd_diag.effects.motor_current import FRICTION
from hd_diag.effects.remainders import SPEED


def suspected(fit: LinearisedFit) -> Set | None:
    """The set without causes if its part that follows the speed is larger than usual; otherwise None."""
    if not fit.data.source.has_torque or fit.data.given:
        return None
    at = begun(fit.with_noise(()))
    return at if at.widths[SPEED.name] > 1.0 else None


def is_current(reported: Set, fit: LinearisedFit) -> bool:
    """Whether the torque is a motor's current, with the probability at which causes are named.

    The motor's friction must take power: friction of the joint, which acts on the mesh as well, has the
    opposite sign.

    Parameters
    ----------
    reported : Set
        Without causes, with the torque as reported.
    fit : LinearisedFit
        Of the same rows, with the motor's own torque.
    """
    current = begun(fit.with_noise(fit.data.given))
    both = reported.fit.data.mask & current.fit.data.mask
    here, there = reported.relearned, current.relearned
    noises = here.fit.whiten, there.fit.whiten
    gains = [_on(there, both, one).value - _on(here, both, one).value for one in noises]
    return min(gains) > ODDS - PRESENT and _power(there) > 0.0


def _on(at: Set, rows: Rows, whiten: Whitening) -> Set:
    """The set on some of its rows (n,) and with some noise, settled."""
    fit = replace(at.fit, data=at.fit.data.on(rows), whiten=whiten)
    return replace(at, fit=fit.beside(at.fit.present)).settled()


def _power(at: Set) -> float:
    """Mean power that the motor's friction takes, times the ratio [W]."""
    fit, (effect, nonlinear) = at.fit, at.motor[0]
    assert isinstance(effect, MeshTorque)
    own = fit.fit(at.chosen)[0][fit.places(at.chosen)[0]]
    column = fit.data.model.torque(effect, nonlinear)[fit.data.at]
    return -float(np.mean(fit.signals.forward_speed * (column[:, FRICTION] @ own[FRICTION])))

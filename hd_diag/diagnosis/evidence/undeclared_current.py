"""Whether a torque is a motor's current that nobody declared: it bears the motor's friction and inertia."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hd_diag.arrays import Rows
from hd_diag.diagnosis.calibration import CERTAIN_SIZE, ODDS, PRESENT
from hd_diag.diagnosis.evidence.search import TO_MINIMUM, begun
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

    The motor's friction must certainly take power. Friction of the joint, which acts on the mesh as well,
    has the opposite sign.

    Parameters
    ----------
    reported : Set
        Without causes, with the torque as reported.
    fit : LinearisedFit
        Of the same rows, with the motor's own torque.
    """
    current = begun(fit.with_noise(fit.data.given))
    # The fit with a motor has more starts: a better minimum that needs no motor is no sign of one.
    same = replace(reported, widths=current.widths).at(current.fit.parameters).settled(TO_MINIMUM)
    reported = max(reported, same, key=lambda one: one.value)
    both = reported.fit.data.mask & current.fit.data.mask
    here, there = reported.relearned, current.relearned
    noises = here.fit.whiten, there.fit.whiten
    gains = [_on(there, both, one).value - _on(here, both, one).value for one in noises]
    return min(gains) > ODDS - PRESENT and _takes_power(there)


def _on(at: Set, rows: Rows, whiten: Whitening) -> Set:
    """The set on some of its rows (n,) and with some noise, settled."""
    fit = replace(at.fit, data=at.fit.data.on(rows), whiten=whiten)
    return replace(at, fit=fit.beside(at.fit.present)).settled()


def _takes_power(at: Set) -> bool:
    """Whether the motor's friction certainly takes power, on average over the rows."""
    fit, (effect, nonlinear) = at.fit, at.motor[0]
    assert isinstance(effect, MeshTorque)
    beta, spread, _ = fit.fit(at.chosen)
    column = fit.data.model.torque(effect, nonlinear)[fit.data.at]
    power, place = np.zeros(beta.size), fit.places(at.chosen)[0]  # times the ratio [W], per coefficient
    power[place][FRICTION] = -(fit.signals.forward_speed @ column)[FRICTION]
    return bool(power @ beta > CERTAIN_SIZE * np.sqrt(power @ spread @ power))

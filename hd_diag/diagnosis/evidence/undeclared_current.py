"""Whether a torque is a motor's current that nobody declared: it bears the motor's friction and inertia."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hd_diag.arrays import Rows
from hd_diag.diagnosis.calibration import CERTAIN_SIZE, ODDS, PRESENT
from hd_diag.diagnosis.evidence.search import TO_MINIMUM, with_next
from hd_diag.diagnosis.evidence.sets import Set
from hd_diag.diagnosis.noise import Whitening
from hd_diag.effects.mesh_torque import MeshTorque
from hd_diag.effects.motor_current import FRICTION
from hd_diag.effects.remainders import SPEED


def is_suspected(reported: Set) -> bool:
    """Whether a part that follows the speed is larger than usual beside a torque that nobody declared."""
    data = reported.fit.data
    return data.source.has_torque and not data.given and reported.widths[SPEED.name] > 1.0


def is_current(reported: Set, current: Set) -> bool:
    """Whether the torque is a motor's current, with the probability at which causes are named.

    The motor's friction must certainly take power. Friction of the joint, which acts on the mesh as well,
    has the opposite sign.

    Parameters
    ----------
    reported, current : Set
        Without causes, of the same rows: with the torque as reported, and with the motor's own torque.
    """
    # The fit with a motor has more starts: a better minimum that needs no motor is no sign of one.
    same = replace(reported, widths=current.widths).at(current.fit.parameters).settled(TO_MINIMUM)
    reported = max(reported, same, key=lambda one: one.value)
    if not (_takes_power(current.relearned) and _is_likelier(current, reported)):
        return False
    # A delay or a friction of the joint follows the speed as well.
    by_cause = with_next(reported)
    return by_cause is None or _is_likelier(current, by_cause)


def _is_likelier(current: Set, other: Set) -> bool:
    """Whether a motor's current is likelier than another set, with the noise learned given either."""
    both = other.fit.data.mask & current.fit.data.mask
    here, there = other.relearned, current.relearned
    noises = here.fit.whiten, there.fit.whiten
    gains = [_on(there, both, one).value - _on(here, both, one).value for one in noises]
    return min(gains) > ODDS - PRESENT


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

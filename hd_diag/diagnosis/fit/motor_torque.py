"""Link torque from motor current: the motor's own torque is subtracted before any cause is sought."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hd_diag.diagnosis.fit.fit_parameters import vector
from hd_diag.diagnosis.fit.linearised_fit import LinearisedFit, linearise
from hd_diag.diagnosis.fit.refit import Motor, Refit, refit
from hd_diag.diagnosis.record import Record
from hd_diag.diagnosis.work import Work
from hd_diag.drive import Drive
from hd_diag.effects import Catalogue
from hd_diag.effects.mesh_torque import MeshTorque


def less_motor(
    record: Record,
    configured: Drive,
    rows: npt.NDArray[np.bool_],
    rng: np.random.Generator,
    catalogue: Catalogue,
    work: Work,
) -> tuple[LinearisedFit, Refit]:
    """A record with the link torque, linearised about the motor's own torque, and the refit that gave it.

    The motor's own torque and the parameters are fitted together, without linearisation: friction moves the
    torque at which the flanks change. All later fits start from this torque and correct it.

    Parameters
    ----------
    record : Record
        With a torque computed from motor current.
    configured : Drive
    rows : ndarray of bool, shape (n,)
        Rows that may be fitted.
    rng : numpy.random.Generator
        Draws the samples.
    catalogue : tuple of Effect
    work : Work
    """
    begun = linearise(record, configured, vector(configured, configured), rows, catalogue)
    ((effect, nonlinear),) = begun.data.given
    assert isinstance(effect, MeshTorque)
    motor = Motor(effect, begun.data.model.torque(effect, nonlinear)[begun.data.at])
    found = refit(begun.data.record, configured, rng, motor=motor)
    present = (((effect, nonlinear), found.taken),)
    source = begun.beside(present).recentred().data.source
    return linearise(source, configured, found.parameters, rows, catalogue, work).beside(present), found

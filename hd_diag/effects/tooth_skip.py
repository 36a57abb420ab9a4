"""The gear ratchets: the output jumps by whole teeth."""

from __future__ import annotations

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Effect, Starts, Values
from hd_diag.effects.excitation import enough_samples
from hd_diag.effects.quantity import Quantity
from hd_diag.effects.signals import Signals

_CANDIDATES = 2
_APART = 0.02  # share of the record; steps closer than this count as one


class ToothSkip(Effect):
    """``m 2 pi / Z_G`` from a moment on."""

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """One pitch from the moment of the skip on; see :meth:`Effect.columns`."""
        pitch = signals.contact.drive.mesh.geometry.slot_pitch
        return np.where(signals.time >= nonlinear[0], pitch, 0.0)[:, None]

    def starts(self, signals: Signals, residual: Floats | None = None) -> Starts:
        """Times where a step fits a residual best; without a residual the time of the greatest torque [s]."""
        count = signals.size
        if residual is None or count < 4:
            greatest = [int(np.argmax(np.abs(signals.torque)))] if count else []
            return Starts([(float(signals.time[index]),) for index in greatest], max(1, count))
        before = np.arange(1, count)
        total = np.cumsum(residual - residual.mean())[:-1]
        strength = np.abs(total) / np.sqrt(before * (count - before) / count)
        found: list[Values] = []
        apart = max(1, int(_APART * count))
        for _ in range(_CANDIDATES):
            index = int(np.argmax(strength))
            found.append((float(signals.time[index + 1]),))
            strength[max(0, index - apart) : index + apart] = 0.0
        return Starts(found, count)


EFFECT = ToothSkip(
    name="tooth_skip",
    cause="The teeth jumped over each other under too much torque: the flexspline sits whole teeth farther.",
    kind="kinematic",
    frame="time",
    needs=("time", "torque"),
    excitation=(enough_samples,),
    searched=False,
    lasting=False,
    quantities=(
        Quantity("teeth", "-", -20.0, 20.0, 1.0, "m, teeth that were skipped: a whole number"),
        Quantity("moment", "s", -1e12, 1e12, 1e3, "time of the step", linear=False, discrete=True),
    ),
    confused_with=("ratio_error", "thermal_drift"),
    source="ratcheting: Harmonic Drive, catalogue HFUS: ratcheting torque; one tooth is 360 deg / Z_G",
    inspect=(
        "The torque at that moment against the ratcheting torque of the catalogue. One tooth of 202 is 6416 "
        "arcsec; a step of another size is a lost encoder count or a slipped hub. After ratcheting the gear "
        "may run off centre (dedoidal): look at the wave generator's seat and the teeth, and set the "
        "joint's zero again."
    ),
)

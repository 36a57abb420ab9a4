"""The gear ratchets: the output jumps by whole teeth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Effect, Quantity, Values
from hd_diag.effects.signals import Signals

_CANDIDATES = 2
_APART = 0.02  # of the record: steps nearer than this are one


@dataclass(frozen=True)
class ToothSkip(Effect):
    """``m 2 pi / Z_G`` from a moment on."""

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """One tooth from the moment on; see :meth:`Effect.columns`."""
        pitch = signals.contact.drive.mesh.geometry.slot_pitch
        return np.where(signals.time >= nonlinear[0], pitch, 0.0)[:, None]

    def grid(self, signals: Signals) -> list[Values]:
        """The moment of the greatest torque [s]; `scan` finds the step."""
        return [(float(signals.time[np.argmax(np.abs(signals.torque))]),)] if signals.size else []

    def scan(self, signals: Signals, residual: Floats) -> list[Values]:
        """Moments at which a step fits the residual best: cumulative sums."""
        count = residual.size
        if count < 4:
            return []
        before = np.arange(1, count)
        total = np.cumsum(residual - residual.mean())[:-1]
        strength = np.abs(total) / np.sqrt(before * (count - before) / count)
        found: list[Values] = []
        apart = max(1, int(_APART * count))
        for _ in range(_CANDIDATES):
            index = int(np.argmax(strength))
            found.append((float(signals.time[index + 1]),))
            strength[max(0, index - apart) : index + apart] = 0.0
        return found

    def trials(self, signals: Signals) -> int:
        """Every moment."""
        return max(1, signals.size)

    def testable(self, signals: Signals) -> tuple[bool, str]:
        """Any record shows the step that happens in it."""
        enough = signals.size >= 10
        return enough, "" if enough else "fewer than ten samples: record before and after the step"


EFFECT = ToothSkip(
    name="tooth_skip",
    cause="The teeth jumped over each other under too much torque: the flexspline sits whole teeth farther.",
    kind="kinematic",
    frame="time",
    needs=("time", "torque"),
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

"""Part of a cause that a record can show: no parameter of the drive and no other cause reproduces it."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Sequence

import numpy as np

from challenge import noise
from challenge.cause import Cause
from challenge.design import Array, Design
from challenge.motion import Motion
from challenge.records import Recording, contribution, gear
from challenge.truth import ARCSEC, Base

SNR = 7.6  # sqrt of 58: chi-square with 2 degrees of freedom at 1e-6 is 28; 99 % power doubles it
WORTH_NAMING = 0.25 * ARCSEC  # [rad] rms
TORQUE_AS_ANGLE = 5 * ARCSEC  # [rad/(N m)], converts torque noise
_ROWS = 3000
_STEPS = {"e": 0.3e-6, "psi": 0.02, "runout": 0.3e-6, "runout_psi": 0.05, "datum": 0.3e-6}


def jacobian(base: Base, motion: Motion, time: Array) -> Array:
    """Columns (n, k) [rad]: change of the error by a small step of each parameter of the drive."""
    angle, torque = -motion.angle(time), -motion.torque(time)
    mesh = gear(base, ())
    here = mesh.torsion(angle, torque)
    softer = copy.copy(mesh)  # same clearances
    softer.base = dataclasses.replace(base, compliance=1.01 * base.compliance)
    moved = [dataclasses.replace(base, **{name: getattr(base, name) + step}) for name, step in _STEPS.items()]
    drives = [softer, *(gear(each, ()) for each in moved)]
    columns = [drive.torsion(angle, torque) - here for drive in drives]
    return np.stack([*columns, torque, np.ones(len(time))], axis=1)


def own(signal: Array, columns: Array) -> Array:
    """Residual (n,) of a least-squares fit of columns (n, k) to a signal (n,)."""
    scale = np.linalg.norm(columns, axis=0)
    return signal - columns / scale @ np.linalg.lstsq(columns / scale, signal, rcond=None)[0]


def least(recording: Recording, count: int, design: Design) -> float:
    """Least rms [rad] that ``count`` samples can show at any frequency; all noise counts as slow."""
    slow = noise.DRIFTING**2 * (1 + noise.POLE) / (1 - noise.POLE)
    power = recording.noise_scale**2 * (slow + noise.WHITE**2)
    power += (recording.torque_noise * TORQUE_AS_ANGLE / design.strength) ** 2
    for bits, turns in ((recording.input_bits, design.ratio), (recording.output_bits, 1.0)):
        power += (2 * np.pi / 2**bits / turns) ** 2 / 12 if bits else 0.0
    return float(max(SNR * np.sqrt(power / count), WORTH_NAMING))


def _rows(time: Array) -> slice:
    return slice(None, None, max(len(time) // _ROWS, 1))


def columns(base: Base, motion: Motion, recording: Recording) -> Array:
    """Columns (n, k): effects of the drive's parameters and of each recording's offset."""
    time = motion.times(recording.rate)
    part = (np.arange(len(time)) * recording.parts // len(time))[_rows(time)]
    offsets = part[:, None] == np.arange(1, recording.parts)
    return np.concatenate([jacobian(base, motion, time[_rows(time)]), offsets], axis=1)


def shares(
    base: Base, causes: Sequence[Cause], motion: Motion, recording: Recording, columns: Array
) -> list[float]:
    """Own rms of each cause, beyond columns and other causes, divided by the least that can be found."""
    time = motion.times(recording.rate)
    signals = [contribution(base, causes, cause, motion, time)[_rows(time)] for cause in causes]
    found = []
    for i, signal in enumerate(signals):
        others = [column[:, None] for j, column in enumerate(signals) if j != i]
        rest = own(signal, np.concatenate([columns, *others], axis=1))
        found.append(float(rest.std()) / least(recording, len(time), base.design))
    return found

"""Smallest findable size of each cause on a standard record, for test/challenge/families.py.

The signal of a cause is what it adds to the transmission error, minus the part that parameters of the drive
could imitate. The cause is findable if a test with two degrees of freedom at 1e-6 (about 1e4 tests at 1 %)
detects it in 99 of 100 cases in the noise of the record (SNR), and if it is worth naming (0.25 arcsec rms).

    python bench/findable.py

prints the largest value over several random drives.
"""

# ruff: noqa: T201

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "test"))

import numpy as np
from challenge import noise
from challenge.clearances import Array
from challenge.faults import FAULTS, UNKNOWN
from challenge.findability import SNR, TORQUE_AS_ANGLE, WORTH_NAMING, own
from challenge.motion import RATE, Motion, standard
from challenge.records import contribution, transmission_error
from challenge.truth import ARCSEC, Base, drawn


def whitened(x: Array) -> Array:
    """Columns (n, k) [rad], whitened: noise of a standard record would have unit variance."""
    frequency = np.fft.rfftfreq(len(x))
    slow = (
        noise.DRIFTING**2
        * (1 - noise.POLE**2)
        / np.abs(1 - noise.POLE * np.exp(-2j * np.pi * frequency)) ** 2
    )
    power = slow + noise.WHITE**2 + (noise.TORQUE_NOISE * TORQUE_AS_ANGLE) ** 2
    return np.asarray(np.fft.irfft(np.fft.rfft(x, axis=0) / np.sqrt(power)[:, None], len(x), axis=0))


def _moved(base: Base) -> list[Base]:
    """Drives that each differ in one parameter."""
    tiny = {"e": 0.3e-6, "psi": 0.02, "runout": 0.3e-6, "runout_psi": 0.05}
    tiny |= {"datum": 0.3e-6, "compliance": 1e-8, "cup": 1e-7, "offset": 1e-6}
    return [dataclasses.replace(base, **{name: getattr(base, name) + step}) for name, step in tiny.items()]


def jacobian(base: Base, motion: Motion, time: Array, here: Array) -> Array:
    """Columns (n, 8): change of the error (n,) [rad] for a small step of each drive parameter."""
    return np.stack([transmission_error(b, (), motion, time) - here for b in _moved(base)], axis=1)


def least(signal: Array, columns: Array) -> tuple[float, float]:
    """Factor that makes a signal (n,) [rad] just findable, and the share that no column (n, k) imitates."""
    rest = own(signal, columns)
    seen = np.linalg.norm(own(whitened(signal[:, None])[:, 0], whitened(columns)))
    return float(max(SNR / seen, WORTH_NAMING / rest.std())), float(rest.std() / signal.std())


def main(drives: int = 2) -> None:
    """Print the smallest sizes, and each cause's rms at the output per unit of its amplitude."""
    found: dict[str, list[tuple[float, float, float]]] = {}
    for seed in range(drives):
        rng = np.random.default_rng([seed, 1])
        motion, base = standard(rng), drawn(rng)
        time = motion.times(RATE)
        here = transmission_error(base, (), motion, time)
        columns = jacobian(base, motion, time, here)
        for name, fault in (FAULTS | UNKNOWN).items():
            amplitude = float(np.sqrt(fault.low * fault.high))
            cause = fault.build(np.random.default_rng(seed), amplitude, motion)
            signal = contribution(base, (cause,), cause, motion, time)
            factor, share = least(signal, columns)
            rms = float(signal.std()) / amplitude / ARCSEC
            found.setdefault(name, []).append((amplitude * factor, rms, share))
    for name, each in found.items():
        worst = max(e[0] for e in each)
        rms, share = np.median([e[1:] for e in each], axis=0)
        line = f'    "{name}": {worst:.2g},  # {rms:.3g} arcsec rms per unit, own share {share:.2f}'
        print(line, flush=True)


if __name__ == "__main__":
    main()

"""Records of a joint from the package's own drive, for tests that need no independent truth."""

import functools
from typing import Any

import numpy as np
from challenge import records
from live import config

from hd_diag.config.configuration import JointConfig
from hd_diag.diagnosis.record import Record, prepare
from hd_diag.drive import transmission_error

ARCSEC = np.pi / 648000.0
RATIO = 100.0
RATE = 200.0  # [Hz]
NOISE = 2.0 * ARCSEC


def generated(made: records.Record) -> Record:
    """Prepared record from the benchmark's generator."""
    columns = (made.time, made.input_angle, made.output_angle, made.torque, made.temperature, made.part)
    return prepare(*columns, RATIO)


def joint(**given: Any) -> JointConfig:
    """Configuration of `joint_1`; in names ``__`` stands for a dot."""
    return config(**{f"joint_1__{name}": value for name, value in given.items()}).joints[0]


def columns(seconds: float = 20.0, rate: float = RATE, seed: int = 0) -> dict[str, np.ndarray]:
    """Columns of a joint with an eccentricity of 12 um that moves up and down under a torque of 15 to 45 N m.

    The torque avoids zero, where teeth change flanks within a few samples, which looks like outliers.
    """
    return {name: column.copy() for name, column in _columns(seconds, rate, seed).items()}


@functools.cache
def _columns(seconds: float, rate: float, seed: int) -> dict[str, np.ndarray]:
    time = np.arange(round(seconds * rate)) / rate
    angle = 60.0 * np.sin(2.0 * np.pi * time / 10.0)
    torque = 30.0 + 15.0 * np.sin(2.0 * np.pi * time / 3.7)
    drive = joint(eccentricity__magnitude=12e-6, eccentricity__direction=0.6).drive
    noise = NOISE * np.random.default_rng(seed).standard_normal(time.size)
    output = angle / RATIO + transmission_error(drive, angle, torque) + noise
    return {"time": time, "input": angle, "output": output, "torque": torque}


def prepared(given: dict[str, np.ndarray], bag: np.ndarray | None = None, **more: Any) -> Record:
    return prepare(
        given["time"],
        given["input"],
        given["output"],
        given.get("torque"),
        given.get("temperature"),
        np.zeros(given["time"].size, dtype=np.int64) if bag is None else bag,
        RATIO,
        **more,
    )

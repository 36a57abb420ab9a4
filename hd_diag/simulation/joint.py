"""A simulated robot joint: readings of its encoders and torque sensor during a motion.

A simulated joint has a drive, noise of its sensors and, optionally, a deviation from the drive's model.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from hd_diag.arrays import Floats, Times
from hd_diag.drive import Drive, transmission_error
from hd_diag.model import torsion_map
from hd_diag.model.torsion_map import TorsionMap
from hd_diag.simulation.motion import SECOND, Motion, Setpoints

START = 1_767_225_600_000_000_000
"""Default stamp of the first sample: 2026-01-01T00:00:00Z [ns]."""

CHUNK = 1000
"""Samples computed at a time, so that the exact solution's arrays stay in the processor's cache."""

_EXACT_SAMPLES = 10_000  # for more samples, a map takes less time than exact solutions


class Samples(NamedTuple):
    """True or reported state of a joint (n,): stamp [ns], angles [rad], velocity [rad/s], torque [N m]."""

    stamp: Times
    input_angle: Floats
    input_velocity: Floats
    output_angle: Floats
    torque: Floats


Alteration = Callable[[Samples], Samples]
"""Converts samples of the ideal drive to those of the real joint; called with consecutive parts, in order."""


@dataclass(frozen=True)
class Noise:
    """Noise of the sensors; raises ValueError that names an invalid value.

    The output angle has noise that is independent from sample to sample (`white`), and first-order
    autoregressive noise (`drift`, with its correlation from one sample to the next), both [rad rms]. The
    reported torque has white noise [N m rms].
    """

    white: float = 0.0
    drift: float = 0.0
    drift_correlation: float = 0.97
    torque: float = 0.0

    def __post_init__(self) -> None:
        for name, unit in (("white", "rad"), ("drift", "rad"), ("torque", "N m")):
            value = getattr(self, name)
            if not 0.0 <= value < math.inf:
                raise ValueError(f"noise: {name} must not be negative, not {value} {unit}")
        if not 0.0 <= self.drift_correlation < 1.0:
            raise ValueError(f"noise: drift_correlation must be in [0, 1), not {self.drift_correlation}")


@dataclass(frozen=True)
class SimulatedJoint:
    """A real joint.

    It has a drive, noise, and the `offset` of the output encoder's zero [rad]. `alter` is a deviation from
    the drive's model, applied before the noise. `torque_share` scales a motion's torques [-].
    """

    drive: Drive
    noise: Noise = field(default_factory=Noise)
    offset: float = 0.0
    alter: Alteration = lambda samples: samples
    torque_share: float = 1.0


def map_for(
    joint: SimulatedJoint, motion: Motion, wanted: Callable[[float], bool] = lambda fraction: True
) -> TorsionMap | None:
    """Map for the simulation of a joint's long motion; None if exact solutions take less time.

    For `wanted` see :func:`hd_diag.model.torsion_map.build`. Raises ValueError if the teeth cannot bear the
    motion's torque.
    """
    if motion.samples <= _EXACT_SAMPLES:
        return None
    torques = motion.under(joint.torque_share).torques
    limit = max(max(map(abs, torques)), 0.05 * joint.drive.rated_torque)
    return torsion_map.build(joint.drive.mesh, limit, wanted)


def parts(
    joint: SimulatedJoint,
    motion: Motion,
    rng: np.random.Generator,
    start: int = START,
    table: TorsionMap | None = None,
    chunk: int = CHUNK,
) -> Iterator[Samples]:
    """Yield the joint's readings from a stamp [ns] on, in consecutive parts of `chunk` samples.

    Without a map of its mesh every sample is solved exactly. `rng` spawns three generators, so the same state
    of `rng` gives the same samples. Raises ValueError if the teeth cannot bear the motion's torque.
    """
    noise, motion = joint.noise, motion.under(joint.torque_share)
    white, drift, torque = rng.spawn(3)
    correlation = noise.drift_correlation
    gain = noise.drift * math.sqrt(1.0 - correlation**2)
    state = correlation * noise.drift * drift.standard_normal(1)
    for first in range(0, motion.samples, chunk):
        stamp = motion.stamps(start, first, first + chunk)
        true = joint.alter(_exact(joint, stamp, motion.at((stamp - start) / SECOND), table))
        slow, state = lfilter([gain], [1.0, -correlation], drift.standard_normal(stamp.size), zi=state)
        angle = true.output_angle + (noise.white * white.standard_normal(stamp.size) + slow)
        load = true.torque + noise.torque * torque.standard_normal(stamp.size)
        yield true._replace(output_angle=angle, torque=load)


def simulate(joint: SimulatedJoint, motion: Motion, rng: np.random.Generator, start: int = START) -> Samples:
    """The joint's readings over a whole motion; see :func:`parts`."""
    every = list(parts(joint, motion, rng, start, map_for(joint, motion)))
    return Samples(*(np.concatenate(column) for column in zip(*every, strict=True)))


def _exact(joint: SimulatedJoint, stamp: Times, setpoints: Setpoints, table: TorsionMap | None) -> Samples:
    error = transmission_error(joint.drive, setpoints.input_angle, setpoints.torque, table)
    if not np.isfinite(error).all():
        beyond = setpoints.torque[~np.isfinite(error)]
        raise ValueError(f"the teeth cannot bear {beyond[np.argmax(np.abs(beyond))]:g} N m")
    output = setpoints.input_angle / joint.drive.kinematics.ratio + error + joint.offset
    return Samples(stamp, setpoints.input_angle, setpoints.input_velocity, output, setpoints.torque)

"""A simulated robot joint: what its encoders and torque sensor report while it runs through a motion.

The truth is a drive, the noise of its sensors and, where wanted, an alteration that no parameter expresses.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from hd_diag.arrays import Floats, Times
from hd_diag.bag import BagError, BagWriter, encode_joint_states
from hd_diag.bag.writer import replaced
from hd_diag.config.configuration import Config
from hd_diag.drive import Drive, transmission_error
from hd_diag.messages.publications import JOINT_STATE, TEMPERATURE
from hd_diag.messages.schemas import jazzy, serialize
from hd_diag.model import torsion_map
from hd_diag.model.torsion_map import TorsionMap

START = 1_767_225_600_000_000_000
"""Stamp of the first sample unless another is asked for: 2026-01-01T00:00:00Z [ns]."""

_TURN = 2.0 * math.pi
_SECOND = 1_000_000_000  # [ns]
_CHUNK = 1000  # samples at a time: the exact solution's arrays then stay in the cache
_EXACT_SAMPLES = 10_000  # beyond, building a map takes less time than the exact solution of every sample

# Warming of a joint at work, first order: small enough to be any size-25 joint's.
_AMBIENT, _RISE, _WARMING_TIME = 25.0, 8.0, 300.0  # [degree Celsius], [K], [s]


class Moments(NamedTuple):
    """What a motion asks for, each (n,): input angle [rad], input velocity [rad/s], torque [N m]."""

    input_angle: Floats
    input_velocity: Floats
    torque: Floats


class Record(NamedTuple):
    """What a joint does or reports, each (n,): stamp [ns], angles [rad], velocity [rad/s], torque [N m]."""

    stamp: Times
    input_angle: Floats
    input_velocity: Floats
    output_angle: Floats
    torque: Floats


Alteration = Callable[[Record], Record]
"""What a joint really does, from what its drive would do; called with consecutive parts, in order."""


def unaltered(record: Record) -> Record:
    """The record as it is."""
    return record


@dataclass(frozen=True)
class Motion:
    """Runs at constant speed and torque from rest to rest, one for every direction, speed and torque.

    All runs of one direction come first, so that the output travels far.

    Parameters
    ----------
    duration : float
        [s]; shared evenly by the runs.
    sample_rate : float
        [Hz]
    speeds : tuple of float
        Of the input [rad/s], positive.
    torques : tuple of float
        That the drive exerts on the link [N m].
    both_directions : bool
        Whether all runs are repeated backwards.
    ramp_share : float
        Part of a run in which speed and torque rise with minimum jerk, and again in which they fall [-].
    rest_share : float
        Part of a run at rest and free of torque before it starts, and again after it has ended [-].

    Raises
    ------
    ValueError
        Naming the value that cannot be.
    """

    duration: float = 60.0
    sample_rate: float = 500.0
    speeds: tuple[float, ...] = (1.0 * _TURN, 2.0 * _TURN, 4.0 * _TURN)
    torques: tuple[float, ...] = (-40.0, -14.0, 14.0, 40.0)
    both_directions: bool = True
    ramp_share: float = 0.1
    rest_share: float = 0.05

    def __post_init__(self) -> None:
        for name, value, unit in (("duration", self.duration, "s"), ("sample_rate", self.sample_rate, "Hz")):
            if not 0.0 < value < math.inf:
                raise ValueError(f"{name} must be positive and finite, not {value} {unit}")
        if not self.speeds or not all(0.0 < speed < math.inf for speed in self.speeds):
            raise ValueError(f"speeds must be positive and finite, not {list(self.speeds)} rad/s")
        if not self.torques or not all(math.isfinite(torque) for torque in self.torques):
            raise ValueError(f"torques must be finite, not {list(self.torques)} N m")
        if not (self.ramp_share > 0.0 and 0.0 <= self.rest_share <= 0.5 - self.ramp_share):
            raise ValueError(
                f"ramp_share must be positive and rest_share not negative, both together at most 0.5, not "
                f"{self.ramp_share} and {self.rest_share}"
            )
        if self.samples < 1:
            raise ValueError(f"{self.duration} s at {self.sample_rate} Hz hold no sample")

    @property
    def samples(self) -> int:
        """Number of samples."""
        return round(self.duration * self.sample_rate)

    @property
    def runs(self) -> list[tuple[float, float]]:
        """Velocity of the input [rad/s] and torque [N m] of every run."""
        forward = list(itertools.product(self.speeds, self.torques))
        return forward + [(-speed, torque) for speed, torque in forward if self.both_directions]

    def stamps(self, start: int, first: int, last: int) -> Times:
        """Time of the samples from `first` to before `last` [ns]; `start` is that of sample 0."""
        count = np.arange(first, min(last, self.samples))
        elapsed: Times = np.rint(count * (_SECOND / self.sample_rate)).astype(np.int64)
        return start + elapsed

    def at(self, time: Floats) -> Moments:
        """What the motion asks for.

        Parameters
        ----------
        time : ndarray, shape (n,)
            Since the start [s]; before it and after the end the joint is at rest.

        Returns
        -------
        Moments
        """
        velocity, torque = np.array(self.runs).T
        length = self.duration / velocity.size
        travelled = (1.0 - 2.0 * self.rest_share - self.ramp_share) * length * velocity
        before = np.concatenate(([0.0], np.cumsum(travelled)))[:-1]
        run = np.clip(np.floor(time / length), 0, velocity.size - 1).astype(np.int64)
        ramp = self.ramp_share * length
        since = time - run * length - self.rest_share * length
        until = (1.0 - 2.0 * self.rest_share) * length - since
        share = _smooth_step(since / ramp) * _smooth_step(until / ramp)
        moving = ramp * (_step_integral(since / ramp) - _step_integral(1.0 - until / ramp))
        return Moments(before[run] + velocity[run] * moving, velocity[run] * share, torque[run] * share)


def _smooth_step(x: Floats) -> Floats:
    """Minimum-jerk rise from 0 at x = 0 to 1 at x = 1; Flash and Hogan (1985)."""
    x = np.clip(x, 0.0, 1.0)
    return x**3 * (10.0 - x * (15.0 - 6.0 * x))


def _step_integral(x: Floats) -> Floats:
    """Integral of `_smooth_step` from minus infinity to x."""
    rising = np.clip(x, 0.0, 1.0)
    return rising**4 * (2.5 - rising * (3.0 - rising)) + np.maximum(x - 1.0, 0.0)


@dataclass(frozen=True)
class Noise:
    """Noise of the sensors.

    Parameters
    ----------
    white : float
        Of the output angle, independent from sample to sample [rad rms].
    drift : float
        Of the output angle, first-order autoregressive [rad rms].
    drift_correlation : float
        Correlation of the drift from one sample to the next [-].
    torque : float
        Of the reported torque, white [N m rms].

    Raises
    ------
    ValueError
        Naming the value that cannot be.
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
    """What a joint really is.

    Parameters
    ----------
    drive : Drive
    noise : Noise
    offset : float
        Of the output encoder's zero [rad].
    alter : Alteration
        Departure from the drive's model; it comes before the noise. Identity by default.
    """

    drive: Drive
    noise: Noise = field(default_factory=Noise)
    offset: float = 0.0
    alter: Alteration = unaltered


def table(
    drive: Drive, motion: Motion, wanted: Callable[[float], bool] = lambda fraction: True
) -> TorsionMap | None:
    """Map that a long motion is simulated with; None where solving every sample exactly takes less time.

    Parameters
    ----------
    drive : Drive
    motion : Motion
    wanted : callable
        As of :func:`hd_diag.model.torsion_map.build`.

    Raises
    ------
    ValueError
        If the teeth cannot bear the motion's torque.
    """
    if motion.samples <= _EXACT_SAMPLES:
        return None
    limit = max(max(map(abs, motion.torques)), 0.05 * drive.rated_torque)
    return torsion_map.build(drive.mesh, limit, wanted)


def parts(
    joint: SimulatedJoint,
    motion: Motion,
    rng: np.random.Generator,
    start: int = START,
    table: TorsionMap | None = None,
) -> Iterator[Record]:
    """What the joint reports, in consecutive parts.

    Parameters
    ----------
    joint : SimulatedJoint
    motion : Motion
    rng : numpy.random.Generator
        Three are spawned of it: the same seed gives the same record.
    start : int
        Stamp of the first sample [ns].
    table : TorsionMap, optional
        Of the drive's mesh; without one every sample is solved exactly.

    Yields
    ------
    Record

    Raises
    ------
    ValueError
        If the teeth cannot bear the motion's torque.
    """
    disturb = _Disturbance(joint.noise, rng)
    for first in range(0, motion.samples, _CHUNK):
        stamp = motion.stamps(start, first, first + _CHUNK)
        exact = _exact(joint, stamp, motion.at((stamp - start) / _SECOND), table)
        yield disturb(joint.alter(exact))


def simulate(joint: SimulatedJoint, motion: Motion, rng: np.random.Generator, start: int = START) -> Record:
    """What the joint reports over a whole motion; see :func:`parts`."""
    every = list(parts(joint, motion, rng, start, table(joint.drive, motion)))
    return Record(*(np.concatenate(column) for column in zip(*every, strict=True)))


def temperature(time: Floats) -> Floats:
    """Temperature of a joint at work [degree Celsius] at times since its start [s]."""
    return np.asarray(_AMBIENT - _RISE * np.expm1(-np.maximum(time, 0.0) / _WARMING_TIME))


def write_bag(
    path: str | Path,
    config: Config,
    motion: Motion,
    truths: Mapping[str, SimulatedJoint] | None = None,
    *,
    seed: int = 0,
    start: int = START,
    with_temperature: bool = False,
    overwrite: bool = False,
    mapped: Callable[[float], None] = lambda fraction: None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> int:
    """Write ``/joint_states``, all joints in each message, and optionally ``/<joint>/temperature`` at 1 Hz.

    Parameters
    ----------
    path : path
        ``*.mcap`` is one file, anything else a rosbag2 folder.
    config : Config
        Gives the names in JointState, and the drives of joints without a truth.
    motion : Motion
        Of all joints.
    truths : mapping, optional
        Joints to simulate, by their names in `config`; all as configured and without noise where not given.
    seed : int
        Every joint has its own noise.
    start : int
        Stamp of the first sample [ns].
    with_temperature : bool
    overwrite : bool
        Replace a bag that exists, once the new one is whole: after an error or Ctrl-C it is as it was.
    mapped : callable
        Called with the fraction done of the maps that a long motion needs, before anything is written.
    progress : callable
        Called with the samples of each joint that are written and their number. If it raises
        KeyboardInterrupt, a new bag is finished with what it has; after an error it is left without its end.

    Returns
    -------
    int
        Number of samples of each joint.

    Raises
    ------
    BagError
        If the bag cannot be written.
    ValueError
        If `truths` names a joint that is not configured, or teeth cannot bear the motion's torque.
    """
    if Path(path).exists() and not overwrite:
        raise BagError(path, "exists already")
    joints = _joints(config, truths)
    tables = _tables(joints, motion, mapped)
    simulated = [joint for joint in config.joints if joint.name in joints]
    names = [name for joint in simulated for name in (joint.input_joint, joint.output_joint)]
    generators = np.random.default_rng(seed).spawn(len(joints))
    streams = [
        parts(joint, motion, rng, start, tables[joint.drive])
        for joint, rng in zip(joints.values(), generators, strict=True)
    ]
    done, warmed = 0, 0
    with replaced(path, overwrite=overwrite) as place, BagWriter(place, overwrite=overwrite) as writer:
        for records in zip(*streams, strict=True):
            _write_joint_states(writer, names, joints, records)
            last = (int(records[0].stamp[-1]) - start) // _SECOND
            if with_temperature:
                _write_temperatures(writer, list(joints), range(warmed, last + 1), start)
            done, warmed = done + records[0].stamp.size, last + 1
            progress(done, motion.samples)
    return done


class _Disturbance:
    """Noise of one joint; carries the drift from part to part."""

    def __init__(self, noise: Noise, rng: np.random.Generator) -> None:
        self._noise = noise
        self._white, self._drift, self._torque = rng.spawn(3)
        self._state = noise.drift_correlation * noise.drift * self._drift.standard_normal(1)

    def __call__(self, record: Record) -> Record:
        noise, count = self._noise, record.stamp.size
        correlation = noise.drift_correlation
        gain = noise.drift * math.sqrt(1.0 - correlation**2)
        innovation = self._drift.standard_normal(count)
        drift, self._state = lfilter([gain], [1.0, -correlation], innovation, zi=self._state)
        angle = noise.white * self._white.standard_normal(count) + drift
        torque = noise.torque * self._torque.standard_normal(count)
        return record._replace(output_angle=record.output_angle + angle, torque=record.torque + torque)


def _exact(joint: SimulatedJoint, stamp: Times, moments: Moments, table: TorsionMap | None) -> Record:
    error = transmission_error(joint.drive, moments.input_angle, moments.torque, table)
    if not np.isfinite(error).all():
        beyond = moments.torque[~np.isfinite(error)]
        raise ValueError(f"the teeth cannot bear {beyond[np.argmax(np.abs(beyond))]:g} N m")
    output = moments.input_angle / joint.drive.kinematics.ratio + error + joint.offset
    return Record(stamp, moments.input_angle, moments.input_velocity, output, moments.torque)


def _joints(config: Config, truths: Mapping[str, SimulatedJoint] | None) -> dict[str, SimulatedJoint]:
    """Joints to simulate, in the configuration's order."""
    configured = {joint.name: joint.drive for joint in config.joints}
    if truths is None:
        return {name: SimulatedJoint(drive) for name, drive in configured.items()}
    for name in truths:
        if name not in configured:
            raise ValueError(f"no joint '{name}' is configured; there are {', '.join(configured)}")
    if not truths:
        raise ValueError("no joint is to be simulated")
    return {name: truths[name] for name in configured if name in truths}


def _tables(
    joints: Mapping[str, SimulatedJoint], motion: Motion, progress: Callable[[float], None]
) -> dict[Drive, TorsionMap | None]:
    """Map of every drive; joints with the same drive share it."""
    drives = list(dict.fromkeys(joint.drive for joint in joints.values()))

    def report(number: int) -> Callable[[float], bool]:
        def wanted(fraction: float) -> bool:
            progress((number + fraction) / len(drives))
            return True

        return wanted

    tables = {drive: table(drive, motion, report(number)) for number, drive in enumerate(drives)}
    if any(tables.values()):
        progress(1.0)
    return tables


def _write_joint_states(
    writer: BagWriter,
    names: list[str],
    joints: Mapping[str, SimulatedJoint],
    records: tuple[Record, ...],
) -> None:
    """One message for each sample; the effort of an input, which no sensor measures, is 0."""
    stamp = records[0].stamp
    position, velocity, effort = [], [], []
    for joint, record in zip(joints.values(), records, strict=True):
        position += [record.input_angle, record.output_angle]
        velocity += [record.input_velocity, record.input_velocity / joint.drive.kinematics.ratio]
        effort += [np.zeros(stamp.size), record.torque]
    columns = [np.stack(values, axis=1) for values in (position, velocity, effort)]
    rows = encode_joint_states(names, stamp, columns[0], columns[1], columns[2])
    writer.write_many("/joint_states", JOINT_STATE, rows, stamp)


def _write_temperatures(writer: BagWriter, joints: list[str], seconds: range, start: int) -> None:
    types = jazzy().types
    for second in seconds:
        time = start + second * _SECOND
        clock = types["builtin_interfaces/msg/Time"](*divmod(time, _SECOND))
        value = float(temperature(np.array([float(second)]))[0])
        reading = types[TEMPERATURE](types["std_msgs/msg/Header"](clock, ""), value, 0.0)
        message = serialize(reading, TEMPERATURE)
        for joint in joints:
            writer.write(f"/{joint}/temperature", TEMPERATURE, message, time)

"""Bags of simulated joints: ``/joint_states`` and temperatures as a robot's driver would record them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from hd_diag.arrays import Bytes, Floats
from hd_diag.bag import BagError, BagWriter, replaced
from hd_diag.config.configuration import Config
from hd_diag.drive import Drive
from hd_diag.messages.encoding import encode_joint_states
from hd_diag.messages.publications import JOINT_STATE, TEMPERATURE
from hd_diag.messages.schemas import jazzy, serialize
from hd_diag.model.torsion_map import TorsionMap
from hd_diag.simulation.joint import CHUNK, START, Samples, SimulatedJoint, map_for, parts
from hd_diag.simulation.motion import SECOND, Motion

# First-order warming of a joint at work, small enough for any joint of size 25.
_AMBIENT, _RISE, _WARMING_TIME = 25.0, 8.0, 300.0  # [degree Celsius], [K], [s]


def write_bag(
    path: str | Path,
    config: Config,
    motion: Motion,
    rng: np.random.Generator,
    truths: Mapping[str, SimulatedJoint] | None = None,
    *,
    start: int = START,
    with_temperature: bool = False,
    overwrite: bool = False,
    chunk: int = CHUNK,
    mapped: Callable[[float], None] = lambda fraction: None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> int:
    """Write ``/joint_states``, all joints in each message, and optionally ``/<joint>/temperature`` at 1 Hz.

    Parameters
    ----------
    path : path
        ``*.mcap`` is one file, anything else a rosbag2 folder.
    config, truths
        Configuration with the names in JointState, and the joints to simulate by their names in `config`; by
        default all as configured and without noise. `rng` spawns a generator of noise for each.
    start : int
        Stamp of the first sample [ns]; `chunk` samples are computed and written at a time.
    overwrite : bool
        Replace an existing bag once the new one is whole; after an error or Ctrl-C it is unchanged.
    mapped, progress : callable
        `mapped` is called with the finished fraction of the maps that a long motion needs, `progress` with
        the samples written and in all. If `progress` raises KeyboardInterrupt, a new bag is finished with
        these samples; after an error it is left without its end.

    Raises
    ------
    BagError, ValueError
        If the bag cannot be written; if `truths` names a joint that is not configured, or teeth cannot bear
        the motion's torque.
    """
    if Path(path).exists() and not overwrite:
        raise BagError(path, "exists already")
    configured = {joint.name: joint for joint in config.joints}
    truths = truths or {name: SimulatedJoint(joint.drive) for name, joint in configured.items()}
    for name in truths.keys() - configured.keys():
        raise ValueError(f"no joint '{name}' is configured; there are {', '.join(configured)}")
    joints = {name: truths[name] for name in configured if name in truths}
    maps = _maps(joints, motion, mapped)
    names = [n for name in joints for n in (configured[name].input_joint, configured[name].output_joint)]
    streams = [
        parts(joint, motion, generator, start, maps[joint.drive], chunk)
        for joint, generator in zip(joints.values(), rng.spawn(len(joints)), strict=True)
    ]
    ratios = [joint.drive.kinematics.ratio for joint in joints.values()]
    done, warmed = 0, 0
    with replaced(path, overwrite=overwrite) as place, BagWriter(place, overwrite=overwrite) as writer:
        for samples in zip(*streams, strict=True):
            stamp = samples[0].stamp
            writer.write_many("/joint_states", JOINT_STATE, encode_samples(names, ratios, samples), stamp)
            last = (int(stamp[-1]) - start) // SECOND
            if with_temperature:
                _write_temperatures(writer, list(joints), range(warmed, last + 1), start)
            done, warmed = done + stamp.size, last + 1
            progress(done, motion.samples)
    return done


def temperature(time: Floats) -> Floats:
    """Temperature of a joint at work [degree Celsius] at times since its start [s]."""
    return np.asarray(_AMBIENT - _RISE * np.expm1(-np.maximum(time, 0.0) / _WARMING_TIME))


def encode_samples(names: Sequence[str], ratios: Sequence[float], samples: Sequence[Samples]) -> Bytes:
    """JointState messages, one row of CDR for each sample.

    `names` has the input's and the output's name of each joint, `ratios` its ratio, `samples` its samples;
    all joints have the same stamps. The effort of an input is 0, because no sensor measures it.
    """
    position, velocity, effort = [], [], []
    for ratio, joint in zip(ratios, samples, strict=True):
        position += [joint.input_angle, joint.output_angle]
        velocity += [joint.input_velocity, joint.input_velocity / ratio]
        effort += [np.zeros(joint.torque.size), joint.torque]
    angles, speeds, torques = (np.stack(columns, axis=1) for columns in (position, velocity, effort))
    return encode_joint_states(list(names), samples[0].stamp, angles, speeds, torques)


def _maps(
    joints: Mapping[str, SimulatedJoint], motion: Motion, progress: Callable[[float], None]
) -> dict[Drive, TorsionMap | None]:
    """Map of every drive; joints with the same drive share it."""
    drives = {joint.drive: joint for joint in joints.values()}
    maps: dict[Drive, TorsionMap | None] = {}

    def wanted(fraction: float) -> bool:
        progress((len(maps) + fraction) / len(drives))
        return True

    for drive, joint in drives.items():
        maps[drive] = map_for(joint, motion, wanted)
    if any(maps.values()):
        progress(1.0)
    return maps


def _write_temperatures(writer: BagWriter, joints: list[str], seconds: range, start: int) -> None:
    types = jazzy().types
    for second, value in zip(seconds, temperature(np.array(seconds, float)).tolist(), strict=True):
        time = start + second * SECOND
        clock = types["builtin_interfaces/msg/Time"](*divmod(time, SECOND))
        reading = types[TEMPERATURE](types["std_msgs/msg/Header"](clock, ""), value, 0.0)
        message = serialize(reading, TEMPERATURE)
        for joint in joints:
            writer.write(f"/{joint}/temperature", TEMPERATURE, message, time)

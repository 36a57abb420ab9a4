"""Records of a simulated drive: true motion, reported signals, and files of them."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_typestore

from challenge import mechanics, noise
from challenge.cause import Cause, Scene
from challenge.contact import Flaws, Gear
from challenge.design import Array
from challenge.motion import Motion
from challenge.noise import TORQUE_NOISE
from challenge.page import PageJoint, Spring
from challenge.truth import Base

JOINT = "joint_1"
EPOCH = 1_760_000_000  # [s], first stamp in a bag
AMBIENT, RISE, HEATING = 25.0, 9.0, 70.0  # [°C], [K], [s]


@dataclass(frozen=True)
class Record:
    """Columns (n,) of one joint, and the truth about them.

    Attributes
    ----------
    time : stamps from 0 [s]
    input_angle, output_angle : as reported [rad]
    torque : as reported [N m], or None where nothing measures it
    temperature : as reported [°C], interpolated linearly between readings at 1 Hz, or None
    runs : index of the first sample of every run
    part : index of the recording that each sample comes from
    clean_output : output angle that belongs to the reported input, without noise and outliers [rad]
    truth : base, effects (sizes), hidden (catalogue names to be found), optional (true names that need not be
        found), unknown, noise_rms [rad], recording
    base, causes, motion : what the record was made from
    """

    time: Array
    input_angle: Array
    output_angle: Array
    torque: Array | None
    temperature: Array | None
    runs: NDArray[np.intp]
    part: NDArray[np.intp]
    clean_output: Array
    truth: dict[str, Any]
    base: Base
    causes: tuple[Cause, ...]
    motion: Motion


@dataclass(frozen=True)
class Recording:
    """How a record is taken: noise family and scale, shares of dropouts and outliers, jitter, sensors.

    An encoder of b bits counts in steps of a turn over 2^b; 0 bits mean no quantisation. If a record has
    several ``parts``, each has a random encoder offset [rad].
    """

    noise: str = "autoregressive"
    noise_scale: float = 1.0
    torque_constant: float = 0.0  # [N m/A] as the user believes it, if current is reported as torque
    torque_noise: float = TORQUE_NOISE  # [N m]
    input_bits: int = 0
    output_bits: int = 0
    parts: int = 1
    offset_spread: float = 0.0  # [rad]
    dropouts: float = 0.0
    outliers: float = 0.0
    jitter: float = 0.0  # [s]
    torque: bool = True
    temperature: bool = True
    rate: float = 500.0  # [Hz]


PLAIN = Recording()


# What happens ---


def scene(motion: Motion, time: Array) -> Scene:
    """True motion at moments [s] in ascending order."""
    warm = mechanics.warming(time, AMBIENT, RISE, HEATING)
    return Scene(
        time,
        motion.angle(time),
        motion.speed(time),
        motion.torque(time),
        warm,
        motion.run_of(time),
        motion.design,
    )


def borne(causes: Sequence[Cause], seen: Scene) -> Scene:
    """Scene with the torque that the mesh bears: the link's plus friction ahead of the torque sensor."""
    torque = np.asarray(seen.torque + sum(cause.load(seen) for cause in causes), dtype=np.float64)
    return dataclasses.replace(seen, torque=torque)


def gear(base: Base, causes: Sequence[Cause]) -> Gear | Spring:
    """Mesh with the flaws of all causes; for a joint from a catalogue page its spring."""
    if isinstance(base, PageJoint):
        return Spring(base.design)
    flaws = Flaws()
    for each in (cause.flaws(base.design) for cause in causes):
        flaws = flaws if each is None else flaws + each
    return Gear(base, flaws)


def mean_torsion(mesh: Gear | Spring, cup_torque: Array) -> Array:
    """Torsion (n,) [rad] at cup torques (n,) [N m], averaged over a turn of the wave generator."""
    levels = np.r_[-np.geomspace(200, 0.01, 60), np.geomspace(0.01, 200, 60)]
    angles = np.linspace(0, 2 * np.pi, 101, endpoint=False)
    grid = np.meshgrid(angles, levels)
    curve = mesh.torsion(grid[0].ravel(), grid[1].ravel()).reshape(grid[0].shape).mean(axis=1)
    return np.interp(cup_torque, levels, curve)


@functools.lru_cache(maxsize=4)
def _torsion(
    base: Base, flawed: tuple[Cause, ...], shaft: bytes, torque: bytes
) -> tuple[Gear | Spring, Array]:
    """Mesh and its torsion (n,) [rad]; cached, because :func:`contribution` evaluates drives repeatedly."""
    mesh = gear(base, flawed)
    return mesh, mesh.torsion(-np.frombuffer(shaft), -np.frombuffer(torque))


def output(base: Base, causes: Sequence[Cause], seen: Scene) -> Array:
    """Reported output angle (n,) [rad] of a drive, without noise."""
    shaft = seen.motor
    for cause in causes:
        shaft = cause.shaft(shaft)
    flawed = tuple(cause for cause in causes if type(cause).flaws is not Cause.flaws)
    seen = borne(causes, seen)
    mesh, torsion = _torsion(base, flawed, shaft.tobytes(), seen.torque.tobytes())
    error = torsion - base.cup * seen.torque + base.offset
    for cause in causes:
        error = error + cause.added(seen)
    if any(type(cause).carried is not Cause.carried for cause in causes):
        ripple = torsion - mean_torsion(mesh, -seen.torque)
        error = error + sum(cause.carried(seen, ripple) for cause in causes)
    angle = shaft / base.design.ratio + error
    for cause in causes:
        angle = cause.output_reading(angle)
    return angle


def transmission_error(base: Base, causes: Sequence[Cause], motion: Motion, time: Array) -> Array:
    """Reported output less reported input over the ratio (n,) [rad], without noise, at moments [s]."""
    late = sum(cause.delay for cause in causes)
    reported = motion.angle(time)
    for cause in causes:
        reported = cause.input_reading(reported)
    return output(base, causes, scene(motion, time - late)) - reported / base.design.ratio


def contribution(base: Base, causes: Sequence[Cause], cause: Cause, motion: Motion, time: Array) -> Array:
    """Signal (n,) [rad] that one of the causes adds to the error, as the drive's sensors see it."""
    others = [each for each in causes if each is not cause]
    seen = scene(motion, time - sum(each.delay for each in others))
    if type(cause).torque_reading is Cause.torque_reading:
        without = transmission_error(base, others, motion, time)
    else:
        believed = dataclasses.replace(seen, torque=cause.torque_reading(seen.torque, seen))
        without = transmission_error(base, others, motion, time) + (
            output(base, others, believed) - output(base, others, seen)
        )
    return transmission_error(base, causes, motion, time) - without


def added_by(record: Record, name: str) -> Array:
    """Signal (n,) [rad] that the named cause adds at the moments of a record; its std is the amplitude."""
    cause = next(cause for cause in record.causes if cause.name == name)
    return contribution(record.base, record.causes, cause, record.motion, record.time)


def simulate(
    base: Base,
    causes: Sequence[Cause],
    motion: Motion,
    rng: np.random.Generator,
    recording: Recording = PLAIN,
    optional: Sequence[str] = (),
) -> Record:
    """Record of a drive with faults, as its sensors report it; ``optional`` names need not be found."""
    time = motion.times(recording.rate)
    if recording.jitter:
        time = noise.jittered(rng, time, recording.jitter)
    error = transmission_error(base, causes, motion, time)
    angle, torque = motion.angle(time), motion.torque(time)
    happens = borne(causes, scene(motion, time))
    for cause in causes:
        angle, torque = cause.input_reading(angle), cause.torque_reading(torque, happens)
    part = np.arange(len(time)) * recording.parts // len(time)
    if recording.parts > 1:
        error = error + (recording.offset_spread * rng.standard_normal(recording.parts))[part]
    clean = angle / base.design.ratio + error
    disturbance = recording.noise_scale * noise.FAMILIES[recording.noise](rng, len(time))
    torque = torque + recording.torque_noise / (recording.torque_constant or 1.0) * rng.standard_normal(
        len(time)
    )
    wild = noise.outliers(rng, len(time), recording.outliers)
    keep = noise.kept(rng, len(time), recording.dropouts)
    readings = np.arange(np.floor(time[-1]) + 1)
    degrees = mechanics.warming(readings, AMBIENT, RISE, HEATING) + 0.01 * rng.standard_normal(len(readings))
    run = motion.run_of(time[keep])
    reported = noise.counted(clean + disturbance + wild, recording.output_bits)
    counted = noise.counted(angle, recording.input_bits)
    clean = clean + (counted - angle) / base.design.ratio  # input quantisation is noise, too
    truth = {
        "base": base.as_dict(),
        "effects": {cause.name: cause.as_dict() for cause in causes},
        "hidden": [cause.name for cause in causes if cause.known and cause.name not in optional],
        "optional": [cause.name for cause in causes if cause.name in optional]
        + ["torque_gain"] * bool(recording.torque_constant)
        + sorted({name for cause in causes for name in cause.may_be}),
        "unknown": [cause.name for cause in causes if not cause.known],
        "noise_rms": float((reported - clean - wild).std()),
        "recording": vars(recording),
    }
    return Record(
        time=time[keep],
        input_angle=counted[keep],
        output_angle=reported[keep],
        torque=torque[keep] if recording.torque else None,
        temperature=np.interp(time, readings, degrees)[keep] if recording.temperature else None,
        runs=np.flatnonzero(np.diff(run, prepend=-1)),
        part=part[keep],
        clean_output=clean[keep],
        truth=truth,
        base=base,
        causes=tuple(causes),
        motion=motion,
    )


# Files ---


def columns(record: Record) -> dict[str, Array]:
    """Columns by their names in the CSV file."""
    named = {"time": record.time, "input": record.input_angle, "output": record.output_angle}
    more = {"torque": record.torque, "temperature": record.temperature}
    return named | {name: column for name, column in more.items() if column is not None}


def write_csv(record: Record, path: Path) -> None:
    """Write columns with a header line, numbers at full precision."""
    named = columns(record)
    table = np.stack(list(named.values()), axis=1)
    np.savetxt(path, table, "%.17g", delimiter=",", header=",".join(named), comments="")


def write_bag(record: Record, path: Path, joint: str = JOINT) -> None:
    """Write an MCAP bag: joint_states with input (``<joint>_motor``) and output, temperature at 1 Hz."""
    streams = [("/joint_states", "sensor_msgs/msg/JointState", *_joint_states(record, joint))]
    if record.temperature is not None:
        seconds = np.arange(np.ceil(record.time[0]), np.floor(record.time[-1]) + 1)
        degrees = np.interp(seconds, record.time, record.temperature).tolist()
        fields = ({"temperature": value, "variance": 0.0} for value in degrees)
        streams.append((f"/{joint}/temperature", "sensor_msgs/msg/Temperature", seconds, fields))
    store = get_typestore(Stores.ROS2_HUMBLE)
    header, moment = (store.types[kind] for kind in ("std_msgs/msg/Header", "builtin_interfaces/msg/Time"))
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="test")
        for topic, kind, time, messages in streams:
            text = store.generate_msgdef(kind, ros_version=2)[0]
            channel = writer.register_channel(
                topic, "cdr", writer.register_schema(kind, "ros2msg", text.encode())
            )
            stamps = EPOCH * 10**9 + np.rint((time - min(time[0], 0.0)) * 1e9).astype(np.int64)
            for stamp, fields in zip(stamps.tolist(), messages, strict=True):
                stamped = header(stamp=moment(sec=stamp // 10**9, nanosec=stamp % 10**9), frame_id="")
                data = store.serialize_cdr(store.types[kind](header=stamped, **fields), kind)
                writer.add_message(channel, stamp, data, stamp)
        writer.finish()


def _joint_states(record: Record, joint: str) -> tuple[Array, Iterator[dict[str, Any]]]:
    """Stamps [s] and fields of the messages."""
    names, nothing = [f"{joint}_motor", joint], np.zeros(0)
    position = np.stack([record.input_angle, record.output_angle], axis=1)
    torque = np.zeros(0) if record.torque is None else record.torque
    effort = np.stack([np.zeros_like(torque), torque], axis=1) if torque.size else [nothing] * len(position)
    return record.time, (
        {"name": names, "position": angles, "velocity": nothing, "effort": efforts}
        for angles, efforts in zip(position, effort, strict=True)
    )

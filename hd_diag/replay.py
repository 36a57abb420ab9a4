"""The monitor over a recorded bag, in the bag's time, as fast as the machine goes."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hd_diag.bag import BagError, BagWriter, check_output
from hd_diag.bag.reader import BagReader, Batch
from hd_diag.config import Config, resolve
from hd_diag.map_builder import map_of
from hd_diag.messages import JOINT_STATE, STRING, TEMPERATURE, Encoded, read_string, resolved
from hd_diag.model.torsion import Mesh
from hd_diag.model.torsion_map import TorsionMap
from hd_diag.samples import JointStates, Times
from hd_diag.session import EVENTS, Session

NODE = "/hd_diag"
_OWN_OUTPUTS = ("/transmission_error", "/measured_transmission_error", "/residual")
_NANOSECONDS = 1_000_000_000

Progress = Callable[[int], None]


@dataclass
class Replay:
    """What a replay did.

    Attributes
    ----------
    reproduced : bool
        Whether the bag is the node's own log and its events were followed; else the given configuration was used.
    messages, written : int
        Messages read and written.
    duration : float
        Time from the first to the last input [s].
    rejected, missed : dict of str to int
        By joint: samples that could not be used, and samples that the stamps say were never recorded.
    last_rejection : dict of str to str
    problems : list of str
        What is wrong with the bag itself.
    joints : tuple of str
        Joints that had samples.
    """

    reproduced: bool
    messages: int = 0
    written: int = 0
    duration: float = 0.0
    rejected: dict[str, int] = field(default_factory=dict)
    missed: dict[str, int] = field(default_factory=dict)
    last_rejection: dict[str, str] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    joints: tuple[str, ...] = ()


def replay(
    bag: str | Path,
    out: str | Path,
    config: Config | None = None,
    *,
    topics: tuple[str, ...] = (),
    overwrite: bool = False,
    progress: Progress = lambda messages: None,
) -> Replay:
    """Run the monitor over a bag and write what the node would have published.

    Parameters
    ----------
    bag : path
        Bag of any storage that rosbag2 has, or the node's own log.
    out : path
        Bag to write: inputs, outputs and events, as in the node's log.
    config : Config, optional
        Without it the bag must be a node's log: its configuration, and every change of it, is followed, and the
        outputs are those of the live run, to the last bit.
    topics : tuple of str, optional
        Topics with joint states; by default all but the node's own outputs.
    overwrite : bool, optional
    progress : callable, optional
        Called with the number of messages done since the last call.

    Returns
    -------
    Replay

    Raises
    ------
    BagError
        Where the bag cannot be read, holds no joint states or events, or the output cannot be written.
    ConfigError
        Where a recorded configuration cannot be used.
    """
    check_output(out, bag)
    with BagReader(bag) as reader:
        recorded = _events_topic(reader) if config is None else None
        if config is None and recorded is None:
            raise BagError(bag, "is no log of the node, so a configuration is needed (--config)")
        inputs = list(topics) or _input_topics(reader, recorded)
        with BagWriter(out, overwrite=overwrite) as writer:
            run = _Run(reader, writer, recorded)
            wanted = [*inputs, *_temperature_topics(reader), *([recorded] if recorded else [])]
            if config is not None:
                run.begin(reader.start, config)
            for batch in reader.batches(wanted):
                run.batch(batch)
                progress(len(batch.log_time))
            return run.result()


def _events_topic(reader: BagReader) -> str | None:
    """Topic of the events of the node that wrote the bag."""
    suffix = EVENTS[1:]
    return next((t.name for t in reader.topics if t.type_name == STRING and t.name.endswith(suffix)), None)


def _input_topics(reader: BagReader, events: str | None) -> list[str]:
    node = events[: -len(EVENTS[1:])] if events else NODE
    own = {node + suffix for suffix in _OWN_OUTPUTS}
    found = [t.name for t in reader.topics if t.type_name == JOINT_STATE and t.name not in own]
    if not found:
        raise BagError(reader.path, "has no topic with sensor_msgs/msg/JointState")
    return found


def _temperature_topics(reader: BagReader) -> list[str]:
    return [t.name for t in reader.topics if t.type_name == TEMPERATURE]


class _Run:
    """State of a replay: a session fed with batches, its results written."""

    def __init__(self, reader: BagReader, writer: BagWriter, events: str | None) -> None:
        self._reader = reader
        self._writer = writer
        self._events = events
        self._node = events[: -len(EVENTS[1:])] if events else NODE
        self._session: Session | None = None
        self._next_report: int | None = None
        self._maps: dict[tuple[Mesh, float | None], TorsionMap] = {}
        self._replay = Replay(events is not None, problems=list(reader.problems))

    def begin(self, now: int, config: Config) -> None:
        """Start the session; without recorded events every joint gets its map at once."""
        self._session = Session(config, self._write, self._node)
        self._session.start(now)
        if self._events is None:
            for joint in config.joints:
                self._use_map(now, joint.name, None)

    def batch(self, batch: Batch) -> None:
        """Take messages of one topic."""
        if batch.topic.name == self._events:
            for now, data in zip(batch.log_time.tolist(), batch.messages(), strict=True):
                self._event(now, _event(self._reader.path, bytes(data)))
            return
        if self._session is None:
            raise BagError(self._reader.path, "inputs stand before the log's first configuration")
        for part, times in self._until_reports(batch):
            self._inputs(part, times)

    def result(self) -> Replay:
        """Account of the whole replay."""
        result = self._replay
        if self._session is not None:
            joints = self._session.monitor.joints
            result.rejected = {name: joint.rejected for name, joint in joints.items()}
            result.missed = {name: joint.missed for name, joint in joints.items()}
            result.last_rejection = {name: joint.last_rejection for name, joint in joints.items()}
            result.joints = tuple(name for name, joint in joints.items() if joint.samples)
        result.duration = self._reader.duration
        result.written = self._writer.message_count
        return result

    def _until_reports(self, batch: Batch) -> Iterator[tuple[Batch, Times]]:
        """The batch, cut where a report is due by the bag's time."""
        times = batch.log_time
        if self._events is not None:
            yield batch, times
            return
        begin = 0
        while begin < times.size:
            if self._next_report is None:
                self._next_report = int(times[0]) + self._period
            end = begin + int(np.searchsorted(times[begin:], self._next_report))
            if end > begin:
                yield _part(batch, slice(begin, end)), times[begin:end]
                begin = end
            if begin < times.size:
                self._report(self._next_report)
                self._next_report += self._period

    @property
    def _period(self) -> int:
        assert self._session is not None
        return round(_NANOSECONDS / self._session.config.diagnostics_rate)

    def _report(self, now: int) -> None:
        assert self._session is not None
        self._session.tick(
            now, now, {"latency_p99_us": "nan", "log_state": f"writing {self._writer.paths[0]}"}
        )

    def _inputs(self, batch: Batch, times: Times) -> None:
        assert self._session is not None
        self._replay.messages += times.size
        payload = batch.payload
        if isinstance(payload, np.ndarray):
            self._writer.write_many(batch.topic.name, batch.topic.type_name, payload, times)
        else:
            rows = [bytes(data) for data in payload]
            self._writer.write_many(batch.topic.name, batch.topic.type_name, rows, times)
        if batch.topic.type_name == TEMPERATURE:
            self._temperatures(batch)
            return
        columns, rejected = self._reader.joint_states(batch)
        if len(columns) == 1 and not rejected:
            self._session.joint_states(times, columns[0])
            return
        for row, content in _in_order(columns, {r.row: r.reason for r in rejected}):
            if isinstance(content, str):
                self._session.unreadable(content)
            else:
                self._session.joint_states(times[row : row + content.stamp.size], content)

    def _temperatures(self, batch: Batch) -> None:
        assert self._session is not None
        for joint in self._session.config.joints:
            if batch.topic.name.endswith(f"/{joint.name}/temperature"):
                for data in batch.messages():
                    self._session.temperature(joint.name, bytes(data))

    def _event(self, now: int, event: dict[str, Any]) -> None:
        kind = event.get("event")
        if kind == "configuration" and (event.get("new") or self._session is None):
            self._configured(now, resolve(event["parameters"]))
            return
        if self._session is None:
            raise BagError(self._reader.path, "events stand before the log's first configuration")
        if kind == "configuration":
            self._session.configure(now, resolve({**self._session.config.flat, **event["parameters"]}))
        elif kind == "map":
            self._use_map(now, event["joint"], event["torque_limit"])
        elif kind == "report":
            self._session.tick(now, event["stamp"], event["facts"])

    def _configured(self, now: int, config: Config) -> None:
        if self._session is None:
            self.begin(now, config)
        else:
            self._session.configure(now, config)

    def _use_map(self, now: int, name: str, torque_limit: float | None) -> None:
        assert self._session is not None
        joint = next(joint for joint in self._session.config.joints if joint.name == name)
        key = (joint.drive.mesh, torque_limit)
        if key not in self._maps:
            self._maps[key] = map_of(joint, torque_limit)
        self._session.use_map(now, name, self._maps[key])

    def _write(self, encoded: Encoded) -> None:
        topic = resolved(encoded.topic, self._node)
        self._writer.write_many(topic, encoded.type_name, encoded.rows, encoded.received)


def _event(path: Path, data: bytes) -> dict[str, Any]:
    """A recorded event, checked for what the replay needs of it."""
    needed = {
        "configuration": ("parameters",),
        "map": ("joint", "torque_limit"),
        "report": ("stamp", "facts"),
    }
    try:
        event = json.loads(read_string(data))
        if not isinstance(event, dict) or any(
            key not in event for key in needed.get(event.get("event", ""), ())
        ):
            raise ValueError("it lacks what its kind needs")
    except Exception as error:  # rosbags raises several kinds on a malformed message
        raise BagError(path, f"has an event that cannot be read: {error}") from error
    return event


def _part(batch: Batch, rows: slice) -> Batch:
    return Batch(batch.topic, batch.log_time[rows], batch.publish_time[rows], batch.payload[rows])


def _in_order(
    columns: list[JointStates], rejected: dict[int, str]
) -> Iterator[tuple[int, JointStates | str]]:
    """Groups of columns and refused messages in the order of the batch, with the first row of each."""
    pieces: list[tuple[int, JointStates | str]] = list(rejected.items())
    for states in columns:
        breaks = np.flatnonzero(np.diff(states.row) != 1) + 1
        for rows in np.split(np.arange(states.row.size), breaks):
            at = slice(int(rows[0]), int(rows[-1]) + 1)
            values = [None if column is None else column[at] for column in states[4:]]
            piece = JointStates(states.row[at], states.stamp[at], states.names, states.frame_id, *values)
            pieces.append((int(piece.row[0]), piece))
    yield from sorted(pieces, key=lambda piece: piece[0])

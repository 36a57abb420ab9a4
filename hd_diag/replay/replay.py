"""Runs the monitor over a recorded bag, in the bag's time, as fast as the machine can."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from hd_diag.arrays import Integers, Times
from hd_diag.bag import BagError, BagWriter, check_output, replaced
from hd_diag.bag.reader import BagReader, Mixed
from hd_diag.config.configuration import Config, ConfigError, JointConfig, resolve
from hd_diag.config.parameters import shown
from hd_diag.messages.publications import LAST_TIME, Encoded, resolved
from hd_diag.messages.schemas import jazzy
from hd_diag.model.torsion_map import TorsionMap, build
from hd_diag.monitor.comparison import together
from hd_diag.monitor.joint import Joint
from hd_diag.records.joint_topics import no_input
from hd_diag.replay import versions
from hd_diag.replay.events import Event
from hd_diag.replay.map_builder import map_limit
from hd_diag.replay.preparation import prepare
from hd_diag.replay.recorded_monitor import Session
from hd_diag.replay.sources import Sources, event_of, models_of, sources_of
from hd_diag.streams.signals import temperature_changes

_NANOSECONDS = 1_000_000_000
_LONGEST_SILENCE = 60 * _NANOSECONDS  # longest pause in a bag in which all reports are made [ns]
_MAPS_KEPT = 4
_FACTS = {"latency_p99_us": "nan", "log_state": "off"}
_MOST_BYTES = 2 << 20  # most bytes published at once
_ANGLES_SIZE, _ARRAYS_SIZE, _DRAWING_SIZE = 500, 10_000, 1 << 20  # approximate sizes for one joint [byte]

Progress = Callable[[int, int], None]


@dataclass
class Replay:
    """Result of a replay.

    `reproduced`: the bag is the node's own log, and the replay followed its events without a configuration.
    `messages` and `written` are the numbers of messages read and written, `duration` is the time from the
    bag's first to its last message [s]. By joint: samples `rejected` and the reason for the last, samples
    `missed` according to the stamps, and samples with zero stamps. `problems`: damage of the bag, joints
    without a map, software versions that differ from the log's. `joints` had samples. `absent` joints had
    none; their texts say what the bag has instead.
    """

    reproduced: bool
    messages: int
    written: int
    duration: float
    rejected: dict[str, int]
    missed: dict[str, int]
    stamps_zero: dict[str, int]
    last_rejection: dict[str, str]
    problems: list[str]
    joints: tuple[str, ...]
    absent: dict[str, str]


def replay(
    bag: str | Path,
    out: str | Path,
    config: Config | None = None,
    *,
    topics: tuple[str, ...] = (),
    overwrite: bool = False,
    progress: Progress = lambda done, total: None,
) -> Replay:
    """Run the monitor over a bag and write what the node would have published.

    Parameters
    ----------
    bag : path
        Bag of any storage that rosbag2 has, or the node's own log.
    out : path
        Bag to write: inputs, outputs and events, as in the node's log. After an error it is left without its
        end, so that no reader takes it for whole; a bag that it would replace stays unchanged.
    config : Config, optional
        Without it the bag must be a node's log. The replay then follows its configuration and every change
        of it. The outputs equal those of the live run to the last bit if the software versions are the same.
    topics : tuple of str, optional
        Topics with joint states; by default the input of a log, otherwise all except for a node's outputs.
    overwrite : bool, optional
    progress : callable, optional
        Called with the messages read so far and in all; a KeyboardInterrupt finishes a new output.

    Raises
    ------
    BagError
        If the bag cannot be read, holds no joint states or events, or the output cannot be written.
    ConfigError
        If a recorded configuration cannot be used.
    """
    check_output(out, bag)
    # No numpy warnings: the outputs show the result for whatever numbers a bag holds.
    with BagReader(bag) as reader, np.errstate(all="ignore"):
        sources = sources_of(reader, config, topics)
        prepare(config or resolve({}))
        total = sum(topic.count for topic in reader.topics if topic.name in sources.every)
        with replaced(out, overwrite=overwrite) as place, BagWriter(place, overwrite=overwrite) as writer:
            run = _Run(reader, writer, sources)
            if config is not None:
                run.begin(reader.start, config)
            for mixed in reader.mixed(sources.every, sources.topics.is_read):
                run.take(mixed)
                progress(run.done, total)
            return run.result()


class _Run:
    """A running replay: feeds a session with batches and writes its results."""

    def __init__(self, reader: BagReader, writer: BagWriter, sources: Sources) -> None:
        self.done = 0
        self._reader, self._writer, self._sources = reader, writer, sources
        self._session: Session | None = None
        self._last = 0
        self._next_report: int | None = None
        # Keeps maps in case a parameter is set back. Two threads build, because the replay waits for a map.
        self._build = lru_cache(_MAPS_KEPT)(partial(build, threads=2))
        self._problems: list[str] = []
        for topic in reader.topics:
            if sources.topics.types.get(topic.name) == (kind := topic.type_name):
                known = None if kind in jazzy().fielddefs else topic.definition
                writer.add_topic(topic.name, kind, topic.offers, known)

    def begin(self, now: int, config: Config) -> None:
        """Start a session; without recorded events every joint gets its map at once."""
        self._check_time(now)
        self._session = Session(config, self._write, self._sources.node, self._sources.names)
        self._session.start(now)
        if not self._sources.events:
            for joint in config.joints:
                self._use_own_map(now, joint)

    def take(self, mixed: Mixed) -> None:
        """Take consecutive messages."""
        self._last, sources = int(mixed.log_time[-1]), self._sources
        self._check_time(self._last)
        name = (batch := mixed.batches[0][1]).topic.name
        if name == sources.events:
            for now, data in zip(batch.log_time.tolist(), batch.messages(), strict=True):
                self._event(now, event_of(self._reader.path, bytes(data)))
        elif sources.topics.types.get(name) != batch.topic.type_name:
            pass
        elif name in sources.topics.temperatures:
            self._temperatures(mixed, sources.topics.temperatures[name])
        else:
            self._joint_states(mixed)
        self.done += mixed.log_time.size

    def _joint_states(self, mixed: Mixed) -> None:
        """Take joint states in parts; reports that are due within a part precede it in the output."""
        shapes, refused = self._sources.topics.columns(mixed)
        session, cuts = self._running, temperature_changes(shapes)
        for whole in self._parts(mixed.log_time):
            found = [
                (rows.start - whole.start, session.errors(mixed.log_time, shapes, refused, rows))
                for rows in self._between_reports(mixed.log_time, whole, cuts)
            ]
            self._copy(mixed, whole)
            session.publish(mixed.log_time[whole], together(found))

    def result(self) -> Replay:
        """Make a last report and return the result of the replay."""
        session = self._running
        if self._next_report is not None:
            session.tick(self._last, self._last, _FACTS)
        joints = session.monitor.joints
        return Replay(
            reproduced=bool(self._sources.events),
            messages=self.done,
            written=sum(self._writer.counts.values()),
            duration=self._reader.duration,
            rejected={name: joint.rejected for name, joint in joints.items()},
            missed={name: joint.lost.count for name, joint in joints.items()},
            stamps_zero={name: int(joint.state["unstamped"]) for name, joint in joints.items()},
            last_rejection={name: joint.last_rejection for name, joint in joints.items()},
            problems=[*self._reader.problems, *self._problems],
            joints=tuple(name for name, joint in joints.items() if joint.samples),
            absent={name: self._absent(joint) for name, joint in joints.items() if not joint.samples},
        )

    def _absent(self, joint: Joint) -> str:
        if joint.rejected:
            return f"{joint.rejected} samples, all rejected, the last because: {joint.last_rejection}"
        return no_input(self._reader.path, joint.config)

    @property
    def _running(self) -> Session:
        if self._session is None:
            raise BagError(self._reader.path, "inputs or events stand before the log's first configuration")
        return self._session

    def _check_time(self, now: int) -> None:
        if now > LAST_TIME:
            raise BagError(
                self._reader.path, "holds times beyond the year 2038, which ROS 2 cannot represent"
            )

    def _parts(self, times: Times) -> Iterator[slice]:
        """Slices of rows to publish at once, limited by the size of their outputs."""
        config, begin = self._running.config, 0
        rates = config.array_rate * _ARRAYS_SIZE + config.mesh_rate * _DRAWING_SIZE
        bytes_of_each = _MOST_BYTES / max(1, len(config.joints))
        most = int(bytes_of_each / _ANGLES_SIZE) + 1
        longest = int(_NANOSECONDS * bytes_of_each / max(1.0, rates))
        while begin < times.size:
            end = int(np.searchsorted(times, int(times[begin]) + longest))
            end = max(begin + 1, min(end, begin + most))
            yield slice(begin, end)
            begin = end

    def _between_reports(self, times: Times, whole: slice, cuts: Integers) -> Iterator[slice]:
        """Slices of `whole` up to the next report or cut; makes the reports that are due before each."""
        begin = whole.start
        while begin < whole.stop:
            end = max(begin + 1, int(np.searchsorted(times, self._report_until(int(times[begin])))))
            end = min([end, whole.stop, *cuts[cuts > begin][:1].tolist()])
            yield slice(begin, end)
            begin = end

    def _report_until(self, now: int) -> int:
        """Make the reports due up to a log time; returns the time of the next [ns]. A log has its own.

        After a long silence only the last report is made.
        """
        if self._sources.events:
            return LAST_TIME
        if self._next_report is None or self._next_report > now + self._period:  # a clock was set back
            self._next_report = now + self._period
        elif now - self._next_report > _LONGEST_SILENCE:
            self._next_report += (now - self._next_report) // self._period * self._period
        while self._next_report <= now:
            self._running.tick(self._next_report, self._next_report, _FACTS)
            self._next_report += self._period
        return self._next_report

    @property
    def _period(self) -> int:
        return round(_NANOSECONDS / self._running.config.diagnostics_rate)

    def _temperatures(self, mixed: Mixed, joint: str) -> None:
        for row, data in enumerate(mixed.batches[0][1].messages()):
            self._report_until(int(mixed.log_time[row]))
            self._copy(mixed, slice(row, row + 1))
            self._running.temperature(joint, bytes(data))

    def _copy(self, mixed: Mixed, rows: slice) -> None:
        """Copy messages to the output."""
        for places, batch in mixed.batches:
            at, topic = slice(*np.searchsorted(places, (rows.start, rows.stop)).tolist()), batch.topic
            if at.start < at.stop:
                times = batch.log_time[at], batch.publish_time[at]
                self._writer.write_many(topic.name, topic.type_name, batch.payload[at], *times)

    def _event(self, now: int, event: Event) -> None:
        match event:
            case {"event": "configuration"}:
                self._configure(now, event)
            case {"event": "map", "joint": name, "torque_limit": limit}:
                joints = {joint.name: joint for joint in self._running.config.joints}
                if name not in joints:
                    raise BagError(self._reader.path, f"holds a map of {shown(name)}, no joint of it")
                self._running.use_map(now, name, self._map(joints[name], limit))
            case {"event": "report", "stamp": stamp, "facts": facts, "silence": silence}:
                self._running.tick(now, stamp, facts, silence)
            case {"event": "pace", "share": share}:
                self._running.pace(now, share)
            case {"event": "clock", "stamp": stamp}:
                self._running.clock_set_back(now, stamp)
            case {"event": "state", "monitor": state}:
                try:
                    self._running.carry_on(now, state)
                except ValueError as error:
                    raise BagError(self._reader.path, f"cannot be carried on: {error}") from error

    def _configure(self, now: int, event: Event) -> None:
        joints, before = (
            ([], {}) if event["new"] else (self._running.config.joints, self._running.config.flat)
        )
        try:
            config = resolve({**before, **event["parameters"]}, models_of(event, joints))
        except ConfigError as error:
            raise ConfigError(f"{self._reader.path}: {error}") from error
        if event["new"]:
            self._compare(event["versions"])
            self.begin(now, config)
        elif "joints" in event["parameters"]:
            raise BagError(self._reader.path, "holds a log in which the joints change")
        else:
            self._running.configure(now, config)

    def _compare(self, recorded: versions.Versions) -> None:
        """Note once which software versions differ, because they may change the last bits."""
        if other := versions.differences(recorded):
            what = f"was recorded with {other}: outputs may differ by rounding"
            self._problems = [*dict.fromkeys([*self._problems, str(BagError(self._reader.path, what))])]

    def _map(self, joint: JointConfig, torque_limit: float) -> TorsionMap:
        """Map of a joint as it is configured now."""
        try:
            return self._build(joint.drive.mesh, torque_limit)
        except Exception as error:  # whatever is wrong with the mesh, as in MapBuilder
            raise BagError(self._reader.path, f"{joint.name} has no map: {error}") from error

    def _use_own_map(self, now: int, joint: JointConfig) -> None:
        """Predict a joint with its map; without one the predictions stay exact, as in the node."""
        try:
            table = self._map(joint, map_limit(joint))
        except BagError as error:
            self._problems.append(f"{error.cause}; predictions stay exact")
        else:
            self._running.use_map(now, joint.name, table)

    def _write(self, encoded: Encoded) -> None:
        topic = self._sources.names.get(encoded.topic) or resolved(encoded.topic, self._sources.node)
        self._writer.write_many(topic, encoded.type_name, encoded.rows, encoded.received)

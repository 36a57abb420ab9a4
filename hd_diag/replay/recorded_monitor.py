"""One run of the monitor, live or replayed: inputs, outputs and events.

The outputs depend only on the received messages and the events (configuration, map in force, report). The
log records both in order, so a replay gives the same bytes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from hd_diag.arrays import Times
from hd_diag.config.configuration import Config, JointConfig
from hd_diag.messages.fields import FieldReader
from hd_diag.messages.joint_states import JointStateReader
from hd_diag.messages.publications import (
    PARAMETER_EVENT,
    STRING,
    Encoded,
    encode,
    parameter_event,
    read_temperature,
)
from hd_diag.model.mesh import Mesh
from hd_diag.model.torsion_map import TorsionMap
from hd_diag.monitor.all_joints import Monitor
from hd_diag.monitor.carried import carried, carry_on
from hd_diag.monitor.comparison import Errors
from hd_diag.monitor.publications import Publication, Report, Status
from hd_diag.replay import versions
from hd_diag.replay.events import write_event
from hd_diag.streams.columns import JointStates
from hd_diag.streams.signals import temperature_changes, temperatures

EVENTS = "~/events"
"""Topic of the events in a log: std_msgs/String with one JSON object, key ``event``."""

PARAMETER_EVENTS = "/parameter_events"

Reader = JointStateReader | FieldReader
Sink = Callable[[Encoded], None]


class Session:
    """A monitor with its events and its encoded output.

    `sink` takes every result and event, in order. `node` is the node's full name for its parameter events
    and diagnostics. `topics` has the full names of its topics for the log, because they may be remapped.
    `lag` is the largest delay of a message after its stamp since the last report [s], only in a live run.
    """

    def __init__(
        self, config: Config, sink: Sink, node: str = "/hd_diag", topics: Mapping[str, str] | None = None
    ) -> None:
        self.config = config
        self.monitor = Monitor(config)
        self.lag = math.nan
        self._sink = sink
        self._node = node
        self._topics = dict(topics or {})
        self._usual = JointStateReader(
            {k: s for joint in config.joints for k, s in joint.mapped.items() if not s.topic}
        )

    def start(self, now: int) -> None:
        """Record the initial configuration of the session at a time [ns]."""
        self._configuration(now, dict(self.config.flat), _models(self.config), new=True)

    def start_again(self, now: int) -> None:
        """Record configuration, maps and state, so that a replay can begin here; the session continues."""
        self.monitor.begin_window()
        self.start(now)
        for name, joint in self.monitor.joints.items():
            if joint.table is not None:
                self._event(now, "map", joint=name, torque_limit=joint.table.requested_limit)
        if self.monitor.share != 1.0:
            self._event(now, "pace", share=self.monitor.share)
        self._event(now, "state", monitor=carried(self.monitor))

    def carry_on(self, now: int, state: Mapping[str, Any]) -> None:
        """Continue from the state of another session of this configuration; ValueError if it does not fit."""
        carry_on(self.monitor, state)
        self._event(now, "state", monitor=state)

    def joint_state(
        self, received: int, data: bytes, heard: int | None = None, reader: Reader | None = None
    ) -> None:
        """Take one message in CDR that arrived at a time [ns]; an unreadable message is counted.

        `heard` is the same time by the clock that measures silence [ns]. `reader` is the reader of the
        message's topic, by default for joint states.
        """
        heard_at = None if heard is None else np.array([heard])
        self.messages(np.array([received]), [(reader or self._usual, data)], heard_at)

    def messages(
        self, received: Times, taken: Sequence[tuple[Reader, bytes]], heard: Times | None = None
    ) -> None:
        """Take messages in CDR, each with the reader of its topic; same result as one by one.

        `received` and `heard` are (n,) [ns].
        """
        shapes, refused = _read(received, taken)
        for states in shapes:
            self.lag = float(np.fmax(self.lag, np.max(received[states.row] - states.stamp) * 1e-9))
        heard, begin = received if heard is None else heard, 0
        for end in (*temperature_changes(shapes).tolist(), received.size):
            if begin < end:
                rows = slice(begin, end)
                self.publish(received[rows], self.errors(heard, shapes, refused, rows))
            begin = end

    def errors(
        self,
        heard: Times,
        shapes: Sequence[JointStates],
        refused: Sequence[tuple[int, str]],
        rows: slice,
    ) -> Errors:
        """Take some rows of messages, as `Monitor.errors`; their last temperature applies to all of them."""
        every = (states.between(rows.start, rows.stop) for states in shapes)
        here = [states for states in every if states.row.size]
        bad = [(row - rows.start, why) for row, why in refused if rows.start <= row < rows.stop]
        for states in here:
            for joint, column in temperatures(states).items():
                self.monitor.temperature(joint, float(column[-1]))
        return self.monitor.errors(heard[rows], here, bad)

    def publish(self, received: Times, errors: Errors) -> None:
        """Publish errors, whose rows are positions in `received` (n,) [ns]."""
        self._publish(self.monitor.publications(received, errors))

    def temperature(self, joint: str, data: bytes) -> None:
        """Take a Temperature message in CDR; an unreadable message is rejected."""
        try:
            value = read_temperature(data)
        except ValueError as error:
            self.monitor.joints[joint].reject(str(error))
        else:
            self.monitor.temperature(joint, value)

    def configure(self, now: int, config: Config) -> list[str]:
        """Use another configuration from the next message on, at a time [ns].

        Returns the joints that need a new map, because their mesh or its largest torque has changed.
        """
        before = self.config
        changed = {name: value for name, value in config.flat.items() if before.flat.get(name) != value}
        models = {n: text for n, text in _models(config).items() if _models(before).get(n) != text}
        if not changed and not models:
            return []
        self.monitor.configure(config)
        self.config = config
        self._configuration(now, changed, models, new=False)
        pairs = zip(before.joints, config.joints, strict=True)
        return [new.name for old, new in pairs if _map_needs(new) != _map_needs(old)]

    def use_map(self, now: int, joint: str, table: TorsionMap) -> bool:
        """Predict a joint with its map from the next message on; False if its mesh has changed since."""
        if not self.monitor.use_map(joint, table):
            return False
        self._event(now, "map", joint=joint, torque_limit=table.requested_limit)
        return True

    def pace(self, now: int, share: float) -> None:
        """Publish only a share of per-tooth arrays and drawings from the next message on, at a time [ns]."""
        self.monitor.pace(share)
        self._event(now, "pace", share=share)

    def clock_set_back(self, now: int, stamp: int) -> None:
        """Note at a time [ns] that the clock of stamps was set back; stamps after `stamp` are from before."""
        self.monitor.clock_set_back(stamp)
        self._event(now, "clock", stamp=stamp)

    def tick(
        self, now: int, stamp: int, facts: Mapping[str, str], silence: Mapping[str, float] | None = None
    ) -> Sequence[Status]:
        """Report on all joints, as `Monitor.tick`; returns their statuses."""
        self.lag = math.nan
        report = self.monitor.tick(now, stamp, facts, silence or None)
        self._publish([report])
        return report.statuses

    def _configuration(
        self, now: int, values: Mapping[str, Any], models: Mapping[str, str], new: bool
    ) -> None:
        data = parameter_event(self._node, now, values, new)
        self._emit(PARAMETER_EVENTS, PARAMETER_EVENT, now, data)
        begun = {"topics": self._topics, "versions": dict(versions.running())} if new else {}
        # The model files may have changed when the log is replayed.
        self._event(now, "configuration", new=new, parameters=dict(values), **begun, models=dict(models))

    def _event(self, now: int, event: str, **fields: Any) -> None:
        self._emit(EVENTS, STRING, now, write_event(event, **fields))

    def _emit(self, topic: str, type_name: str, now: int, data: bytes) -> None:
        self._sink(Encoded(topic, type_name, np.array([now]), [data]))

    def _publish(self, publications: Iterable[Publication]) -> None:
        for each in publications:
            if isinstance(each, Report):
                told = {"facts": dict(each.facts), "silence": dict(each.silence)}
                self._event(each.received, "report", stamp=each.stamp, **told)
            self._sink(encode(each, self._node))


def _read(
    received: Times, taken: Sequence[tuple[Reader, bytes]]
) -> tuple[list[JointStates], list[tuple[int, str]]]:
    """Columns of messages by position, and positions of unreadable messages with reasons; both in order."""
    rows: dict[Reader, list[int]] = {}
    for row, (reader, _) in enumerate(taken):
        rows.setdefault(reader, []).append(row)
    shapes: list[JointStates] = []
    refused: list[tuple[int, str]] = []
    for reader, own in rows.items():
        at = np.array(own)
        columns, rejected = reader.columns([taken[row][1] for row in own], received[at])
        shapes += [states._replace(row=at[states.row]) for states in columns]
        refused += [(own[each.row], each.reason) for each in rejected]
    return sorted(shapes, key=lambda states: int(states.row[0])), sorted(refused)


def _models(config: Config) -> dict[str, str]:
    """Content of the model files in force, by joint."""
    return {joint.name: joint.model_text for joint in config.joints if joint.model is not None}


def _map_needs(joint: JointConfig) -> tuple[Mesh, float]:
    return joint.drive.mesh, joint.drive.rated_torque

"""Checks who publishes the node's inputs: another type on a topic, more than one publisher of a joint."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from rclpy.node import Node

from hd_diag.monitor.settings import JointConfig
from hd_diag.ros.second_reader import SecondReader
from hd_diag.ros.subscriptions import SignalInput

_LENGTH = 1.0  # duration of a look [s]
_REST = 10.0  # from one look to the next [s]
_DEPTH = 50  # messages that may wait between two steps of a look, if they are small
_RECEIVED = np.zeros(1, np.int64)  # placeholder for a time that is not used


class Numbers:
    """Names with more than one publisher, from the sequence numbers of messages.

    A publisher numbers its messages, and they come in order, perhaps with gaps. If the numbers of messages
    with a name do not rise, the name has two publishers and is `doubled`. The numbers of two alternating
    publishers cannot rise: after a1 < b1 the first one sends a1 + 1, which is not above b1.
    """

    def __init__(self) -> None:
        self.doubled: set[str] = set()
        self._last: dict[str, int] = {}

    def take(self, number: int, names: set[str]) -> None:
        """Register a message by its number and the names that it carries."""
        self.doubled |= {name for name in names if number <= self._last.get(name, -1)}
        self._last |= dict.fromkeys(names, number)


class Look:
    """A second reader of a topic for a short time, which collects the numbers of its messages."""

    def __init__(self, beside: Node, taken: SignalInput, names: set[str]) -> None:
        self.numbers = Numbers()
        self._names = names | taken.source.signals.keys()
        self._reader = taken.source.reader()
        self._second = SecondReader(beside, "_hd_diag_look", taken, _DEPTH)

    def take(self) -> None:
        """Take the messages since the last call."""
        for data, info in self._second.take():
            number = info["publication_sequence_number"]
            if number is None:  # some implementations give none
                continue
            with contextlib.suppress(ValueError):  # the node itself reports unreadable messages
                states = self._reader.one(data, _RECEIVED)
                self.numbers.take(number, self._names & {*states.names, *states.keys})

    def close(self) -> None:
        """Remove the second reader."""
        self._second.close()


@dataclass
class _Topic:
    """A topic, its publishers when the graph was last read, and the names found doubled in the last look."""

    taken: SignalInput
    gids: frozenset[bytes] = frozenset()
    nodes: tuple[str, ...] = ()
    doubled: tuple[str, ...] = ()
    due: float = math.inf
    pause: float = _REST


class Publishers:
    """Faults in the publishers of a node's topics.

    A topic with several publishers is examined when they change, then after 10, 20, 40, ... s: a publisher
    may begin to send long after it is made. `length` of a look and `rest` between two looks are in seconds.
    """

    def __init__(
        self, node: Node, inputs: Sequence[SignalInput], length: float = _LENGTH, rest: float = _REST
    ) -> None:
        self._node, self._length, self._rest = node, length, rest
        self._topics = [_Topic(each, pause=rest) for each in inputs]
        self._names: set[str] = set()
        self._rested = 0.0
        self._look: tuple[Look, _Topic, frozenset[bytes], float] | None = None

    def faults(self, joints: Sequence[JointConfig]) -> list[str]:
        """Faults seen in the graph now and in the last looks; the next looks are for these joints."""
        self._names = {name for joint in joints for name in (joint.input_joint, joint.output_joint)}
        found = []
        for topic in self._topics:
            name, wanted = topic.taken.source.topic, topic.taken.source.type_name
            others = self._update(topic) - {wanted}
            found += [f"{name} is also published as {kind}, not as {wanted}" for kind in sorted(others)]
            if topic.doubled:
                doubled, nodes = ", ".join(topic.doubled), ", ".join(topic.nodes)
                found.append(f"{name} has more than one publisher of {doubled}; on it publish {nodes}")
        return found

    def look(self) -> None:
        """Begin, continue or end a look."""
        now = time.monotonic()
        if self._look is not None:
            look, topic, gids, end = self._look
            look.take()
            if now >= end:
                self.close()
                self._update(topic)
                if topic.gids == gids:  # otherwise one may have replaced another
                    topic.doubled = tuple(sorted(look.numbers.doubled))
                    topic.due, topic.pause = now + topic.pause, 2.0 * topic.pause
        elif now >= self._rested:
            topic = min(self._topics, key=lambda each: each.due)
            if topic.due <= now:
                self._rested = now + self._rest  # even if the look fails
                look = Look(self._node, topic.taken, self._names)
                self._look = look, topic, topic.gids, now + self._length

    def close(self) -> None:
        """End a look that is under way."""
        if self._look is not None:
            self._look[0].close()
        self._look = None

    def _update(self, topic: _Topic) -> set[str]:
        """Update a topic's publishers from the graph; return the types that they publish."""
        source = topic.taken.source
        infos = self._node.get_publishers_info_by_topic(source.topic)
        right = [each for each in infos if each.topic_type == source.type_name]
        gids = frozenset(bytes(each.endpoint_gid) for each in right)
        if gids != topic.gids:
            topic.gids, topic.pause = gids, self._rest
            topic.due = 0.0 if len(gids) > 1 else math.inf
            if len(gids) < 2:
                topic.doubled = ()
        topic.nodes = tuple(sorted({f"{i.node_namespace.rstrip('/')}/{i.node_name}" for i in right}))
        return {each.topic_type for each in infos}

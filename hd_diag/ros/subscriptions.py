"""What the node subscribes to: joint states, other signals and temperatures."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks, UnsupportedEventTypeError
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Temperature

from hd_diag.bag.typestore import store_of
from hd_diag.config.configuration import Config, ConfigError
from hd_diag.config.configured_signals import OWNERS
from hd_diag.messages.fields import FieldReader
from hd_diag.messages.joint_states import JOINT_STATE, JointStateReader
from hd_diag.messages.publications import INPUT, temperature_topic
from hd_diag.ros.message_types import definition_of, message_class
from hd_diag.streams.signals import ROLES, Signal, key

INPUT_DEPTH = 2000
"""Samples that may wait in DDS while something else takes its time: two seconds of 1 kHz."""

MOST_BYTES = 16 << 20
"""That may wait in DDS, and as many in the node."""


_OBJECTS = 300  # bytes that Python takes for a message that waits

Reader = JointStateReader | FieldReader


@dataclass
class SignalTopic:
    """A topic of which signals are taken: full name, type, and the signals by their keys."""

    topic: str
    type_name: str
    signals: dict[str, Signal] = field(default_factory=dict)

    def reader(self) -> Reader:
        """What reads the signals; ValueError where the type has no such field."""
        if self.type_name == JOINT_STATE:
            return JointStateReader(self.signals)
        store = store_of(self.type_name, definition_of(self.type_name))
        return FieldReader(store, self.type_name, self.signals)


def sources(config: Config, full_name: Callable[[str], str]) -> list[SignalTopic]:
    """Topics that a configuration needs; ConfigError where one is said to have two types."""
    usual = SignalTopic(full_name(INPUT), JOINT_STATE)
    found = {usual.topic: usual}
    for joint, role, signal in _signals(config):
        topic = full_name(signal.topic or INPUT)
        source = found.setdefault(topic, SignalTopic(topic, signal.type_name))
        if source.type_name != signal.type_name:
            what = f"{topic} cannot have {signal.type_name} and {source.type_name}"
            raise ConfigError(f"{joint}.{OWNERS[role]}.type: {what}")
        source.signals[key(joint, role)] = signal
    is_usual = any(None in joint.signals[:3] for joint in config.joints)
    return [source for source in found.values() if source is not usual or is_usual or source.signals]


def check_types(config: Config) -> None:
    """Raise ConfigError for the first signal whose type is not installed or has no such field."""
    for joint, role, signal in _signals(config):
        parameter = f"{joint}.{OWNERS[role]}"
        try:
            message_class(signal.type_name)
        except ConfigError as error:
            raise ConfigError(f"{parameter}.type: {error}") from error
        try:
            SignalTopic(signal.topic, signal.type_name, {"": signal}).reader()
        except ValueError as error:
            raise ConfigError(f"{parameter}.field: {error}") from error


def _signals(config: Config) -> Iterator[tuple[str, str, Signal]]:
    """Joint, role and signal of all that are mapped."""
    for joint in config.joints:
        for role, signal in zip(ROLES, joint.signals, strict=True):
            if signal is not None:
                yield joint.name, role, signal


class SignalInput:
    """Reliable subscription to a topic, in CDR; best effort once a publisher offers no more.

    At most `depth` messages wait in DDS; `lost` counts those that DDS says were lost. The last was `heard` at
    a time on the monotonic clock [s], or else the subscription was made then.
    """

    def __init__(self, node: Node, source: SignalTopic, take: Callable[[bytes], None]) -> None:
        self.source = source
        self.depth, self.lost, self.heard = INPUT_DEPTH, 0, time.monotonic()
        self._node, self._take = node, take
        self._wanted = self._offered = ReliabilityPolicy.RELIABLE
        self._largest = 1
        self._subscription = self._subscribe()

    def follow_publishers(self) -> None:
        """Subscribe as the publishers need it.

        With best effort where one offers no more, or nothing would arrive; to fewer messages where they are
        so large that those that wait would fill the memory.
        """
        depth = max(1, min(INPUT_DEPTH, MOST_BYTES // self._largest))
        if self._wanted != self._offered:
            what = "is published with best effort: subscribed likewise"
        elif 2 * depth <= self.depth:
            what = f"has messages of {self._largest} bytes: at most {depth} wait"
        else:
            return
        self._wanted, self.depth = self._offered, depth
        self._node.destroy_subscription(self._subscription)
        self._subscription = self._subscribe()
        self._node.get_logger().info(f"{self.source.topic} {what}")

    def _subscribe(self) -> Any:
        own = message_class(self.source.type_name), self.source.topic, self._on_message
        profile = QoSProfile(depth=self.depth, reliability=self._wanted)
        events = SubscriptionEventCallbacks(
            incompatible_qos=self._on_incompatible_qos, message_lost=self._on_lost
        )
        try:
            return self._node.create_subscription(*own, profile, event_callbacks=events, raw=True)
        except UnsupportedEventTypeError:  # some implementations do not tell losses
            events.message_lost = None
            return self._node.create_subscription(*own, profile, event_callbacks=events, raw=True)

    def _on_message(self, data: bytes) -> None:
        self._largest, self.heard = max(self._largest, len(data)), time.monotonic()
        self._take(data)

    def _on_lost(self, event: Any) -> None:
        self.lost += event.total_count_change

    def _on_incompatible_qos(self, _: Any) -> None:
        # Acted on later: the executor is still busy with the subscription.
        self._offered = ReliabilityPolicy.BEST_EFFORT


class Waiting:
    """Messages that wait for their turn, bounded by bytes: the oldest give way.

    DDS drops silently what its reader has no room for; so all is taken from it at once. How many were `taken`
    and `dropped` is counted.
    """

    def __init__(self) -> None:
        self.taken = self.dropped = self._bytes = 0
        self._messages: deque[tuple[float, tuple[SignalTopic, Reader, bytes]]] = deque()

    def __len__(self) -> int:
        return len(self._messages)

    @property
    def age(self) -> float:
        """How long the oldest has waited [s]."""
        return time.monotonic() - self._messages[0][0] if self._messages else 0.0

    def put(self, source: SignalTopic, reader: Reader, data: bytes) -> None:
        """Append a message; the oldest are dropped beyond `MOST_BYTES`."""
        self.taken += 1
        self._bytes += len(data) + _OBJECTS
        self._messages.append((time.monotonic(), (source, reader, data)))
        while self._bytes > MOST_BYTES and len(self._messages) > 1:
            self.dropped += 1
            self.get()

    def get(self) -> tuple[SignalTopic, Reader, bytes]:
        """Remove and give the oldest message."""
        _, message = self._messages.popleft()
        self._bytes -= len(message[-1]) + _OBJECTS
        return message

    def some(self, most: int) -> list[tuple[SignalTopic, Reader, bytes]]:
        """Remove and give the oldest messages, at most so many."""
        return [self.get() for _ in range(min(most, len(self)))]


def subscribe_temperature(node: Node, joint: str, take: Callable[[bytes], Any]) -> None:
    """Subscribe to a joint's temperature; `take` takes each message in CDR."""
    profile = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    node.create_subscription(Temperature, temperature_topic(joint), take, profile, raw=True)

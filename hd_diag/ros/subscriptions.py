"""What the node subscribes to: joint states, other signals and temperatures."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from inspect import signature
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks, UnsupportedEventTypeError
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Temperature

from hd_diag.bag.memory import OBJECTS
from hd_diag.bag.typestore import store_of
from hd_diag.config.configuration import Config, ConfigError
from hd_diag.config.configured_signals import OWNERS
from hd_diag.messages.fields import FieldReader
from hd_diag.messages.joint_states import JOINT_STATE, JointStateReader
from hd_diag.messages.publications import INPUT, temperature_topic
from hd_diag.ros.message_types import definition_of, message_class
from hd_diag.ros.numbers import Identity, Missing, identity
from hd_diag.streams.signals import ROLES, Signal, key

INPUT_DEPTH = 2000
"""Samples that may wait in DDS while the node is busy: two seconds at 1 kHz."""

MOST_BYTES = 16 << 20
"""Bytes of messages that may wait in DDS, and as many in the node."""

Reader = JointStateReader | FieldReader


@dataclass
class SignalTopic:
    """A topic that carries signals: full name, type, and the signals by their keys."""

    topic: str
    type_name: str
    signals: dict[str, Signal] = field(default_factory=dict)

    def reader(self) -> Reader:
        """Reader of the signals; ValueError if the type lacks a field."""
        if self.type_name == JOINT_STATE:
            return JointStateReader(self.signals)
        store = store_of(self.type_name, definition_of(self.type_name))
        return FieldReader(store, self.type_name, self.signals)


def sources(config: Config, full_name: Callable[[str], str]) -> list[SignalTopic]:
    """Topics that a configuration needs; ConfigError if it gives one topic two types."""
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
    """Raise ConfigError for the first signal with a type that is not installed or lacks its field."""
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
    """Joint, role and signal of each mapped signal."""
    for joint in config.joints:
        for role, signal in zip(ROLES, joint.signals, strict=True):
            if signal is not None:
                yield joint.name, role, signal


class SignalInput:
    """Reliable subscription to a topic, in CDR; best effort once a publisher offers only that.

    At most `depth` messages wait in DDS. `heard` is the monotonic time of the last message, or of the
    subscription before the first one [s]; `given` identifies the last messages. `take` gets each message in
    CDR and its wait in DDS [s].
    """

    def __init__(self, node: Node, source: SignalTopic, take: Callable[[bytes, float], None]) -> None:
        self.source = source
        self.depth, self.heard = INPUT_DEPTH, time.monotonic()
        self.given: deque[Identity] = deque(maxlen=INPUT_DEPTH)
        self._node, self._take = node, take
        self._wanted = self._offered = ReliabilityPolicy.RELIABLE
        self._largest, self._lost, self._missing = 1, 0, Missing()
        self._subscription = self._former = self._subscribe()

    @property
    def lost(self) -> int:
        """Number of lost messages: the larger of DDS's count and that by the messages' numbers.

        DDS does not count messages that give way to newer ones or are withheld.
        """
        return max(self._lost, self._missing.count)

    def begin_anew(self, withheld: Iterable[int]) -> None:
        """Subscribe again because messages with these numbers, in order of arrival, are withheld."""
        for number in withheld:
            self._missing.withheld(number)
        self._change()
        why = "withholds what follows a message that cannot be read: subscribed again"
        self._node.get_logger().warning(f"{self.source.topic} {why}", throttle_duration_sec=5.0)

    def follow_publishers(self) -> None:
        """Adapt the subscription to the publishers.

        It is best effort if a publisher offers only that: otherwise nothing would arrive. It holds fewer
        messages if they are so large that waiting ones would fill the memory.
        """
        self._missing.publishers(self._node.count_publishers(self.source.topic))
        depth = max(1, min(INPUT_DEPTH, MOST_BYTES // self._largest))
        if self._wanted != self._offered:
            what = "is published with best effort: subscribed likewise"
        elif 2 * depth <= self.depth:
            what = f"has messages of {self._largest} bytes: at most {depth} wait"
        else:
            return
        self._wanted, self.depth = self._offered, depth
        self._change()
        self._node.get_logger().info(f"{self.source.topic} {what}")

    def _change(self) -> None:
        self._former = self._subscription  # kept: the executor may still hold an event of it
        self._node.destroy_subscription(self._former)
        self._subscription = self._subscribe()

    def _subscribe(self) -> Any:
        own = message_class(self.source.type_name), self.source.topic, _with_info(self._on_message)
        profile = QoSProfile(depth=self.depth, reliability=self._wanted)
        events = SubscriptionEventCallbacks(
            incompatible_qos=self._on_incompatible_qos, message_lost=self._on_lost
        )
        try:
            return self._node.create_subscription(*own, profile, event_callbacks=events, raw=True)
        except UnsupportedEventTypeError:  # some implementations do not report losses
            events.message_lost = None
            return self._node.create_subscription(*own, profile, event_callbacks=events, raw=True)

    def _on_message(self, data: bytes, info: Mapping[str, Any]) -> None:
        self._largest, self.heard = max(self._largest, len(data)), time.monotonic()
        own = identity(info)
        if own is not None:
            self.given.append(own)
            if not self._missing.follows(own[1]):  # a loss, or a publisher that has just begun
                self._missing.publishers(self._node.count_publishers(self.source.topic))
            self._missing.take(own[1])
        waited = max(0.0, 1e-9 * (time.time_ns() - info["received_timestamp"]))
        self._take(data, waited)

    def _on_lost(self, event: Any) -> None:
        self._lost += event.total_count_change

    def _on_incompatible_qos(self, _: Any) -> None:
        # Acted on later: the executor is still busy with the subscription.
        self._offered = ReliabilityPolicy.BEST_EFFORT


def _with_info(take: Callable[[bytes, Mapping[str, Any]], None]) -> Callable[..., None]:
    """A callback that asks for a message and its info.

    The events executor of rclpy 7.1 passes both as one tuple, later versions as two arguments.
    """

    def on_message(*given: Any) -> None:
        take(*(given[0] if len(given) == 1 else given))

    on_message.__signature__ = signature(lambda message, info: None)  # type: ignore[attr-defined]
    return on_message


class Waiting:
    """Queue of messages, bounded in bytes: the oldest give way.

    DDS silently drops messages that its reader has no room for, so all are moved here at once. `dropped`
    counts messages that gave way; `longest` is the longest wait since it was last reset [s].
    """

    def __init__(self) -> None:
        self.dropped = self._bytes = 0
        self.longest = 0.0
        self._messages: deque[tuple[float, tuple[SignalTopic, Reader, bytes]]] = deque()

    def __len__(self) -> int:
        return len(self._messages)

    @property
    def age(self) -> float:
        """Wait of the oldest message so far [s]."""
        return time.monotonic() - self._messages[0][0] if self._messages else 0.0

    def put(self, source: SignalTopic, reader: Reader, data: bytes, waited: float = 0.0) -> None:
        """Append a message that has `waited` elsewhere [s]; the oldest are dropped beyond `MOST_BYTES`."""
        self._bytes += len(data) + OBJECTS
        self._messages.append((time.monotonic() - waited, (source, reader, data)))
        while self._bytes > MOST_BYTES and len(self._messages) > 1:
            self.dropped += 1
            self.get()

    def get(self) -> tuple[SignalTopic, Reader, bytes]:
        """Remove and return the oldest message."""
        self.longest = max(self.longest, self.age)
        _, message = self._messages.popleft()
        self._bytes -= len(message[-1]) + OBJECTS
        return message

    def some(self, most: int) -> list[tuple[SignalTopic, Reader, bytes]]:
        """Remove and return the oldest messages, at most `most`."""
        return [self.get() for _ in range(min(most, len(self)))]


def subscribe_temperature(node: Node, joint: str, take: Callable[[bytes], Any]) -> None:
    """Subscribe to a joint's temperature; `take` takes each message in CDR."""
    profile = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    node.create_subscription(Temperature, temperature_topic(joint), take, profile, raw=True)

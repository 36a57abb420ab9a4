"""What the node subscribes to: joint states, other signals and temperatures."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
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
"""Samples that may wait while something else takes its time: two seconds of 1 kHz."""


@dataclass
class Source:
    """A topic of which signals are taken: full name, type, and the signals by their keys."""

    topic: str
    type_name: str
    signals: dict[str, Signal] = field(default_factory=dict)

    def reader(self) -> JointStateReader | FieldReader:
        """What reads the signals; ValueError where the type has no such field."""
        if self.type_name == JOINT_STATE:
            return JointStateReader(self.signals)
        store = store_of(self.type_name, definition_of(self.type_name))
        return FieldReader(store, self.type_name, self.signals)


def sources(config: Config, full_name: Callable[[str], str]) -> list[Source]:
    """Topics that a configuration needs; ConfigError where one is said to have two types."""
    usual = Source(full_name(INPUT), JOINT_STATE)
    found = {usual.topic: usual}
    for joint, role, signal in _signals(config):
        topic = full_name(signal.topic or INPUT)
        source = found.setdefault(topic, Source(topic, signal.type_name))
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
            Source(signal.topic, signal.type_name, {"": signal}).reader()
        except ValueError as error:
            raise ConfigError(f"{parameter}.field: {error}") from error


def _signals(config: Config) -> Iterator[tuple[str, str, Signal]]:
    """Joint, role and signal of all that are mapped."""
    for joint in config.joints:
        for role, signal in zip(ROLES, joint.signals, strict=True):
            if signal is not None:
                yield joint.name, role, signal


class SignalInput:
    """Reliable subscription to a topic, in CDR; best effort once a publisher offers no more."""

    def __init__(self, node: Node, source: Source, take: Callable[[bytes], None]) -> None:
        self._node = node
        self._take = take
        self._topic, self._class = source.topic, message_class(source.type_name)
        self._is_incompatible = self._is_best_effort = False
        self._subscription = self._subscribe(ReliabilityPolicy.RELIABLE)

    def follow_publishers(self) -> None:
        """Subscribe with best effort where a publisher offers no more: nothing would arrive otherwise."""
        if self._is_incompatible and not self._is_best_effort:
            self._is_best_effort = True
            self._node.destroy_subscription(self._subscription)
            self._subscription = self._subscribe(ReliabilityPolicy.BEST_EFFORT)
            self._node.get_logger().info(f"{self._topic} is published with best effort: subscribed likewise")

    def _subscribe(self, reliability: ReliabilityPolicy) -> Any:
        return self._node.create_subscription(
            self._class,
            self._topic,
            self._take,
            QoSProfile(depth=INPUT_DEPTH, reliability=reliability),
            event_callbacks=SubscriptionEventCallbacks(incompatible_qos=self._on_incompatible_qos),
            raw=True,
        )

    def _on_incompatible_qos(self, _: Any) -> None:
        self._is_incompatible = True  # acted on later: the executor is still busy with the subscription


def subscribe_temperature(node: Node, joint: str, take: Callable[[bytes], Any]) -> None:
    """Subscribe to a joint's temperature; `take` takes each message in CDR."""
    profile = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    node.create_subscription(Temperature, temperature_topic(joint), take, profile, raw=True)

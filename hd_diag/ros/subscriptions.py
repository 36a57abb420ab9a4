"""What the node subscribes to: joint states, from best-effort publishers too, and temperatures."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState, Temperature

from hd_diag.messages.publications import INPUT, temperature_topic

INPUT_DEPTH = 2000
"""Samples that may wait while something else takes its time: two seconds of 1 kHz."""


class JointStateInput:
    """Reliable subscription to joint states, in CDR; best effort once a publisher offers no more."""

    def __init__(self, node: Node, take: Callable[[bytes], None]) -> None:
        self._node = node
        self._take = take
        self._is_incompatible = self._is_best_effort = False
        self._subscription = self._subscribe(ReliabilityPolicy.RELIABLE)

    def follow_publishers(self) -> None:
        """Subscribe with best effort where a publisher offers no more: nothing would arrive otherwise."""
        if self._is_incompatible and not self._is_best_effort:
            self._is_best_effort = True
            self._node.destroy_subscription(self._subscription)
            self._subscription = self._subscribe(ReliabilityPolicy.BEST_EFFORT)
            name = self._node.resolve_topic_name(INPUT)
            self._node.get_logger().info(f"{name} is published with best effort: subscribed likewise")

    def _subscribe(self, reliability: ReliabilityPolicy) -> Any:
        return self._node.create_subscription(
            JointState,
            INPUT,
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

"""A second reader beside a subscription, which also gives the numbers of messages."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy

from hd_diag.ros.message_types import message_class
from hd_diag.ros.subscriptions import SignalInput

# Otherwise the node would have a service that describes types, which nothing here answers.
_NO_SERVICE = [Parameter("start_type_description_service", value=False)]


class SecondReader:
    """A best-effort reader beside a subscription, in a separate node that no executor serves.

    At most `depth` messages wait in it, and never more than in the subscription.
    """

    def __init__(self, beside: Node, name: str, taken: SignalInput, depth: int) -> None:
        self._depth = min(depth, taken.depth)
        self._node = rclpy.create_node(
            name,
            context=beside.context,
            namespace=beside.get_namespace(),
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
            parameter_overrides=_NO_SERVICE,
        )
        profile = QoSProfile(depth=self._depth, reliability=ReliabilityPolicy.BEST_EFFORT)
        own = message_class(taken.source.type_name), taken.source.topic, lambda _: None, profile
        self._subscription = self._node.create_subscription(*own, raw=True)

    def take(self) -> Iterator[tuple[bytes, Mapping[str, Any]]]:
        """Messages since the last call, in CDR, each with its message info."""
        for _ in range(self._depth):
            with self._subscription.handle:
                taken = self._subscription.handle.take_message(self._subscription.msg_type, True)
            if taken is None:
                return
            yield taken

    def close(self) -> None:
        """Destroy the separate node."""
        self._node.destroy_node()

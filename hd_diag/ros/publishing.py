"""What the node publishes and logs, under the names that its topics have after remapping."""

from __future__ import annotations

from collections.abc import Sequence

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, Header
from visualization_msgs.msg import MarkerArray

from hd_diag.messages.markers import MARKERS
from hd_diag.messages.publications import (
    DIAGNOSTICS,
    HEADERS,
    INPUT,
    JOINT_STATE,
    MULTI_ARRAY,
    Encoded,
    published_topics,
    temperature_topic,
)
from hd_diag.ros.log_writer import LogWriter

_CLASSES = {
    JOINT_STATE: JointState,
    HEADERS: Header,
    MULTI_ARRAY: Float64MultiArray,
    DIAGNOSTICS: DiagnosticArray,
    MARKERS: MarkerArray,
}
_DEPTH = 2000  # messages that may wait for a reader: two seconds of 1 kHz


class Publishing:
    """A node's publishers and log, and the full names of its input and output topics."""

    def __init__(self, node: Node, joints: Sequence[str], log: LogWriter) -> None:
        self._node = node
        self._log = log
        self._publishers = {
            topic: node.create_publisher(_CLASSES[kind], topic, _DEPTH)
            for topic, kind in published_topics(joints).items()
        }
        topics = (INPUT, *self._publishers, *map(temperature_topic, joints))
        self.names = {topic: node.resolve_topic_name(topic) for topic in topics}

    def emit(self, encoded: Encoded) -> None:
        """Log messages, and publish them if their topic has a publisher and a subscriber."""
        name = self.names.get(encoded.topic) or self._node.resolve_topic_name(encoded.topic)
        self.names[encoded.topic] = name
        publisher = self._publishers.get(encoded.topic)
        rows = [row if isinstance(row, bytes) else row.tobytes() for row in encoded.rows]
        write = self._log.write_some if publisher is None else self._log.write_outputs
        write(name, encoded.type_name, rows, encoded.received.tolist())
        if publisher is not None and publisher.get_subscription_count():
            for data in rows:
                publisher.publish(data)

"""A ROS node that listens to diagnostics and sees which nodes publish them."""

# mypy: disallow-untyped-calls=False

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator
from functools import partial
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown
from std_srvs.srv import Trigger

from hd_diag.messages.publications import DIAGNOSTICS
from hd_diag.watch.state import DEFAULT_TOPIC, NodeSeen, ReportedStatus, Watch

_LOOK_PERIOD = 1.0  # between looks at the ROS graph [s]
_DEPTH = 100  # reports that may wait


class Listener(Node):
    """Gives a `Watch` what is published and which nodes there are."""

    def __init__(self, watch: Watch) -> None:
        name = f"hd_diag_watch_{os.getpid()}"
        super().__init__(name, enable_rosout=False, start_parameter_services=False)
        self._watch = watch
        self._topics: set[str] = set()
        self._diagnosers: dict[str, Any] = {}
        self._next_look = 0.0
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self)
        if not watch.namespaces:
            self._listen(DEFAULT_TOPIC)

    def wait(self, seconds: float) -> None:
        """Sleep until something comes, at most for so long [s]; look around from time to time."""
        now = time.monotonic()
        if now >= self._next_look:
            self._next_look = now + _LOOK_PERIOD
            self.look()
        self._executor.spin_once(timeout_sec=seconds)

    def look(self) -> None:
        """See which nodes there are, and listen to those that are wanted."""
        topics: dict[str, list[str]] = dict(self.get_topic_names_and_types())
        carrying = [topic for topic, types in topics.items() if DIAGNOSTICS in types]
        self._watch.nodes = sorted(node for topic in carrying for node in self._senders(topic, topics))
        for node in self._watch.wanted_nodes():
            self._listen(node.topic)

    def diagnose(self) -> None:
        """Ask the nodes that are watched for a diagnosis; what they answer is told."""
        self._watch.answers.clear()
        for node in self._watch.wanted_nodes():
            client = self._diagnosers.get(node.name) or self.create_client(Trigger, f"{node.name}/diagnose")
            self._diagnosers[node.name] = client
            if client.service_is_ready():
                client.call_async(Trigger.Request()).add_done_callback(partial(self._answered, node.name))
            else:
                self._watch.answers[node.name] = "has no service ~/diagnose"

    def _answered(self, node: str, asked: Any) -> None:
        answer = asked.result()
        self._watch.answers[node] = f"{'diagnosis' if answer.success else 'no diagnosis'}: {answer.message}"

    def destroy_node(self) -> None:
        """Leave the ROS graph."""
        self._executor.shutdown()
        super().destroy_node()

    def _senders(self, topic: str, topics: dict[str, list[str]]) -> Iterator[NodeSeen]:
        """Nodes of this package that publish diagnostics on a topic."""
        for info in self.get_publishers_info_by_topic(topic):
            name = f"{info.node_namespace.rstrip('/')}/{info.node_name}"
            below = [other[len(name) + 1 :] for other in topics if other.startswith(f"{name}/")]
            if "transmission_error" in below:
                joints = (rest.removesuffix("/backlash") for rest in below if rest.endswith("/backlash"))
                yield NodeSeen(name, topic, frozenset(joints))

    def _listen(self, topic: str) -> None:
        if topic not in self._topics:
            self._topics.add(topic)
            self.create_subscription(DiagnosticArray, topic, partial(self._take, topic), _DEPTH)

    def _take(self, topic: str, array: DiagnosticArray) -> None:
        self._watch.take(topic, map(_status, array.status), time.monotonic())


def _status(status: DiagnosticStatus) -> ReportedStatus:
    values = {pair.key: pair.value for pair in status.values}
    level = int.from_bytes(status.level, "little")
    return ReportedStatus(status.name, level, status.message, values, status.hardware_id)


@contextlib.contextmanager
def listening(watch: Watch) -> Iterator[Listener]:
    """A listener in the ROS graph; signals are left to the caller."""
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    try:
        listener = Listener(watch)
        yield listener
        listener.destroy_node()
    finally:
        try_shutdown()

"""A ROS node that listens to diagnostics."""

# mypy: disallow-untyped-calls=False

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator
from functools import partial
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown
from std_srvs.srv import Trigger

from hd_diag.messages.publications import DIAGNOSTICS
from hd_diag.watch.state import Watch

_TOPIC = "/diagnostics"  # the usual topic; remapped ones must end like it
_LOOK_PERIOD, _DEPTH = 1.0, 100  # between looks at the ROS graph [s]; reports that may wait


class Listener(Node):
    """Passes published diagnostics to a `Watch`."""

    def __init__(self, watch: Watch) -> None:
        super().__init__(f"hd_diag_watch_{os.getpid()}", enable_rosout=False, start_parameter_services=False)
        self._watch, self._next_look = watch, 0.0
        self._listen(_TOPIC)

    def wait(self, seconds: float) -> None:
        """Sleep until something comes, at most for so long [s]; listen to new topics from time to time."""
        if time.monotonic() >= self._next_look:
            self._next_look = time.monotonic() + _LOOK_PERIOD
            heard = {subscription.topic_name for subscription in self.subscriptions}
            for topic, types in self.get_topic_names_and_types():
                if topic.endswith(_TOPIC) and DIAGNOSTICS in types and topic not in heard:
                    self._listen(topic)
        rclpy.spin_once(self, timeout_sec=seconds)

    def diagnose(self) -> None:
        """Ask the watched nodes for a diagnosis; their answers are shown."""
        there = dict(self.get_service_names_and_types())
        clients = {each.srv_name: each for each in self.clients}
        self._watch.answers.clear()
        for node in {view.node for view in self._watch.view(0.0)}:
            if (name := f"{node}/diagnose") in there:
                client = clients.get(name) or self.create_client(Trigger, name)
                client.call_async(Trigger.Request()).add_done_callback(partial(self._answered, node))
            else:
                self._watch.answers[node] = "has no service ~/diagnose"

    def _answered(self, node: str, asked: Any) -> None:
        answer = asked.result()
        self._watch.answers[node] = f"{'diagnosis' if answer.success else 'no diagnosis'}: {answer.message}"

    def _listen(self, topic: str) -> None:
        self.create_subscription(
            DiagnosticArray, topic, lambda array: self._watch.take(topic, array, time.monotonic()), _DEPTH
        )


@contextlib.contextmanager
def listening(watch: Watch) -> Iterator[Listener]:
    """A listener in the ROS graph; signals are left to the caller."""
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    try:
        yield Listener(watch)
    finally:
        try_shutdown()

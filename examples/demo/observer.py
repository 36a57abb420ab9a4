"""The demo's own ROS node: listens to the diagnostics and sets parameters of the node shown."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence

from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient

from demo.process import DemoError
from hd_diag.watch.listener import Listener
from hd_diag.watch.state import JointView, Watch

ANSWER_LIMIT = 10.0
"""Longest wait for the answer to a parameter, and for its effect in the diagnostics [s]."""

_STEP = 0.1  # longest sleep between looks at signals [s]


class Observer(Listener):
    """Listens to one joint of a node and sets the node's parameters, until a signal shows in `stopped`."""

    def __init__(self, node: str, joint: str, stopped: Sequence[int]) -> None:
        self._state = Watch(joints=(joint,))
        super().__init__(self._state)
        self._stopped = stopped
        self._client = AsyncParameterClient(self, f"/{node}")

    def is_connected(self) -> bool:
        """Whether the node's services and diagnostics are discovered and samples have reached it."""
        views = self._state.view(0.0)
        return bool(self._client.services_are_ready() and views and views[0].number("samples") > 0.0)

    def wait(self, seconds: float) -> None:
        """Sleep until something comes, at most for so long [s]; KeyboardInterrupt if a signal has come."""
        if self._stopped:
            raise KeyboardInterrupt
        super().wait(min(seconds, _STEP))

    def reports(self, seconds: float) -> Iterator[JointView]:
        """Reports of the joint's diagnostics during the next seconds."""
        end = time.monotonic() + seconds
        while (remaining := end - time.monotonic()) > 0.0:
            before = self._state.messages
            self.wait(remaining)
            if self._state.messages > before:
                yield from self._state.view(time.monotonic())

    def set_parameter(self, name: str, value: float | int) -> str:
        """Set a parameter; return why the node refuses the value, empty if it is in force."""
        future = self._client.set_parameters_atomically([Parameter(name, value=value)])
        end = time.monotonic() + ANSWER_LIMIT
        while not future.done():
            if time.monotonic() > end:
                raise DemoError(f"the node has not answered within {ANSWER_LIMIT:g} s that {name} is set")
            self.wait(_STEP)
        result = future.result().result
        return "" if result.successful else str(result.reason)

"""A bag player on rclpy, and the node as a process: what the tests over DDS share."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Any

import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, Temperature

from hd_diag.bag import BagReader
from hd_diag.parameters import nested

ROOT = Path(__file__).resolve().parent.parent
LIMIT = 30.0  # for anything over DDS to happen on a busy machine [s]
CLASSES = {"sensor_msgs/msg/JointState": JointState, "sensor_msgs/msg/Temperature": Temperature}


@contextlib.contextmanager
def node_process(
    folder: Path, parameters: dict[str, Any], *arguments: str
) -> Iterator[subprocess.Popen[bytes]]:
    """The node with flat parameters, ended by SIGINT; what it prints is in ``node.txt``."""
    file = folder / "node.yaml"
    own = nested({k: v for k, v in parameters.items() if k != "use_sim_time"})
    own |= {"use_sim_time": parameters.get("use_sim_time", False)}
    file.write_text(yaml.safe_dump({"hd_diag": {"ros__parameters": own}}))
    command = [sys.executable, "-m", "hd_diag.node", "--ros-args", "--params-file", str(file), *arguments]
    with (folder / "node.txt").open("wb") as output:
        process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT, cwd=ROOT)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(LIMIT)
        finally:
            process.kill()
            process.wait()


class Player(Node):
    """Plays a bag's joint states and temperatures with ``/clock``, and hears the diagnostics."""

    def __init__(self, context: Context) -> None:
        super().__init__("player", context=context)
        self.statuses: list[dict[str, dict[str, str]]] = []
        self._clock = self.create_publisher(Clock, "/clock", 10)
        self._publishers: dict[str, Any] = {}
        self._heard = self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 100)
        self._client = AsyncParameterClient(self, "/hd_diag")
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self)

    def publisher_of(self, topic: str, type_name: str = "sensor_msgs/msg/JointState") -> Any:
        """Publisher whose messages a subscriber does not lose while it keeps up."""
        if topic not in self._publishers:
            profile = QoSProfile(depth=5000)
            self._publishers[topic] = self.create_publisher(CLASSES[type_name], topic, profile)
        return self._publishers[topic]

    def play(
        self, bag: Path, rate: float = 1.0, loops: int = 1, dropped: Collection[int] = (), spin: bool = True
    ) -> int:
        """Play a bag; messages whose number is in `dropped` are left out. Gives the number published."""
        messages = _messages(bag)
        published = 0
        for _ in range(loops):
            begin, first = time.monotonic(), messages[0][0]
            for number, (stamp, topic, kind, data) in enumerate(messages):
                wait = begin + (stamp - first) * 1e-9 / rate - time.monotonic()
                if wait > 0:
                    time.sleep(wait)
                clock = Clock()
                clock.clock.sec, clock.clock.nanosec = divmod(stamp, 1_000_000_000)
                self._clock.publish(clock)
                if number not in dropped:
                    self.publisher_of(topic, kind).publish(data)
                    published += 1
                if spin:
                    self.spin(0.0)
        return published

    def spin(self, seconds: float) -> None:
        """Hear what has arrived."""
        self._executor.spin_once(timeout_sec=seconds)

    def wait_until(self, is_true: Callable[[], Any]) -> None:
        """Hear until something holds; TimeoutError if it does not come to it."""
        end = time.monotonic() + LIMIT
        while not is_true():
            if time.monotonic() > end:
                raise TimeoutError("what is waited for does not happen")
            self.spin(0.05)

    def wait_for_node(self, topic: str = "/joint_states") -> None:
        """Wait until the node hears the topic, its services answer and its maps are in force."""
        publisher = self.publisher_of(topic)
        self.wait_until(lambda: publisher.get_subscription_count() and self._client.services_are_ready())
        self.wait_until(
            lambda: (
                self.statuses and all(s["prediction"] == "map" for s in self.statuses[-1].values())
            )
        )

    def samples(self) -> int:
        """Samples and refused samples of all joints in the last diagnostics."""
        if not self.statuses:
            return 0
        values = self.statuses[-1].values()
        return sum(int(s["samples"]) + int(s["samples_rejected"]) for s in values)

    def set_parameters(self, **values: Any) -> str:
        """Set parameters of the node together (``__`` for a dot); the reason where they are refused."""
        given = [Parameter(k.replace("__", "."), value=v) for k, v in values.items()]
        future = self._client.set_parameters_atomically(given)
        self.wait_until(future.done)
        result = future.result().result
        return "" if result.successful else str(result.reason)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        found = {s.name: {e.key: e.value for e in s.values} for s in message.status}
        self.statuses.append(found)


@contextlib.contextmanager
def player() -> Iterator[Player]:
    """A player with a ROS context of its own."""
    context = Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO, domain_id=_domain())
    made = Player(context)
    try:
        yield made
    finally:
        made.destroy_node()
        rclpy.shutdown(context=context)


def _domain() -> int:
    return int(os.environ["ROS_DOMAIN_ID"])


def _messages(bag: Path) -> list[tuple[int, str, str, bytes]]:
    """Log time [ns], topic, type and CDR of what can be played, in order."""
    with BagReader(bag) as reader:
        return [
            (time_, batch.topic.name, batch.topic.type_name, bytes(data))
            for batch in reader.batches()
            if batch.topic.type_name in CLASSES
            for time_, data in zip(batch.log_time.tolist(), batch.messages(), strict=True)
        ]

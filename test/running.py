"""A node in its own process, as users run it, and the tests' side of its topics."""

import contextlib
import itertools
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from live import sample
from rcl_interfaces.msg import SetParametersResult
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

LIMIT = 60.0  # for discovery and answers on a busy machine [s]
START_LIMIT = 500.0  # for the first node on a machine, which compiles the model [s]
PUBLISHER_DEPTH = 5000
Condition = Callable[[dict[str, str]], bool]
_numbers = itertools.count()


class Process:
    """``python -m hd_diag.ros.node`` with a parameter file.

    Every node of a test process has its own namespace, also for diagnostics. `by_config` runs
    ``hd-diag node --config`` instead, with a file that begins with the node's name.
    """

    def __init__(
        self, folder: Path, parameters: Mapping[str, Any], *arguments: str, by_config: bool = False
    ) -> None:
        self.namespace = f"/n{next(_numbers)}"
        file = folder / "parameters.yaml"
        head = "hd_diag" if by_config else "/**"
        file.write_text(yaml.safe_dump({head: {"ros__parameters": dict(parameters)}}))
        self.stderr = folder / "stderr.txt"
        start = ["-m", "hd_diag.ros.node", "--ros-args", "--params-file", str(file)]
        if by_config:
            start = ["-m", "hd_diag", "node", "--config", str(file), "--", "--ros-args"]
        ros = ["-r", f"__ns:={self.namespace}"]
        remap = ["-r", f"/diagnostics:={self.namespace}/diagnostics", "-r", f"/clock:={self.namespace}/clock"]

        with self.stderr.open("wb") as stderr:
            command = [sys.executable, *start, *ros, *remap, *arguments]
            self.popen = subprocess.Popen(command, stdout=stderr, stderr=stderr)

    def end(self, number: int = signal.SIGTERM) -> int:
        """Send a signal, wait for the end and return the exit code."""
        self.popen.send_signal(number)
        return self.popen.wait(LIMIT)

    def output(self) -> str:
        return self.stderr.read_text()

    def __enter__(self) -> "Process":
        return self

    def __exit__(self, *_: object) -> None:
        if self.popen.poll() is None:
            self.popen.kill()
            self.popen.wait(LIMIT)


class Rig:
    """Publishers, subscriptions and a parameter client around a node."""

    def __init__(self, process: Process) -> None:
        self.process = process
        self.node = rclpy.create_node("rig", namespace=process.namespace)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self.client = AsyncParameterClient(self.node, f"{process.namespace}/hd_diag")
        self.reports: list[DiagnosticArray] = []
        self._heard: list[Any] = []
        self._subscribe("diagnostics", DiagnosticArray, self.reports)
        self.until(lambda: self.reports, "first report", START_LIMIT)

    def until(self, condition: Callable[[], Any], what: str, limit: float = LIMIT) -> Any:
        """Wait until the condition is true and return its result."""
        end = time.monotonic() + limit
        while not (result := condition()):
            code = self.process.popen.poll()
            assert code is None, f"the node ended with {code}: {self.process.output()}"
            assert time.monotonic() < end, f"no {what} within {limit} s: {self.process.output()}"
            self._executor.spin_once(timeout_sec=0.02)
        return result

    def drain(self) -> None:
        """Take everything that has already arrived."""
        quiet = 0
        while quiet < 5:
            before = len(self.reports)
            self._executor.spin_once(timeout_sec=0.0)
            quiet = quiet + 1 if len(self.reports) == before else 0

    def publisher(self, topic: str = "joint_states", kind: Any = JointState, reliable: bool = True) -> Any:
        """Publisher that the node has discovered."""
        reliability = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
        profile = QoSProfile(depth=PUBLISHER_DEPTH, reliability=reliability)
        made = self.node.create_publisher(kind, topic, profile)
        self.until(lambda: made.get_subscription_count() > 0, f"subscription to {topic}")
        return made

    def acknowledged(self, publisher: Any) -> None:
        """Wait until the node has everything published: from then on DDS reports its losses to the node.

        For a publisher that it has just discovered, DDS counts no losses.
        """
        assert publisher.wait_for_all_acked(Duration(seconds=LIMIT))

    def hear(self, kinds: Mapping[str, Any]) -> dict[str, list[Any]]:
        """Subscribe to topics of the node, by their types; each topic gets a list of its later messages.

        Earlier subscriptions end, because taking large messages leaves time for little else. The node learns
        of subscriptions in their order: once a later one receives a report, the node knows all earlier ones.
        """
        while self._heard:
            self.node.destroy_subscription(self._heard.pop())
        found: dict[str, list[Any]] = {topic: [] for topic in kinds}
        self._heard = [self._subscribe(topic, kind, found[topic]) for topic, kind in kinds.items()]
        self.until(
            lambda: all(each.get_publisher_count() for each in self._heard), f"publishers of {[*kinds]}"
        )
        later: list[DiagnosticArray] = []
        probe = self._subscribe("diagnostics", DiagnosticArray, later)
        self.until(lambda: later, "report to a later subscription")
        self.node.destroy_subscription(probe)
        return found

    def _subscribe(self, topic: str, kind: Any, into: list[Any]) -> Any:
        return self.node.create_subscription(kind, topic, into.append, QoSProfile(depth=5000))

    def status(
        self,
        joint: str,
        condition: Condition = lambda values: True,
        meanwhile: Callable[[], None] = lambda: None,
    ) -> DiagnosticStatus:
        """First report from now on that fulfils a condition; ``meanwhile`` is called before each check."""
        self.drain()
        seen = len(self.reports)

        def fulfilled() -> DiagnosticStatus | None:
            nonlocal seen
            meanwhile()
            while seen < len(self.reports):
                seen += 1
                for status in self.reports[seen - 1].status:
                    if status.name == f"hd_diag: {joint}" and condition(values_of(status)):
                        return status
            return None

        found: DiagnosticStatus = self.until(fulfilled, f"such report of {joint}")
        return found

    def values(self, joint: str, *conditions: Any) -> dict[str, str]:
        return values_of(self.status(joint, *conditions))

    def set(self, atomically: bool = False, **given: Any) -> list[SetParametersResult]:
        """Set parameters as another process does; in names ``__`` stands for a dot."""
        parameters = [Parameter(name.replace("__", "."), value=value) for name, value in given.items()]
        self.until(self.client.services_are_ready, "parameter services")
        call = self.client.set_parameters_atomically if atomically else self.client.set_parameters
        future = call(parameters)
        self.until(future.done, "answer")
        answer = future.result()
        return [answer.result] if atomically else list(answer.results)

    def get(self, *names: str) -> list[Any]:
        self.until(self.client.services_are_ready, "parameter services")
        future = self.client.get_parameters(list(names))
        self.until(future.done, "answer")
        return list(future.result().values)

    def call(self, name: str, kind: Any = Trigger, **fields: Any) -> tuple[bool, str]:
        """Call a service of the node that answers at once; returns its answer."""
        client = self.node.create_client(kind, f"hd_diag/{name}")
        self.until(client.service_is_ready, f"service {name}")
        asked = client.call_async(kind.Request(**fields))
        self.until(asked.done, "answer")
        self.node.destroy_client(client)
        return asked.result().success, asked.result().message

    def close(self) -> None:
        self._executor.shutdown()
        self.node.destroy_node()


def children(pid: int, word: bytes) -> list[int]:
    """Processes started by a process whose command contains a word."""
    found = []
    for each in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((each / "stat").read_text().rpartition(")")[2].split()[1])
            if parent == pid and word in (each / "cmdline").read_bytes():
                found.append(int(each.name))
        except OSError:
            continue
    return found


def values_of(status: DiagnosticStatus) -> dict[str, str]:
    return {pair.key: pair.value for pair in status.values}


def stamp_of(message: Any) -> int:
    """Time in a message's header [ns]."""
    return int(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)


def feed(
    publisher: Any, stamps: Iterator[int], count: int, rate: float = 1000.0, joint: str = "joint_1"
) -> None:
    """Publish samples of a turning joint at a rate [Hz]."""
    begin = time.monotonic()
    for i in range(count):
        stamp = next(stamps)
        publisher.publish(sample(stamp, 0.01 * i, 0.01 * i / 100.0, 1.0, joint))
        time.sleep(max(0.0, begin + (i + 1) / rate - time.monotonic()))


@contextlib.contextmanager
def running(
    folder: Path, parameters: Mapping[str, Any], *arguments: str, by_config: bool = False
) -> Iterator[Rig]:
    """A node that answers, with its rig."""
    with Process(folder, parameters, *arguments, by_config=by_config) as process:
        rig = Rig(process)
        try:
            yield rig
        finally:
            rig.close()

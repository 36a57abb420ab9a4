"""Publishers of the node's input: numbers of messages, and looks at real publishers."""

import itertools
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import rclpy
from hypothesis import given
from hypothesis import strategies as st
from live import MS, START, config, message
from rclpy.node import Node
from running import LIMIT
from sensor_msgs.msg import JointState

from hd_diag.config.configured_signals import JOINT_STATE
from hd_diag.ros.publishers import Numbers, Publishers
from hd_diag.ros.subscriptions import SignalInput, SignalTopic

pytestmark = pytest.mark.usefixtures("ros")

STEPS = st.lists(st.tuples(st.sampled_from(("one", "other")), st.integers(1, 2**40)))


@given(STEPS, st.integers(0, 2**62))
def test_publishers_of_different_joints_are_no_second_publisher(steps: Any, begin: int) -> None:
    numbers, last = Numbers(), {"one": 0, "other": begin}
    for name, step in steps:
        last[name] += step
        numbers.take(last[name], {name, f"{name}_motor"})
    assert numbers.doubled == set()


@given(st.integers(0, 2**62), st.integers(0, 2**62))
def test_two_publishers_that_alternate_are_found_within_three_messages(one: int, other: int) -> None:
    numbers = Numbers()
    for number in (one, other, one + 1):
        numbers.take(number, {"elbow"})
    assert numbers.doubled == {"elbow"}


class Bench:
    def __init__(self) -> None:
        self.node = rclpy.create_node("listener")
        taken = SignalInput(self.node, SignalTopic("/bench/joint_states", JOINT_STATE), lambda *_: None)
        self.seen = Publishers(self.node, [taken], length=0.2, rest=0.02)
        self.joints = config("elbow", "wrist").joints
        self.made: dict[str, tuple[Node, Any, tuple[str, ...]]] = {}
        self.looks = 0
        self._stamps = itertools.count(START, MS)

    def add(self, node: str, *names: str) -> None:
        own = rclpy.create_node(node, namespace="bench")
        self.made[node] = own, own.create_publisher(JointState, "joint_states", 10), names

    def remove(self, node: str) -> None:
        self.made.pop(node)[0].destroy_node()

    @property
    def is_looking(self) -> bool:
        return "_hd_diag_look" in self.node.get_node_names()

    def until(self, condition: Callable[[list[str]], Any]) -> list[str]:
        """Publish from all until a condition holds for the messages of faults; return these."""
        end = time.monotonic() + LIMIT
        while not condition(said := self.seen.faults(self.joints)):
            assert time.monotonic() < end, said
            for _, publisher, names in self.made.values():
                publisher.publish(message(next(self._stamps), dict.fromkeys(names, 0.0)))
            before = self.is_looking
            self.seen.look()
            self.looks += before and not self.is_looking
            time.sleep(0.005)
        return said

    def looked(self, times: int = 1) -> list[str]:
        wanted = self.looks + times
        return self.until(lambda _: self.looks >= wanted)


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench()
    yield made
    for node, *_ in made.made.values():
        node.destroy_node()
    made.seen.close()
    made.node.destroy_node()


def test_a_joint_with_two_publishers_is_told_until_one_goes(bench: Bench) -> None:
    """A third one publishes another joint: while there are several, each look reports it."""
    bench.add("left", "elbow")
    bench.add("right", "elbow", "wheel")
    bench.add("third", "wrist_motor", "wheel")
    said = bench.until(lambda said: said and "third" in said[0])
    who = "/bench/left, /bench/right, /bench/third"
    assert said == [f"/bench/joint_states has more than one publisher of elbow; on it publish {who}"]
    bench.remove("right")
    bench.until(lambda said: not said)
    bench.remove("left")
    assert bench.until(lambda said: not bench.is_looking) == []


def test_parts_of_a_joint_and_a_publisher_alone_are_looked_at_and_are_no_fault(bench: Bench) -> None:
    bench.add("left", "elbow_motor", "wheel")
    bench.add("right", "elbow", "wheel")
    assert bench.looked(3) == []


def test_one_that_follows_another_is_no_second(bench: Bench) -> None:
    """The successor's numbers restart during a look."""
    bench.add("other", "wrist")
    bench.add("first", "elbow")
    bench.until(lambda _: bench.made["first"][1].get_subscription_count() > 1)
    look = bench.seen._look
    bench.until(lambda _: look is None or look[0].numbers._last.get("elbow", 0) > 1)
    bench.remove("first")
    bench.add("second", "elbow")
    assert bench.looked() == []


def test_one_that_begins_late_is_found_and_a_look_under_way_ends_at_once(bench: Bench) -> None:
    bench.add("left", "elbow")
    bench.add("right")
    bench.looked()
    node, publisher, _ = bench.made["right"]
    bench.made["right"] = node, publisher, ("elbow",)
    assert bench.until(lambda said: said)
    bench.until(lambda _: bench.is_looking)
    bench.seen.close()
    assert not bench.is_looking

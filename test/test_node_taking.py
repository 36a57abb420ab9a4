"""How the node takes arrived messages from rclpy's executor."""

import gc
import sys
import time

import pytest
import rclpy
from live import START, message
from rclpy.duration import Duration
from rclpy.experimental.events_executor import EventsExecutor
from sensor_msgs.msg import JointState

from hd_diag.ros.node import take_all
from hd_diag.ros.subscriptions import INPUT_DEPTH

pytestmark = pytest.mark.usefixtures("ros")
TURNS = 5000  # of the node: 80 s at 1 kHz, 5 s with simulated time


def blocks() -> int:
    gc.collect()
    return sys.getallocatedblocks()


def test_all_that_is_there_is_taken_and_nothing_stays_of_it() -> None:
    """Objects that remain after every turn would fill the memory while the node runs."""
    node, other, taken = rclpy.create_node("taking"), rclpy.create_node("giving"), []
    executor = EventsExecutor()
    executor.add_node(node)
    node.create_subscription(JointState, "taking/states", taken.append, INPUT_DEPTH, raw=True)
    publisher = other.create_publisher(JointState, "taking/states", INPUT_DEPTH)
    sent = [message(START + number, {"elbow": 0.1}) for number in range(100)]
    end = time.monotonic() + 60.0
    while not taken:  # both must discover each other
        publisher.publish(message(0, {"elbow": 0.1}))
        time.sleep(0.1)
        take_all(executor)
        assert time.monotonic() < end
    for row in sent:
        publisher.publish(row)
    assert publisher.wait_for_all_acked(Duration(seconds=60.0))
    time.sleep(0.1)  # until the executor learns of the last message
    take_all(executor)
    assert taken[-len(sent) :] == sent
    for _ in range(2):  # the first turns also create what later turns reuse
        before = blocks()
        for _ in range(TURNS):
            take_all(executor)
    assert blocks() - before < TURNS // 10
    executor.shutdown()

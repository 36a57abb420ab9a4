"""Set parameters of a running node at once, without the ros2 command: NODE NAME=VALUE..."""

# ruff: noqa: T201

import json
import sys
from contextlib import suppress

import rclpy
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient

PATIENCE = 10.0  # [s]


def parameter(text: str) -> Parameter:
    """A parameter from NAME=VALUE: a number, true or false if the value reads as one, otherwise a text."""
    name, _, value = text.partition("=")
    with suppress(ValueError):
        value = json.loads(value)
    return Parameter(name, value=value)


if __name__ == "__main__":
    rclpy.init()
    client = AsyncParameterClient(rclpy.create_node("set_parameters"), sys.argv[1])
    if not client.wait_for_services(PATIENCE):
        sys.exit(f"no node {sys.argv[1]}")
    future = client.set_parameters_atomically([parameter(text) for text in sys.argv[2:]])
    rclpy.spin_until_future_complete(client.node, future, timeout_sec=PATIENCE)
    if not future.done():
        sys.exit(f"{sys.argv[1]} has not answered")
    result = future.result().result
    print("in force" if result.successful else f"refused: {result.reason}")
    sys.exit(not result.successful)

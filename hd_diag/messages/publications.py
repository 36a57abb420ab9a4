"""Results as ROS 2 messages: the same bytes live, in the log and in a replay."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Times
from hd_diag.messages.encoding import (
    encode_diagnostic_array,
    encode_float64_multiarray,
    encode_joint_state,
    encode_joint_states,
)
from hd_diag.messages.markers import MARKERS, drawing, marker_array
from hd_diag.messages.schemas import jazzy, serialize
from hd_diag.monitor.publications import Angles, Drawings, Publication, Report, ToothArrays

JOINT_STATE = "sensor_msgs/msg/JointState"
MULTI_ARRAY = "std_msgs/msg/Float64MultiArray"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
TEMPERATURE = "sensor_msgs/msg/Temperature"
STRING = "std_msgs/msg/String"
PARAMETER_EVENT = "rcl_interfaces/msg/ParameterEvent"

OWN_OUTPUTS = ("/transmission_error", "/measured_transmission_error", "/residual")
"""Ends of the topics on which the node publishes JointState: no joint's states."""

_NANOSECONDS = 1_000_000_000

LAST_TIME = 2**31 * _NANOSECONDS - 1
"""Last time that a builtin_interfaces/Time can hold: January 2038 [ns]."""


INPUT = "joint_states"
"""Topic that a node listens to, by its name in the node's namespace."""


class Encoded(NamedTuple):
    """Messages of a topic: name as the monitor gives it, type, time of the cause [ns] (n,), CDR of all n."""

    topic: str
    type_name: str
    received: Times
    rows: npt.NDArray[np.uint8] | list[bytes]


def encode(publication: Publication, node: str = "/hd_diag") -> Encoded:
    """CDR of what a monitor publishes.

    Parameters
    ----------
    publication : Angles, ToothArrays, Drawings or Report
    node : str
        Full name of the node, which diagnostics hold.

    Returns
    -------
    Encoded
    """
    if isinstance(publication, Angles):
        return Encoded(publication.topic, JOINT_STATE, publication.received, _joint_states(publication))
    if isinstance(publication, ToothArrays):
        teeth = publication.values.shape[2]
        rows = encode_float64_multiarray((("flank", 2), ("tooth", teeth)), publication.values)
        return Encoded(publication.topic, MULTI_ARRAY, publication.received, rows)
    if isinstance(publication, Drawings):
        return Encoded(publication.topic, MARKERS, publication.received, _markers(publication))
    return Encoded(
        publication.topic, DIAGNOSTICS, np.array([publication.received]), [_diagnostics(publication, node)]
    )


def published_topics(joints: Sequence[str]) -> dict[str, str]:
    """Topics that a monitor of these joints publishes on, with their types."""
    topics = dict.fromkeys(
        ("~/transmission_error", "~/measured_transmission_error", "~/residual"), JOINT_STATE
    )
    topics["/diagnostics"] = DIAGNOSTICS
    for joint in joints:
        topics |= {
            f"~/{joint}/backlash": MULTI_ARRAY,
            f"~/{joint}/load": MULTI_ARRAY,
            f"~/{joint}/mesh": MARKERS,
        }
    return topics


def temperature_topic(joint: str) -> str:
    """Topic of a joint's temperature, by its name in the node's namespace."""
    return f"{joint}/temperature"


def resolved(topic: str, node: str = "/hd_diag") -> str:
    """Full name of a topic of the node; ``~`` stands for the node's name."""
    return node + topic[1:] if topic.startswith("~") else topic


def string(text: str) -> bytes:
    """CDR of a std_msgs/String."""
    return serialize(_types()["std_msgs/msg/String"](text), STRING)


def read_string(data: bytes) -> str:
    """Text of a std_msgs/String in CDR."""
    message: Any = jazzy().deserialize_cdr(data, STRING)
    return str(message.data)


def read_temperature(data: bytes) -> float:
    """Temperature of a sensor_msgs/Temperature in CDR [degree Celsius]."""
    message: Any = jazzy().deserialize_cdr(data, TEMPERATURE)
    return float(message.temperature)


def parameter_event(node: str, stamp: int, values: Mapping[str, Any], new: bool) -> bytes:
    """CDR of an rcl_interfaces/ParameterEvent.

    Parameters
    ----------
    node : str
        Full name of the node.
    stamp : int
        [ns]
    values : mapping
        Full parameter names and values.
    new : bool
        Whether they are declared rather than changed.
    """
    types = _types()
    parameters = [_parameter(name, value) for name, value in values.items()]
    event = types["rcl_interfaces/msg/ParameterEvent"](
        _time(stamp), node, parameters if new else [], [] if new else parameters, []
    )
    return serialize(event, PARAMETER_EVENT)


@functools.cache
def _types() -> Mapping[str, Callable[..., Any]]:
    return jazzy().types


def _time(stamp: int) -> Any:
    second, nano = divmod(stamp, _NANOSECONDS)
    return _types()["builtin_interfaces/msg/Time"](second, nano)


def _joint_states(angles: Angles) -> npt.NDArray[np.uint8] | list[bytes]:
    if angles.stamp.size > 1:
        return encode_joint_states(angles.names, angles.stamp, angles.position, None, angles.effort)
    stamp = int(angles.stamp[0])
    return [encode_joint_state(angles.names, stamp, angles.position, None, angles.effort)]


def _markers(drawings: Drawings) -> list[bytes]:
    """The gears, each in a frame with the name of its joint."""
    columns = zip(drawings.stamp, drawings.input_angle, drawings.load, drawings.torsion, strict=True)
    return [
        marker_array(
            drawing(
                drawings.drive, float(angle), load, torsion=float(torsion), full_scale=drawings.full_scale
            ),
            int(stamp),
            drawings.joint,
        )
        for stamp, angle, load, torsion in columns
    ]


def _diagnostics(report: Report, node: str) -> bytes:
    """The hardware is the node's joint, named as its topics begin: other nodes may have one of that name."""
    statuses = (
        (status.level, status.name, status.message, f"{node}/{status.joint}", status.values)
        for status in report.statuses
    )
    return encode_diagnostic_array(report.stamp, statuses)


def _parameter(name: str, value: Any) -> Any:
    types = _types()
    fields: dict[str, Any] = {
        "type": 0,
        "bool_value": False,
        "integer_value": 0,
        "double_value": 0.0,
        "string_value": "",
        "byte_array_value": np.array([], np.uint8),
        "bool_array_value": np.array([], bool),
        "integer_array_value": np.array([], np.int64),
        "double_array_value": np.array([]),
        "string_array_value": [],
    }
    fields |= _parameter_value(value)
    return types["rcl_interfaces/msg/Parameter"](name, types["rcl_interfaces/msg/ParameterValue"](**fields))


def _parameter_value(value: Any) -> dict[str, Any]:
    """Fields of a ParameterValue, with the type numbers of rcl_interfaces/ParameterType."""
    if isinstance(value, bool):
        return {"type": 1, "bool_value": value}
    if isinstance(value, int):
        return {"type": 2, "integer_value": value}
    if isinstance(value, float):
        return {"type": 3, "double_value": value}
    if isinstance(value, str):
        return {"type": 4, "string_value": value}
    if all(isinstance(item, str) for item in value):
        return {"type": 9, "string_array_value": list(value)}
    return {"type": 8, "double_array_value": np.array(value, np.float64)}

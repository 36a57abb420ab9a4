"""Results as ROS 2 messages: the same bytes live, in the log and in a replay."""

from __future__ import annotations

import functools
import struct
from collections.abc import Mapping, Sequence, Sized
from typing import Any, NamedTuple

import numpy as np

from hd_diag.arrays import Bytes, Times
from hd_diag.config.configured_signals import TEMPERATURE as TEMPERATURE
from hd_diag.messages.encoding import (
    HEADER,
    encode_float64_multiarray,
    encode_headers,
    encode_joint_states,
    text,
)
from hd_diag.messages.joint_states import JOINT_STATE as JOINT_STATE
from hd_diag.messages.markers import MARKERS, drawing, marker_array
from hd_diag.messages.schemas import deserialize, jazzy, serialize
from hd_diag.monitor.publications import Angles, Drawings, Publication, Report, Stamps, ToothArrays
from hd_diag.streams.columns import LARGEST_TEMPERATURE

HEADERS = "std_msgs/msg/Header"
MULTI_ARRAY = "std_msgs/msg/Float64MultiArray"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
STRING = "std_msgs/msg/String"
PARAMETER_EVENT = "rcl_interfaces/msg/ParameterEvent"

INPUT = "joint_states"
"""Topic that a node subscribes to, relative to the node's namespace."""

OWN_OUTPUTS = ("/transmission_error", "/measured_transmission_error", "/residual")
"""Ends of the names of the node's own JointState topics, which hold no joint's states."""

_NANOSECONDS = 1_000_000_000

_REPEATED = 4096
"""Number of cached texts of diagnostics; a joint has 130."""

LAST_TIME = 2**31 * _NANOSECONDS - 1
"""Last time that a builtin_interfaces/Time can hold: January 2038 [ns]."""


class Encoded(NamedTuple):
    """n messages of a topic: the monitor's name of the topic, type, time of the cause [ns] (n,), CDR."""

    topic: str
    type_name: str
    received: Times
    rows: Bytes | list[bytes]


def encode(publication: Publication, node: str = "/hd_diag") -> Encoded:
    """CDR of a monitor's publication; diagnostics hold the full name of the node."""
    if isinstance(publication, Report):
        received, rows = np.array([publication.received]), [_diagnostics(publication, node)]
        return Encoded(publication.topic, DIAGNOSTICS, received, rows)
    kind, encoded = _rows(publication)
    return Encoded(publication.topic, kind, publication.received, encoded)


def _rows(publication: Angles | Stamps | ToothArrays | Drawings) -> tuple[str, Bytes | list[bytes]]:
    if isinstance(publication, Angles):
        _, _, stamp, names, position, effort = publication
        return JOINT_STATE, encode_joint_states(names, stamp, position, None, effort)
    if isinstance(publication, Stamps):
        return HEADERS, encode_headers(publication.stamp, publication.joint)
    if isinstance(publication, ToothArrays):
        dims = ("flank", 2), ("tooth", publication.values.shape[2])
        return MULTI_ARRAY, encode_float64_multiarray(dims, publication.values)
    return MARKERS, _markers(publication)


def published_topics(joints: Sequence[str]) -> dict[str, str]:
    """Topics that a monitor of these joints publishes on, with their types."""
    topics = dict.fromkeys((f"~{end}" for end in OWN_OUTPUTS), JOINT_STATE) | {"/diagnostics": DIAGNOSTICS}
    for joint in joints:
        topics[f"~/{joint}/stamp"] = HEADERS
        topics |= {f"~/{joint}/{what}": MULTI_ARRAY for what in ("backlash", "load")}
        topics[f"~/{joint}/mesh"] = MARKERS
    return topics


def temperature_topic(joint: str) -> str:
    """Topic of a joint's temperature, relative to the node's namespace."""
    return f"{joint}/temperature"


def resolved(topic: str, node: str = "/hd_diag") -> str:
    """Full name of a topic of the node; ``~`` means the node's name."""
    return node + topic[1:] if topic.startswith("~") else topic


def string(value: str) -> bytes:
    """CDR of a std_msgs/String."""
    return HEADER + text(value, 1)


def read_string(data: bytes) -> str:
    """Text of a std_msgs/String in CDR."""
    return str(deserialize(jazzy(), data, STRING).data)


def read_temperature(data: bytes) -> float:
    """Temperature of a sensor_msgs/Temperature in CDR [degree Celsius]; ValueError if it is impossible."""
    try:
        value = float(deserialize(jazzy(), data, TEMPERATURE).temperature)
    except ValueError as error:
        raise ValueError(f"a Temperature message cannot be read: {error}") from error
    if not abs(value) <= LARGEST_TEMPERATURE:
        raise ValueError(f"temperature is {value}")
    return value


def parameter_event(node: str, stamp: int, values: Mapping[str, Any], new: bool) -> bytes:
    """CDR of an rcl_interfaces/ParameterEvent of a node (full name) at a time [ns].

    `values` are by full parameter names; `new` means that they are declared rather than changed.
    """
    parameters = [_parameter(name, value) for name, value in values.items()]
    declared, changed = (parameters, []) if new else ([], parameters)
    event = jazzy().types[PARAMETER_EVENT](_time(stamp), node, declared, changed, [])
    return serialize(event, PARAMETER_EVENT)


def _time(stamp: int) -> Any:
    return jazzy().types["builtin_interfaces/msg/Time"](*divmod(stamp, _NANOSECONDS))


def _markers(drawings: Drawings) -> list[bytes]:
    """Drawings of the gear, each in a frame with the name of its joint."""
    columns = zip(drawings.stamp, drawings.input_angle, drawings.load, drawings.torsion, strict=True)
    messages = []
    for stamp, angle, load, torsion in columns:
        scale = drawings.full_scale
        shapes = drawing(drawings.drive, float(angle), load, torsion=float(torsion), full_scale=scale)
        messages.append(marker_array(shapes, int(stamp), drawings.joint))
    return messages


def _diagnostics(report: Report, node: str) -> bytes:
    """CDR of a report. The hardware is node and joint, because other nodes may have a joint of that name."""
    body = bytearray(struct.pack("<iI", *divmod(report.stamp, _NANOSECONDS)) + text(""))
    body += _count(report.statuses)
    for status in report.statuses:
        body.append(status.level)
        parts = [bytes(-len(body) % 4), text(status.name), text(status.message)]
        parts += [text(f"{node}/{status.joint}"), _count(status.values)]
        for key, value in status.values.items():
            parts += (_told(key), _told(value))
        parts[-1] = text(value, 1)
        body += b"".join(parts)
    return HEADER + bytes(body)


def _count(values: Sized) -> bytes:
    return struct.pack("<I", len(values))


_told = functools.lru_cache(_REPEATED)(text)  # cached, because most texts repeat the report before


def _parameter(name: str, value: Any) -> Any:
    types = jazzy().types
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
    for number, kind in enumerate((bool, int, float, str), start=1):
        if isinstance(value, kind):
            what = ("bool", "integer", "double", "string")[number - 1]
            return {"type": number, f"{what}_value": value}
    if all(isinstance(item, str) for item in value):
        return {"type": 9, "string_array_value": list(value)}
    return {"type": 8, "double_array_value": np.array(value, np.float64)}

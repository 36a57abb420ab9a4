"""Signals of a joint from its parameters."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from hd_diag.config.parameters import ConfigError, Value, shown
from hd_diag.streams.signals import ROLES, JointSignals, Signal, unit

JOINT_STATE = "sensor_msgs/msg/JointState"
TEMPERATURE = "sensor_msgs/msg/Temperature"

OWNERS = dict(zip(ROLES, ("input", "output_signal", "torque_signal", "temperature_signal"), strict=True))
"""Parameter section of each signal."""

# Default field and unit.
_USUAL = {
    "input": ("position", "rad"),
    "output": ("position", "rad"),
    "torque": ("effort", "N m"),
    "temperature": ("temperature", "degC"),
}
_VELOCITY = "velocity"
_TYPE = re.compile(r"([A-Za-z]\w*)/(?:msg/)?([A-Za-z]\w*)", re.ASCII)


def spelled_out(given: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters with ``input: velocity`` expanded to its mapping; ConfigError for another word."""
    found = dict(given)
    for name in [n for n in found if n.endswith(".input") and not isinstance(found[n], Mapping)]:
        value, joint = found.pop(name), name.removesuffix(".input")
        if value != _VELOCITY:
            raise ConfigError(f"{name}: expected '{_VELOCITY}' or topic, field, ..., not {shown(value)}")
        found |= {f"{name}.field": _VELOCITY, f"{joint}.input_divided": True}
    return found


def signals_from(joint: str, own: Mapping[str, Value]) -> JointSignals:
    """Signals of a joint from its parameters by their names within it; ConfigError names an invalid one."""
    return JointSignals(*(_signal(joint, role, owner, own) for role, owner in OWNERS.items()))


def _signal(joint: str, role: str, owner: str, own: Mapping[str, Value]) -> Signal | None:
    keys = ("topic", "type", "field", "name", "unit")
    topic, kind, field, name, text = (own[f"{owner}.{key}"] for key in keys)
    scale, sign, stamp = (own[f"{owner}.{key}"] for key in ("scale", "sign", "stamp"))
    if (topic, kind, field, name, text, scale, sign, stamp) == ("", "", "", "", "", 1.0, 1, "header"):
        return None
    usual_field, usual_unit = _USUAL[role]
    type_name = _type(f"{joint}.{owner}.type", kind) or (
        TEMPERATURE if role == "temperature" else JOINT_STATE
    )
    if not topic and type_name != JOINT_STATE:
        raise ConfigError(f"{joint}.{owner}.topic: the topic with {type_name} must be named")
    if not field and type_name not in (JOINT_STATE, TEMPERATURE):
        raise ConfigError(f"{joint}.{owner}.field: the field of {type_name} must be named")
    is_velocity = role == "input" and type_name == JOINT_STATE and field.startswith(_VELOCITY)
    at_motor = role == "input" and not (is_velocity and own["input_divided"])
    name = name or (own["input_joint"] or f"{joint}_motor" if at_motor else own["output_joint"] or joint)
    try:
        known = unit(role, text or ("rad/s" if is_velocity else usual_unit))
    except ValueError as error:
        raise ConfigError(f"{joint}.{owner}.unit: {error}") from error
    known = known._replace(factor=known.factor * scale * sign)
    path = (field or usual_field).replace("{name}", name)
    return Signal(topic, type_name, path, name, known, stamp == "reception")


def _type(parameter: str, text: str) -> str:
    """Full name of a type, ``package/msg/Name``; empty for none."""
    found = _TYPE.fullmatch(text)
    if text and not found:
        raise ConfigError(
            f"{parameter}: expected a type such as control_msgs/DynamicJointState, not {shown(text)}"
        )
    return f"{found[1]}/msg/{found[2]}" if found else ""

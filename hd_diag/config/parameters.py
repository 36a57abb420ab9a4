"""Every parameter of a configuration, from ``parameters.csv``, and the check of a single value."""

from __future__ import annotations

import contextlib
import csv
import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hd_diag.streams.signals import nearest

Value = Any
"""bool, int, float, str, or a list of numbers or texts: once checked, in its parameter's own type."""


class ConfigError(ValueError):
    """A configuration that cannot be used; the text names the parameter, the value and what was expected."""


class ContentError(ConfigError):
    """A file's content is wrong. The text quotes some of it; `discreet` is a text that quotes nothing."""

    def __init__(self, text: str, discreet: str = "") -> None:
        super().__init__(text)
        self.discreet = discreet


@dataclass(frozen=True)
class Parameter:
    """One parameter: name within its owner, default (whose type it has), unit, meaning, range.

    `scale` names the quantity that the default scales with between drives (:mod:`hd_diag.config.defaults`).
    """

    name: str
    default: Value
    unit: str
    meaning: str
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()
    scale: str = ""


_MOST_JOINTS = 256
_LONGEST_TEXT = 80  # of a name or value that an error names
_WORDS = {bool: "true or false", str: "a text"}


def _tables() -> dict[str, tuple[Parameter, ...]]:
    """Parameters of the node and of each joint, from the table beside this module."""
    found: dict[str, tuple[Parameter, ...]] = {"node": (), "joint": ()}
    with Path(__file__).with_name("parameters.csv").open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            parameter = Parameter(
                row["name"],
                _default(row["default"]),
                row["unit"],
                row["meaning"],
                float(row["low"] or -math.inf),
                float(row["high"] or math.inf),
                tuple(row["choices"].split()),
                row["scale"] or "",
            )
            found[row["owner"]] += (parameter,)
    return found


def _default(text: str) -> Value:
    """A default, with its type: JSON, or else a text."""
    with contextlib.suppress(ValueError):
        value: Value = json.loads(text)
        return value
    return text


NODE_PARAMETERS, JOINT_PARAMETERS = _tables().values()

LIMITS = tuple(p.name.split(".")[1] for p in JOINT_PARAMETERS if re.fullmatch(r"limits\.\w+\.warn", p.name))
"""Quantities with thresholds ``limits.<quantity>.warn`` and ``.error``."""

SIGNALS = ("input", "output_signal.", "torque_signal.", "temperature_signal.")
"""Prefixes of the parameters that locate a joint's signals."""

ROS_PARAMETERS = ("use_sim_time", "start_type_description_service", "qos_overrides")
"""Parameters that every ROS node has; a parameter file may hold them, but a configuration does not."""


def parameters(joints: Sequence[str]) -> dict[str, Parameter]:
    """Every parameter by its full ROS name: the node's, then each joint's with its name before them."""
    known = {parameter.name: parameter for parameter in NODE_PARAMETERS}
    for joint in joints:
        known |= {f"{joint}.{parameter.name}": parameter for parameter in JOINT_PARAMETERS}
    return known


def of_joint(flat: Mapping[str, Value], joint: str) -> dict[str, Value]:
    """Parameters of a joint by their names within it."""
    return {p.name: flat[f"{joint}.{p.name}"] for p in JOINT_PARAMETERS}


def flatten(section: Mapping[Any, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Full parameter names and values of a nested mapping."""
    for key, value in section.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            yield from flatten(value, f"{name}.")
        else:
            yield name, value


def nested(flat: Mapping[str, Value]) -> dict[str, Any]:
    """The nested mapping of a parameter file from full names."""
    tree: dict[str, Any] = {}
    for name, value in flat.items():
        *path, leaf = name.split(".")
        branch = tree
        for key in path:
            branch = branch.setdefault(key, {})
        branch[leaf] = value
    return tree


def check_known(
    names: Iterable[str], known: Iterable[str], what: str = "unknown parameter", hint: str = ""
) -> None:
    """Raise ConfigError naming the first unknown name, and the nearest known one if one is near."""
    for name in names:
        if name not in known:
            near = nearest(str(name), known)
            told = f"; the nearest known is '{near}'" if near else ", and none that is known is like it"
            raise ConfigError(f"{what} {shown(name)}{told}{hint}")


def joint_names(value: Any) -> list[str]:
    """The names of the joints; raises ConfigError saying what was expected."""
    if not isinstance(value, (list, tuple)) or not value or not all(isinstance(name, str) for name in value):
        raise ConfigError(f"joints: expected a list of names, not {shown(value)}")
    names = list(value)
    if len(names) > _MOST_JOINTS:
        raise ConfigError(f"joints: {len(names)} are more than the {_MOST_JOINTS} that one node watches")
    taken = {parameter.name.split(".")[0] for parameter in NODE_PARAMETERS} | set(ROS_PARAMETERS)
    for name in names:
        if not (name.isascii() and name.isidentifier()) or name in taken:
            raise ConfigError(
                f"joints: {shown(name)} cannot name a joint (letters, digits and _; not a parameter's name)"
            )
    if len(set(names)) != len(names):
        raise ConfigError(f"joints: a name appears twice in {shown(names)}")
    return names


def checked(name: str, value: Any, parameter: Parameter) -> Value:
    """The value in the parameter's own type; a real parameter accepts a whole number.

    Raises ConfigError with the full name, the expected value and its unit.
    """
    default, choices = parameter.default, parameter.choices
    if isinstance(default, list):
        return joint_names(value) if name == "joints" else _numbers(name, value, parameter)
    if not isinstance(default, (bool, str)):
        value = _number(name, value, parameter)
    if type(value) is not type(default) or (choices and str(value) not in choices):
        wanted = "one of " + ", ".join(choices) if choices else _WORDS[type(default)]
        raise ConfigError(f"{name}: expected {wanted}, not {shown(value)}")
    return value


def shown(value: Any) -> str:
    """A value as an error message shows it: one line, cut if long."""
    try:
        text = ascii(value)
    except (ValueError, RecursionError):  # a number of thousands of digits; lists nested too deep
        text = f"a {type(value).__name__} too long to print"
    return text if len(text) <= _LONGEST_TEXT else f"{text[: _LONGEST_TEXT - 3]}..."


def _unit(parameter: Parameter) -> str:
    return f" [{parameter.unit}]" if parameter.unit else ""


def _numbers(name: str, value: Any, parameter: Parameter) -> list[float]:
    """A list of numbers: a pair if the default is one, otherwise of any length except zero."""
    is_pair, is_list = len(parameter.default) == 2, isinstance(value, (list, tuple))
    if not is_list or (is_pair and len(value) != 2) or not value:
        wanted = f"two numbers [x, y]{_unit(parameter)}" if is_pair else "a list of numbers"
        raise ConfigError(f"{name}: expected {wanted}, not {len(value) if is_list else shown(value)}")
    return [float(_number(name, number, parameter)) for number in value]


def _number(name: str, value: Any, parameter: Parameter) -> int | float:
    whole = isinstance(parameter.default, int)
    kind = f"{'a whole number' if whole else 'a number'}{_unit(parameter)}"
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ConfigError(f"{name}: expected {kind}, not {shown(value)}")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number) or (whole and value != int(value)):
        raise ConfigError(f"{name}: expected {kind}, not {shown(value)}")
    if not parameter.low <= value <= parameter.high:
        raise ConfigError(
            f"{name}: expected {kind} from {parameter.low:g} to {parameter.high:g}, not {shown(value)}"
        )
    return int(value) if whole else number

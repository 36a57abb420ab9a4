"""The parameters of a configuration: parameters.md."""

from __future__ import annotations

import math
from typing import Any

from hd_diag.config.parameters import JOINT_PARAMETERS, NODE_PARAMETERS, Parameter
from parts import plain, table


def parameters() -> str:
    """A table for each kind of parameter."""
    drive = [p for p in JOINT_PARAMETERS if not p.name.startswith(("gear.", "limits.", "tolerance."))]
    tables = {
        "Of the node": NODE_PARAMETERS,
        "Of a joint: the drive": drive,
        "Of a joint: its catalogue page": _of("gear."),
        "Of a joint: limits of the diagnostics": _of("limits."),
        "Of a joint: `hd-diag tolerance`": _of("tolerance."),
    }
    titles = ["name", "default", "from, to", "meaning"]
    return "\n\n".join(f"## {name}\n\n{table(titles, [*map(_row, own)])}" for name, own in tables.items())


def _of(prefix: str) -> list[Parameter]:
    return [parameter for parameter in JOINT_PARAMETERS if parameter.name.startswith(prefix)]


def _row(parameter: Parameter) -> list[str]:
    scale = f"; goes with {parameter.scale}" if parameter.scale else ""
    meaning = f"{plain(parameter.meaning)}{scale}"
    return [f"`{parameter.name}`", plain(default(parameter)), plain(allowed(parameter)), meaning]


def default(parameter: Parameter) -> str:
    """Default value as written in a parameter file, with its unit."""
    unit = "" if parameter.unit == "-" else parameter.unit
    return f"{_written(parameter.default)} {unit}".rstrip()


def _written(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return f"[{', '.join(map(str, value))}]"
    return f"{value:g}" if isinstance(value, float) else str(value) or "``''``"


def allowed(parameter: Parameter) -> str:
    """Allowed values: the choices, or the range if it is finite."""
    if parameter.choices:
        return ", ".join(parameter.choices)
    if not math.isfinite(parameter.low):
        return ""
    return f"{parameter.low:g} to {parameter.high:g}"

"""Every parameter of a configuration (name, type, unit, meaning, range) and the check of a single value."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

Value = bool | int | float | str | list[float] | list[str]


class ConfigError(ValueError):
    """A configuration that cannot be used; the text names the parameter, the value and what was expected."""


@dataclass(frozen=True)
class Parameter:
    """One parameter: name within its owner, default (whose type it has), unit, meaning, range."""

    name: str
    default: Value
    unit: str
    meaning: str
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()


_MOST_JOINTS = 256
_LONGEST_TEXT = 80  # of a name or value that an error names

MAGNITUDES = ("fixed", "uniform", "normal", "rayleigh")
"""Distributions of a quantity that cannot be negative."""

DEVIATIONS = ("fixed", "uniform", "normal", "triangular")
"""Distributions of a quantity that deviates to both sides."""


def _length(name: str, default: float, meaning: str, high: float) -> Parameter:
    return Parameter(name, default, "m", meaning, 1e-12, high)


def _point(name: str, default: list[float], meaning: str) -> Parameter:
    return Parameter(name, default, "m", meaning, -1.0, 1.0)


def _limit(
    name: str, warn: float, error: float, unit: str, meaning: str, low: float, high: float
) -> tuple[Parameter, Parameter]:
    """Thresholds of a quantity of the diagnostics."""
    return (
        Parameter(f"limits.{name}.warn", warn, unit, meaning, low, high),
        Parameter(f"limits.{name}.error", error, unit, "the same, error", low, high),
    )


def _scatter(
    name: str, distribution: str, size: float, unit: str, meaning: str, choices: tuple[str, ...], high: float
) -> tuple[Parameter, Parameter]:
    """Distribution of a quantity over many assemblies."""
    relative = "scale of it, relative" if unit == "-" else "scale of it"
    return (
        Parameter(f"tolerance.{name}.distribution", distribution, "", meaning, choices=choices),
        Parameter(f"tolerance.{name}.size", size, unit, relative, 0.0, high),
    )


_LIMITS = (
    *_limit("overlap", 0.0, 20e-6, "m", "lobes press against each other at zero torque", -1.0, 1.0),
    *_limit("peak_tooth_load", 100.0, 200.0, "N", "largest force on a flank", 0.0, 1e9),
    *_limit("load_concentration", 3.0, 5.0, "-", "largest over mean force of the loaded flanks", 1.0, 1e6),
    *_limit("residual_rms", 1.5e-4, 5e-4, "rad", "measured less predicted error, mean removed", 0.0, 10.0),
    *_limit(
        *("residual_order", 5.0e-5, 2.0e-4, "rad"),
        *("amplitude of an order of the residual to an extended model", 0.0, 10.0),
    ),
    *_limit("torque", 2.0, 3.5, "-", "torque over rated torque", 0.0, 1e6),
    *_limit("silence", 0.5, 2.0, "s", "time without a valid sample", 0.0, 1e6),
    *_limit("rejected", 0.0, 0.5, "-", "share of samples rejected since the last report", 0.0, 1.0),
)

LIMITS = tuple(limit.name.split(".")[1] for limit in _LIMITS[::2])
"""Quantities with thresholds ``limits.<quantity>.warn`` and ``.error``."""

JOINT_PARAMETERS: tuple[Parameter, ...] = (
    Parameter(
        "input_joint", "", "", "name in JointState with the input (wave generator) angle; '' = <joint>_motor"
    ),
    Parameter("output_joint", "", "", "name in JointState with the output angle and effort; '' = <joint>"),
    Parameter("ratio", 100.0, "-", "reported input angle over reported output angle, signed", -1e3, 1e3),
    Parameter(
        "output", "flexspline", "", "member that drives the link", choices=("flexspline", "circular_spline")
    ),
    Parameter("rated_torque", 56.0, "N m", "rated torque", 1e-3, 1e5),
    Parameter("torque", 0.0, "N m", "torque assumed where no effort is reported", -1e6, 1e6),
    Parameter("flexspline_teeth", 200, "-", "teeth of the flexspline", 20, 2000),
    Parameter("circular_spline_teeth", 202, "-", "teeth of the circular spline", 22, 2010),
    _length("neutral_curve.semi_major", 30.2584e-3, "long semi-axis of the neutral layer", 10.0),
    _length("neutral_curve.semi_minor", 29.7404e-3, "short semi-axis of the neutral layer", 10.0),
    _length("flexspline_tooth.addendum_radius", 0.2031e-3, "convex arc of the tooth", 1.0),
    _length("flexspline_tooth.dedendum_radius", 0.5046e-3, "hollow arc of the tooth", 1.0),
    _point("flexspline_tooth.addendum_center", [0.7625e-3, -0.0548e-3], "centre of the convex arc"),
    _point("flexspline_tooth.dedendum_center", [0.6929e-3, 0.6557e-3], "centre of the hollow arc"),
    Parameter("flexspline_tooth.root", 0.4e-3, "m", "start of the flank above the neutral layer", 0.0, 1.0),
    Parameter("flexspline_tooth.tip", 0.8519e-3, "m", "end of the flank above the neutral layer", 0.0, 1.0),
    _length("circular_spline_slot.addendum_radius", 0.2313e-3, "hollow arc of the slot", 1.0),
    _length("circular_spline_slot.dedendum_radius", 0.4357e-3, "convex arc of the slot", 1.0),
    _point("circular_spline_slot.addendum_center", [1.2201e-3, -0.0782e-3], "centre of the hollow arc"),
    _point("circular_spline_slot.dedendum_center", [1.2791e-3, 0.5886e-3], "centre of the convex arc"),
    _length("circular_spline_datum", 29.868e-3, "radius from which the slot's x is measured", 10.0),
    _length("circular_spline_tip_radius", 30.7755e-3, "tip radius of the circular spline", 10.0),
    Parameter("tooth_compliance", 1.0e-6, "m/N", "K1 + K2 of a tooth pair", 1e-12, 1.0),
    Parameter("cup_compliance", 0.0, "rad/(N m)", "torsion of the cup beyond the teeth's", 0.0, 1.0),
    Parameter("arc_offset", 0.0, "m", "shift of the teeth along the neutral curve", -1e-2, 1e-2),
    Parameter(
        "eccentricity.magnitude", 0.0, "m", "wave generator's centre from the housing's axis", 0.0, 1e-3
    ),
    Parameter("eccentricity.direction", 0.0, "rad", "its direction in the housing"),
    Parameter(
        "runout.magnitude", 0.0, "m", "part of the displacement that turns with the wave generator", 0.0, 1e-3
    ),
    Parameter("runout.direction", 0.0, "rad", "its direction when the long axis is at angle zero"),
    Parameter("wave_generator_phase", 0.0, "rad", "angle of the long axis at input angle zero"),
    Parameter("model_file", "", "", "extended model written by 'hd-diag diagnose'; '' = none"),
    *_LIMITS,
    Parameter(
        "tolerance.limits.interference", 2.0e-6, "m", "overlap of teeth and slots at one lobe", 0.0, 1e-3
    ),
    Parameter(
        "tolerance.limits.overlap", 20e-6, "m", "lobes press against each other at zero torque", -1e-3, 1e-3
    ),
    Parameter("tolerance.limits.peak_tooth_load", 60.0, "N", "largest force on a flank", 0.0, 1e9),
    Parameter("tolerance.limits.load_concentration", 2.0, "-", "largest over mean force", 1.0, 1e6),
    Parameter("tolerance.limits.stiffness_loss", 0.1, "-", "torsional stiffness lost", 0.0, 1.0),
    Parameter(
        "tolerance.limits.transmission_error",
        1.45e-4,
        "rad",
        "peak to peak over a turn of the wave generator",
        0.0,
        1.0,
    ),
    *_scatter("eccentricity", "rayleigh", 3.5e-6, "m", "of its magnitude", MAGNITUDES, 1e-3),
    *_scatter("runout", "rayleigh", 0.75e-6, "m", "of its magnitude", MAGNITUDES, 1e-3),
    *_scatter("circular_spline_datum", "normal", 1.0e-6, "m", "of the deviation", DEVIATIONS, 1e-3),
    *_scatter("pitch", "normal", 0.6e-6, "m", "of each tooth pair's place", DEVIATIONS, 1e-3),
    *_scatter("tooth_compliance", "normal", 0.05, "-", "of the deviation", DEVIATIONS, 0.2),
    *_scatter("cup_compliance", "normal", 5.0e-7, "rad/(N m)", "of what is added", MAGNITUDES, 1.0),
)

NODE_PARAMETERS: tuple[Parameter, ...] = (
    Parameter("joints", ["joint_1"], "", "joints to watch"),
    Parameter("array_rate", 20.0, "Hz", "per-tooth arrays; 0 = off", 0.0, 1000.0),
    Parameter("mesh_rate", 0.0, "Hz", "drawings of the gear; 0 = off", 0.0, 60.0),
    Parameter("diagnostics_rate", 1.0, "Hz", "diagnostics", 0.01, 100.0),
    Parameter("log.path", "", "", "MCAP file (*.mcap) or rosbag2 folder; '' = no log"),
    Parameter(
        "log.compression", "zstd", "", "compression of the log's chunks", choices=("none", "lz4", "zstd")
    ),
    Parameter("log.flush_period", 0.25, "s", "what a killed process can lose of the log", 0.01, 0.9),
    Parameter("log.split_size", 0, "byte", "start a new file at this size; 0 = never", 0, 2**53),
    Parameter("log.split_duration", 0.0, "s", "start a new file after this time; 0 = never", 0.0, 1e9),
    Parameter("log.overwrite", False, "", "replace a log that exists"),
)

ROS_PARAMETERS = ("use_sim_time", "start_type_description_service", "qos_overrides")
"""Parameters that every ROS node has: a parameter file may hold them, they are no part of a configuration."""


def parameters(joints: Sequence[str]) -> dict[str, Parameter]:
    """Every parameter by its full ROS name.

    Parameters
    ----------
    joints : sequence of str
        Names of the joints.

    Returns
    -------
    dict
        Node parameters, then those of each joint with its name before them.
    """
    known = {parameter.name: parameter for parameter in NODE_PARAMETERS}
    for joint in joints:
        known |= {f"{joint}.{parameter.name}": parameter for parameter in JOINT_PARAMETERS}
    return known


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


def check_known(names: Sequence[str], known: Mapping[str, Parameter]) -> None:
    """Refuse names that are not known.

    Raises
    ------
    ConfigError
        Naming the first unknown one and the nearest known.
    """
    for name in names:
        if name not in known:
            near = difflib.get_close_matches(name[:_LONGEST_TEXT], known, n=1, cutoff=0.0)
            raise ConfigError(f"unknown parameter {shown(name)}; the nearest known is '{near[0]}'")


def joint_names(value: Any) -> list[str]:
    """The names of the joints, checked.

    Raises
    ------
    ConfigError
        Saying what was expected.
    """
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
        raise ConfigError(f"joints: a name stands twice in {shown(names)}")
    return names


def checked(name: str, value: Any, parameter: Parameter) -> Value:
    """The value in the parameter's own type.

    Parameters
    ----------
    name : str
        Full name, for the error.
    value
        As given; a whole number for a real one is fine.
    parameter : Parameter

    Raises
    ------
    ConfigError
        Saying what was expected, in which unit.
    """
    default = parameter.default
    if isinstance(default, bool):
        if not isinstance(value, bool):
            raise ConfigError(f"{name}: expected true or false, not {shown(value)}")
        return value
    if isinstance(default, str):
        if not isinstance(value, str) or (parameter.choices and value not in parameter.choices):
            wanted = "one of " + ", ".join(parameter.choices) if parameter.choices else "a text"
            raise ConfigError(f"{name}: expected {wanted}, not {shown(value)}")
        return value
    if isinstance(default, list):
        return joint_names(value) if name == "joints" else _pair(name, value, parameter)
    return _number(name, value, parameter)


def shown(value: Any) -> str:
    """A value as an error tells it: one line, cut off where it is long."""
    try:
        text = ascii(value)
    except (ValueError, RecursionError):  # a number of thousands of digits; lists in lists in lists
        text = f"a {type(value).__name__} too long to print"
    return text if len(text) <= _LONGEST_TEXT else f"{text[: _LONGEST_TEXT - 3]}..."


def _unit(parameter: Parameter) -> str:
    return f" [{parameter.unit}]" if parameter.unit else ""


def _pair(name: str, value: Any, parameter: Parameter) -> list[float]:
    if not isinstance(value, (list, tuple)):
        raise ConfigError(f"{name}: expected two numbers [x, y]{_unit(parameter)}, not {shown(value)}")
    if len(value) != 2:
        raise ConfigError(f"{name}: expected two numbers [x, y]{_unit(parameter)}, not {len(value)}")
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

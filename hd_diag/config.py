"""Configuration: one flat set of ROS parameters, from a file, the command line or a running node, checked as a whole."""

from __future__ import annotations

import cmath
import difflib
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from hd_diag.drive import Drive
from hd_diag.model.geometry import Geometry
from hd_diag.model.tooth_profile import DoubleArc
from hd_diag.model.torsion import Mesh
from hd_diag.model.transmission_error import Kinematics

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


_INF = math.inf
_TINY = 1e-12  # [m]; lengths must exceed it

JOINT_PARAMETERS: tuple[Parameter, ...] = (
    Parameter("input_joint", "", "", "name in JointState with the input (wave generator) angle; '' = <joint>_motor"),
    Parameter("output_joint", "", "", "name in JointState with the output angle and effort; '' = <joint>"),
    Parameter("ratio", 100.0, "-", "reported input angle over reported output angle, signed", -1000.0, 1000.0),
    Parameter(
        "output", "flexspline", "", "member that drives the link", choices=("flexspline", "circular_spline")
    ),
    Parameter("rated_torque", 56.0, "N m", "rated torque", 1e-3, 1e5),
    Parameter("torque", 0.0, "N m", "torque assumed where no effort is reported", -1e6, 1e6),
    Parameter("flexspline_teeth", 200, "-", "teeth of the flexspline", 20, 2000),
    Parameter("circular_spline_teeth", 202, "-", "teeth of the circular spline", 22, 2010),
    Parameter("neutral_curve.semi_major", 30.2584e-3, "m", "long semi-axis of the neutral layer", _TINY, 10.0),
    Parameter("neutral_curve.semi_minor", 29.7404e-3, "m", "short semi-axis of the neutral layer", _TINY, 10.0),
    Parameter("flexspline_tooth.addendum_radius", 0.2031e-3, "m", "convex arc of the tooth", _TINY, 1.0),
    Parameter("flexspline_tooth.dedendum_radius", 0.5046e-3, "m", "hollow arc of the tooth", _TINY, 1.0),
    Parameter("flexspline_tooth.addendum_center", [0.7625e-3, -0.0548e-3], "m", "centre of the convex arc", -1.0, 1.0),
    Parameter("flexspline_tooth.dedendum_center", [0.6929e-3, 0.6557e-3], "m", "centre of the hollow arc", -1.0, 1.0),
    Parameter("flexspline_tooth.root", 0.4e-3, "m", "start of the flank above the neutral layer", 0.0, 1.0),
    Parameter("flexspline_tooth.tip", 0.8519e-3, "m", "end of the flank above the neutral layer", 0.0, 1.0),
    Parameter("circular_spline_slot.addendum_radius", 0.2313e-3, "m", "hollow arc of the slot", _TINY, 1.0),
    Parameter("circular_spline_slot.dedendum_radius", 0.4357e-3, "m", "convex arc of the slot", _TINY, 1.0),
    Parameter(
        "circular_spline_slot.addendum_center", [1.2201e-3, -0.0782e-3], "m", "centre of the hollow arc", -1.0, 1.0
    ),
    Parameter(
        "circular_spline_slot.dedendum_center", [1.2791e-3, 0.5886e-3], "m", "centre of the convex arc", -1.0, 1.0
    ),
    Parameter("circular_spline_datum", 29.868e-3, "m", "radius from which the slot's x is measured", _TINY, 10.0),
    Parameter("circular_spline_tip_radius", 30.7755e-3, "m", "tip radius of the circular spline", _TINY, 10.0),
    Parameter("tooth_compliance", 1.0e-6, "m/N", "K1 + K2 of a tooth pair", 1e-12, 1.0),
    Parameter("cup_compliance", 0.0, "rad/(N m)", "torsion of the cup beyond the teeth's", 0.0, 1.0),
    Parameter("arc_offset", 0.0, "m", "shift of the teeth along the neutral curve", -1e-2, 1e-2),
    Parameter("eccentricity.magnitude", 0.0, "m", "wave generator's centre from the housing's axis", 0.0, 1e-3),
    Parameter("eccentricity.direction", 0.0, "rad", "its direction in the housing"),
    Parameter("runout.magnitude", 0.0, "m", "part of the displacement that turns with the wave generator", 0.0, 1e-3),
    Parameter("runout.direction", 0.0, "rad", "its direction when the long axis is at angle zero"),
    Parameter("wave_generator_phase", 0.0, "rad", "angle of the long axis at input angle zero"),
    Parameter("model_file", "", "", "extended model written by 'hd-diag diagnose'; '' = none"),
    Parameter("limits.overlap.warn", 0.0, "m", "lobes press against each other at zero torque", -1.0, 1.0),
    Parameter("limits.overlap.error", 20e-6, "m", "the same, error", -1.0, 1.0),
    Parameter("limits.peak_tooth_load.warn", 100.0, "N", "largest force on a flank", 0.0, 1e9),
    Parameter("limits.peak_tooth_load.error", 200.0, "N", "the same, error", 0.0, 1e9),
    Parameter("limits.load_concentration.warn", 3.0, "-", "largest over mean force of the loaded flanks", 1.0, 1e6),
    Parameter("limits.load_concentration.error", 5.0, "-", "the same, error", 1.0, 1e6),
    Parameter("limits.residual_rms.warn", 1.5e-4, "rad", "measured less predicted error, mean removed", 0.0, 10.0),
    Parameter("limits.residual_rms.error", 5.0e-4, "rad", "the same, error", 0.0, 10.0),
    Parameter("limits.torque.warn", 2.0, "-", "torque over rated torque", 0.0, 1e6),
    Parameter("limits.torque.error", 3.5, "-", "the same, error", 0.0, 1e6),
    Parameter("limits.silence.warn", 0.5, "s", "time without a valid sample", 0.0, 1e6),
    Parameter("limits.silence.error", 2.0, "s", "the same, error", 0.0, 1e6),
    Parameter("limits.rejected.warn", 0.0, "-", "share of samples rejected since the last report", 0.0, 1.0),
    Parameter("limits.rejected.error", 0.5, "-", "the same, error", 0.0, 1.0),
)

NODE_PARAMETERS: tuple[Parameter, ...] = (
    Parameter("joints", ["joint_1"], "", "joints to watch"),
    Parameter("array_rate", 20.0, "Hz", "per-tooth arrays; 0 = off", 0.0, 1000.0),
    Parameter("mesh_rate", 0.0, "Hz", "drawings of the gear; 0 = off", 0.0, 60.0),
    Parameter("diagnostics_rate", 1.0, "Hz", "diagnostics", 0.01, 100.0),
    Parameter("log.path", "", "", "MCAP file (*.mcap) or rosbag2 folder; '' = no log"),
    Parameter("log.compression", "zstd", "", "compression of the log's chunks", choices=("none", "lz4", "zstd")),
    Parameter("log.flush_period", 0.25, "s", "what a killed process can lose of the log", 0.01, 0.9),
    Parameter("log.split_size", 0, "byte", "start a new file at this size; 0 = never", 0, 2**53),
    Parameter("log.split_duration", 0.0, "s", "start a new file after this time; 0 = never", 0.0, 1e9),
    Parameter("log.overwrite", False, "", "replace a log that exists"),
)

_LIMITS = ("overlap", "peak_tooth_load", "load_concentration", "residual_rms", "torque", "silence", "rejected")


@dataclass(frozen=True)
class Limit:
    """Thresholds of one quantity, in its unit."""

    warn: float
    error: float

    def level(self, value: float) -> int:
        """0, 1 (above warn) or 2 (above error), as in diagnostic_msgs/DiagnosticStatus; nan is 0."""
        return 2 if value > self.error else 1 if value > self.warn else 0


@dataclass(frozen=True)
class JointConfig:
    """One joint: the names it has in JointState, its drive, assumed torque [N m] and limits."""

    name: str
    input_joint: str
    output_joint: str
    drive: Drive
    torque: float
    limits: Mapping[str, Limit]
    model_file: str = ""


@dataclass(frozen=True)
class LogConfig:
    """Where and how the node writes its log."""

    path: str = ""
    compression: str = "zstd"
    flush_period: float = 0.25
    split_size: int = 0
    split_duration: float = 0.0
    overwrite: bool = False


@dataclass(frozen=True)
class Config:
    """A whole configuration; `flat` holds every parameter by its full ROS name."""

    joints: tuple[JointConfig, ...]
    array_rate: float
    mesh_rate: float
    diagnostics_rate: float
    log: LogConfig
    flat: Mapping[str, Value] = field(repr=False)


def parameters(joints: list[str]) -> dict[str, Parameter]:
    """Every parameter by its full ROS name.

    Parameters
    ----------
    joints : list of str
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


def resolve(given: Mapping[str, Any]) -> Config:
    """Configuration from flat parameters, defaults filled in, everything checked.

    Parameters
    ----------
    given : mapping
        Full ROS parameter names to values, e.g. ``joint_1.eccentricity.magnitude``.

    Returns
    -------
    Config

    Raises
    ------
    ConfigError
        Naming the first parameter that cannot be, its value and what was expected; for an unknown one, the
        nearest known.
    """
    joints = _joint_names(given.get("joints", ["joint_1"]))
    known = parameters(joints)
    for name in given:
        if name not in known:
            raise ConfigError(_unknown(name, known))
    flat = {name: _checked(name, given.get(name, p.default), p) for name, p in known.items()}
    flat["joints"] = joints
    configured = tuple(_joint(name, flat) for name in joints)
    _check_names(configured)
    log = LogConfig(**{p.name[4:]: flat[p.name] for p in NODE_PARAMETERS if p.name.startswith("log.")})  # type: ignore[arg-type]
    return Config(
        configured, _float(flat, "array_rate"), _float(flat, "mesh_rate"), _float(flat, "diagnostics_rate"), log, flat
    )


def load(path: str | Path) -> Config:
    """Configuration from a ROS parameter file.

    Parameters
    ----------
    path : path
        YAML: ``hd_diag: ros__parameters: ...``; a node name with namespace, and ``/**``, are taken too.

    Returns
    -------
    Config

    Raises
    ------
    ConfigError
        Naming the file and what is wrong with it.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from error
    try:
        document = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise ConfigError(f"{path}: not YAML: {' '.join(str(error).split())}") from error
    try:
        return resolve(dict(flatten(_node_section(document))))
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error


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


def dump(config: Config) -> str:
    """A configuration as the text of a ROS parameter file."""
    document = {"hd_diag": {"ros__parameters": nested(config.flat)}}
    text: str = yaml.safe_dump(document, sort_keys=False)
    return text


def _node_section(document: Any) -> Mapping[Any, Any]:
    expected = "expected 'hd_diag: ros__parameters: ...' at the top"
    if not isinstance(document, Mapping):
        raise ConfigError(expected)
    merged: dict[Any, Any] = {}
    found = False
    for name, section in document.items():
        if str(name).rsplit("/", 1)[-1] not in ("hd_diag", "**", "*"):
            continue
        if not isinstance(section, Mapping) or not isinstance(section.get("ros__parameters"), Mapping):
            raise ConfigError(f"'{name}' holds no 'ros__parameters'")
        merged |= section["ros__parameters"]
        found = True
    if not found:
        raise ConfigError(expected)
    return merged


def _joint_names(value: Any) -> list[str]:
    if not isinstance(value, (list, tuple)) or not value or not all(isinstance(name, str) for name in value):
        raise ConfigError(f"joints: expected a list of names, not {value!r}")
    names = list(value)
    for name in names:
        if not name.isidentifier() or name in {p.name.split(".")[0] for p in NODE_PARAMETERS}:
            raise ConfigError(f"joints: {name!r} cannot name a joint (letters, digits and _; not a parameter's name)")
    if len(set(names)) != len(names):
        raise ConfigError(f"joints: a name stands twice in {names}")
    return names


def _unknown(name: str, known: Mapping[str, Parameter]) -> str:
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.0)
    return f"unknown parameter '{name}'; the nearest known is '{near[0]}'"


def _checked(name: str, value: Any, parameter: Parameter) -> Value:
    """The value in the parameter's own type, or a ConfigError that says what was expected."""
    unit = f" [{parameter.unit}]" if parameter.unit else ""
    default = parameter.default
    if isinstance(default, bool):
        if not isinstance(value, bool):
            raise ConfigError(f"{name}: expected true or false, not {value!r}")
        return value
    if isinstance(default, str):
        if not isinstance(value, str) or (parameter.choices and value not in parameter.choices):
            wanted = "one of " + ", ".join(parameter.choices) if parameter.choices else "a text"
            raise ConfigError(f"{name}: expected {wanted}, not {value!r}")
        return value
    if isinstance(default, list):
        return value if name == "joints" else _pair(name, value, parameter, unit)
    return _number(name, value, parameter, unit)


def _pair(name: str, value: Any, parameter: Parameter, unit: str) -> list[float]:
    if not isinstance(value, (list, tuple)) and not hasattr(value, "tolist"):
        raise ConfigError(f"{name}: expected [x, y]{unit}, not {value!r}")
    values = list(value)
    if len(values) != 2:
        raise ConfigError(f"{name}: expected two numbers [x, y]{unit}, not {len(values)}")
    return [float(_number(name, number, parameter, unit)) for number in values]


def _number(name: str, value: Any, parameter: Parameter, unit: str) -> int | float:
    whole = isinstance(parameter.default, int)
    kind = "a whole number" if whole else "a number"
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ConfigError(f"{name}: expected {kind}{unit}, not {value!r}")
    if not math.isfinite(value) or (whole and value != int(value)):
        raise ConfigError(f"{name}: expected {kind}{unit}, not {value!r}")
    if not parameter.low <= value <= parameter.high:
        raise ConfigError(f"{name}: {value!r}{unit} is outside {parameter.low:g} to {parameter.high:g}")
    return int(value) if whole else float(value)


def _float(flat: Mapping[str, Value], name: str) -> float:
    value = flat[name]
    assert isinstance(value, (int, float))
    return float(value)


def _joint(name: str, flat: Mapping[str, Value]) -> JointConfig:
    own = {p.name: flat[f"{name}.{p.name}"] for p in JOINT_PARAMETERS}
    limits = {key: Limit(_float(own, f"limits.{key}.warn"), _float(own, f"limits.{key}.error")) for key in _LIMITS}
    for key, limit in limits.items():
        if limit.error < limit.warn:
            raise ConfigError(f"{name}.limits.{key}: error ({limit.error:g}) must not be below warn ({limit.warn:g})")
    try:
        drive = _drive(own)
    except ValueError as error:
        raise ConfigError(f"{name}: {error}") from error
    if own["model_file"]:
        raise ConfigError(f"{name}.model_file: {own['model_file']!r} is not an extended model of this version")
    return JointConfig(
        name,
        str(own["input_joint"]) or f"{name}_motor",
        str(own["output_joint"]) or name,
        drive,
        _float(own, "torque"),
        limits,
        str(own["model_file"]),
    )


def _drive(own: Mapping[str, Value]) -> Drive:
    geometry = Geometry(
        int(_float(own, "flexspline_teeth")),
        int(_float(own, "circular_spline_teeth")),
        _float(own, "neutral_curve.semi_major"),
        _float(own, "neutral_curve.semi_minor"),
        _arcs(own, "flexspline_tooth"),
        _float(own, "flexspline_tooth.root"),
        _float(own, "flexspline_tooth.tip"),
        _arcs(own, "circular_spline_slot"),
        _float(own, "circular_spline_datum"),
        _float(own, "circular_spline_tip_radius"),
    )
    mesh = Mesh(
        geometry,
        _float(own, "tooth_compliance"),
        _polar(own, "eccentricity"),
        _polar(own, "runout"),
        _float(own, "arc_offset"),
    )
    output = "flexspline" if own["output"] == "flexspline" else "circular_spline"
    kinematics = Kinematics(_float(own, "ratio"), output, _float(own, "wave_generator_phase"))  # type: ignore[arg-type]
    return Drive(mesh, kinematics, _float(own, "rated_torque"), _float(own, "cup_compliance"))


def _arcs(own: Mapping[str, Value], name: str) -> DoubleArc:
    outer, inner = own[f"{name}.addendum_center"], own[f"{name}.dedendum_center"]
    assert isinstance(outer, list) and isinstance(inner, list)
    return DoubleArc(
        _float(own, f"{name}.addendum_radius"),
        _float(own, f"{name}.dedendum_radius"),
        (float(outer[0]), float(outer[1])),
        (float(inner[0]), float(inner[1])),
    )


def _polar(own: Mapping[str, Value], name: str) -> complex:
    return cmath.rect(_float(own, f"{name}.magnitude"), _float(own, f"{name}.direction"))


def _check_names(joints: tuple[JointConfig, ...]) -> None:
    taken: dict[str, str] = {}
    for joint in joints:
        for role, name in (("input_joint", joint.input_joint), ("output_joint", joint.output_joint)):
            if name in taken:
                raise ConfigError(f"{joint.name}.{role}: {name!r} is already {taken[name]}")
            taken[name] = f"{joint.name}.{role}"

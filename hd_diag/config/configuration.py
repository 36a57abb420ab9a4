"""Configuration: one flat set of ROS parameters from file, command line or node, checked as a whole."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hd_diag.config import parameter_file
from hd_diag.config.configured_drive import drive_from
from hd_diag.config.configured_signals import signals_from, spelled_out
from hd_diag.config.defaults import joint_values
from hd_diag.config.json_shape import reader
from hd_diag.config.parameters import (
    JOINT_PARAMETERS,
    LIMITS,
    NODE_PARAMETERS,
    ConfigError,
    ContentError,
    Value,
    check_known,
    checked,
    joint_names,
    of_joint,
    parameters,
    shown,
)
from hd_diag.monitor.settings import JointConfig, Limit, MonitorConfig
from hd_diag.streams.signals import JointSignals

if TYPE_CHECKING:
    from hd_diag.effects import Catalogue
    from hd_diag.extended_model import ExtendedModel

__all__ = ["Config", "ConfigError", "JointConfig", "LogConfig", "ModelText", "dump", "load", "resolve"]

_MOST_TEETH = 640  # ratio 320; the map of a drive takes 240 MB then
# Time of a core per joint, and per tooth, for its arrays and its drawing [s]; share of a core for either [-].
_ARRAYS_TIME, _DRAWING_TIME = (1.5e-4, 5e-7), (6e-4, 2.2e-6)
_MOST_TIME = 0.5

ModelText = Callable[[str, str], str]
"""Gives the text of a joint's model file from the joint's name and the path; raises ConfigError."""


@dataclass(frozen=True)
class LogConfig:
    """Where and how the node writes its log."""

    path: str = ""
    compression: str = "zstd"
    flush_period: float = 0.25
    sync_period: float = 5.0
    split_size: int = 0
    split_duration: float = 0.0
    overwrite: bool = False
    max_size: int = 0
    max_age: float = 0.0
    topics: str = "all"
    mode: str = "continuous"
    before: float = 300.0
    after: float = 10.0
    memory: int = 100_000_000


@dataclass(frozen=True)
class Config(MonitorConfig):
    """A whole configuration.

    `flat` holds every parameter by its full ROS name. `given` holds only those that do not follow from
    others; a configuration with other values is resolved from these.
    """

    diagnostics_rate: float
    log: LogConfig
    flat: Mapping[str, Value] = field(repr=False)
    given: Mapping[str, Value] = field(repr=False, compare=False)

    @property
    def diagnose_on_fault(self) -> bool:
        """Whether the node diagnoses by itself when a fault begins."""
        return bool(self.flat["diagnose.on_fault"])

    @property
    def diagnose_every(self) -> float:
        """Time of motion after which the node diagnoses by itself [s]; 0 for never."""
        return float(self.flat["diagnose.every"])


def resolve(
    given: Mapping[str, Any],
    model_text: ModelText | None = None,
    catalogue: Catalogue | None = None,
    teeth: bool = True,
) -> Config:
    """Configuration from flat parameters; fills in the others and checks everything.

    Parameters are given by their full ROS names, e.g. ``joint_1.eccentricity.magnitude``. Others come from a
    joint's catalogue page, scale with its drive or have their defaults: :mod:`hd_diag.config.defaults`.
    `model_text` gives the texts of model files, by default from disk, relative to the current folder. They
    may hold the effects of `catalogue`, by default the package's and installed ones. Without `teeth` a ratio
    need not match the teeth, for uses that do not depend on them.

    Raises ConfigError naming the first invalid parameter, its value and what was expected; for an unknown
    one, the nearest known.
    """
    flat, kept, joints = _completed(given, teeth)
    configured = tuple(_joint(name, flat, model_text, catalogue, teeth) for name in joints)
    _check_names(configured)
    array_rate, mesh_rate = flat["array_rate"], flat["mesh_rate"]
    _check_rates(configured, array_rate, mesh_rate)
    log = LogConfig(**{p.name[4:]: flat[p.name] for p in NODE_PARAMETERS if p.name.startswith("log.")})
    return Config(configured, array_rate, mesh_rate, flat["diagnostics_rate"], log, flat, kept)


def recorded_signals(given: Mapping[str, Any]) -> dict[str, JointSignals]:
    """Signals of each joint of flat parameters; raises ConfigError as `resolve` does."""
    flat, _, joints = _completed({**given, "joints": given.get("joints")}, True)
    return {name: signals_from(name, of_joint(flat, name)) for name in joints}


def load(path: str | Path, catalogue: Catalogue | None = None, teeth: bool = True) -> Config:
    """Configuration from a ROS parameter file.

    Model files are searched beside it, then in the current folder. Raises ConfigError naming the file and
    what is wrong with it. See :func:`resolve` and :func:`hd_diag.config.parameter_file.read`.
    """
    try:
        return resolve(parameter_file.read(path), reader(Path(path).parent), catalogue, teeth)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error


def dump(config: Config) -> str:
    """A configuration as the text of a ROS parameter file."""
    return parameter_file.text(config.flat)


def _completed(given: Mapping[str, Any], teeth: bool) -> tuple[dict[str, Value], dict[str, Value], list[str]]:
    """Every parameter, each checked on its own; those that do not follow from others; names of the joints."""
    given = spelled_out(given)
    joints = joint_names(given.get("joints", ["joint_1"]))
    known = parameters(joints)
    check_known(list(given), known)
    found = {name: checked(name, given[name], p) for name, p in known.items() if name in given}
    flat: dict[str, Value] = {p.name: found.get(p.name, p.default) for p in NODE_PARAMETERS}
    flat["joints"] = joints
    kept = {name: value for name, value in found.items() if name in flat}
    for joint in joints:
        own = {p.name: found[full] for p in JOINT_PARAMETERS if (full := f"{joint}.{p.name}") in found}
        try:
            every, beside = joint_values(own, teeth)
        except ValueError as error:
            raise ConfigError(f"{joint}: {error}") from error
        flat |= {f"{joint}.{name}": copy(value) for name, value in every.items()}
        kept |= {f"{joint}.{name}": copy(value) for name, value in beside.items()}
    return flat, kept, joints


def _joint(
    name: str,
    flat: Mapping[str, Value],
    model_text: ModelText | None,
    catalogue: Catalogue | None,
    teeth: bool,
) -> JointConfig:
    own = of_joint(flat, name)
    limits = {key: Limit(own[f"limits.{key}.warn"], own[f"limits.{key}.error"]) for key in LIMITS}
    for key, limit in limits.items():
        if limit.error < limit.warn:
            raise ConfigError(
                f"{name}.limits.{key}: error ({limit.error:g}) must not be below warn ({limit.warn:g})"
            )
    drive = drive_from(own, teeth)
    model, text = _model(name, own, model_text, catalogue)
    return JointConfig(
        name,
        own["input_joint"] or f"{name}_motor",
        own["output_joint"] or name,
        model.drive if model else drive,
        own["torque"],
        limits,
        drive,
        own["model_file"],
        model,
        text,
        signals_from(name, own),
        own["input_divided"],
    )


def _model(
    name: str, own: Mapping[str, Value], model_text: ModelText | None, catalogue: Catalogue | None
) -> tuple[ExtendedModel | None, str]:
    """Extended model of a joint and the text of its file; None and an empty text if it has none."""
    path = own["model_file"]
    if not path:
        return None, ""
    from hd_diag.config.model_file import model_for  # loads all effects, and most joints have no model

    place = f"{name}.model_file: {path!a}"
    try:
        text = (model_text or reader())(name, path)
        return model_for(text, own, catalogue), text
    except ContentError as error:
        discreet = f"{place}: is not a model that can be used: `hd-diag check` says why"
        raise ContentError(f"{place}: {error}", discreet) from error
    except ConfigError as error:
        raise ConfigError(f"{place}: {error}") from error


def _check_rates(joints: tuple[JointConfig, ...], array_rate: float, mesh_rate: float) -> None:
    """Raise ConfigError if arrays or drawings would take more than their share of a core."""
    teeth = np.array([joint.drive.mesh.geometry.flexspline_teeth for joint in joints])
    if teeth.max() > _MOST_TEETH:
        name = joints[int(teeth.argmax())].name
        raise ConfigError(f"{name}.flexspline_teeth: {teeth.max()} are more than {_MOST_TEETH}")
    for name, rate, (fixed, each) in (
        ("array_rate", array_rate, _ARRAYS_TIME),
        ("mesh_rate", mesh_rate, _DRAWING_TIME),
    ):
        highest = _MOST_TIME / float(np.sum(fixed + each * teeth))
        if rate > highest:
            raise ConfigError(
                f"{name}: {rate:g} Hz is more than the node can keep up with; "
                f"with these joints and teeth it can be up to {highest:.3g} Hz"
            )


def _check_names(joints: tuple[JointConfig, ...]) -> None:
    taken: dict[str, str] = {}
    for joint in joints:
        roles = ("input_joint", joint.input_joint), ("output_joint", joint.output_joint)
        for (role, name), signal in zip(roles, joint.signals[:2], strict=True):
            if signal is not None:
                continue
            if name in taken:
                raise ConfigError(f"{joint.name}.{role}: {shown(name)} is already {taken[name]}")
            taken[name] = f"{joint.name}.{role}"

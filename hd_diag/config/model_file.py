"""Files of extended models (JSON): written by a diagnosis, read and checked before a joint uses one."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from hd_diag.config import json_shape
from hd_diag.config.catalogue import load
from hd_diag.config.configured_drive import drive_from
from hd_diag.config.json_shape import Number
from hd_diag.config.parameters import (
    JOINT_PARAMETERS,
    SIGNALS,
    ConfigError,
    ContentError,
    Value,
    check_known,
    checked,
    shown,
)
from hd_diag.effects import Catalogue
from hd_diag.effects.order_line import ORDER_LINE
from hd_diag.effects.remainders import REMAINDERS
from hd_diag.effects.scaling import of_drive
from hd_diag.extended_model import ExtendedModel, Range, Ranges, Term
from hd_diag.whole_file import whole_file

SCHEMA = "hd_diag/model/1"

REFITTED = (
    "circular_spline_datum",
    "tooth_compliance",
    "cup_compliance",
    "eccentricity.magnitude",
    "eccentricity.direction",
    "runout.magnitude",
    "runout.direction",
    "tilt.magnitude",
    "tilt.direction",
)
"""Parameters of a drive that a fit changes; all others must equal those that the model was fitted to."""

_MOST_EFFECTS = 64  # each takes 20 us per sample
_UNITS = {"torque": "N m", "speed": "rad/s", "temperature": "degC"}
_RANGE = {"low": Number(-1e9, 1e9), "high": Number(-1e9, 1e9), "unit?": object}
_QUANTITY = {"value": Number(), "std?": (Number(0.0), None), "unit?": object}
_SHAPE = {
    "schema": object,
    "version": str,
    "joint": str,
    "parameters": dict,
    "standard_deviations": dict,
    "base": {"sha256": object, "before_the_fit": dict},
    "offset": Number(-10.0, 10.0),  # [rad]
    "effects": [{"name": str, "parameters": {str: _QUANTITY}, "class?": object}],
    "valid_range": {"torque": _RANGE, "speed": _RANGE, "temperature": (_RANGE, None)},
    "evidence": dict,
}
_NOT_OF_THE_DRIVE = ("output_joint", "torque", "accuracy", "model_file")
_DRIVE = {
    p.name: p
    for p in JOINT_PARAMETERS
    if p.name not in _NOT_OF_THE_DRIVE and not p.name.startswith(("gear.", "limits.", "tolerance.", *SIGNALS))
}


_LATER = {name for name in _DRIVE if name.startswith(("face_", "cup_length", "sections", "tilt."))} | {
    name for name in _DRIVE if name.startswith("neutral_curve.") and "semi_" not in name
}
"""Parameters that files of older versions lack, because those drives are plane and on ellipses."""


@dataclass(frozen=True)
class ModelFile:
    """Content of a file: a model, the parameters of its drive after the fit, and (`base`) before it."""

    model: ExtendedModel
    parameters: Mapping[str, Value]
    base: Mapping[str, Value]


def drive_parameters(own: Mapping[str, Value]) -> dict[str, Value]:
    """Parameters of a joint that describe its drive."""
    return {name: own[name] for name in _DRIVE}


def base_hash(base: Mapping[str, Value]) -> str:
    """SHA-256 of the parameters of a drive, in hexadecimal digits."""
    return hashlib.sha256(json.dumps(base, sort_keys=True).encode()).hexdigest()


def model_for(text: str, own: Mapping[str, Value], catalogue: Catalogue | None = None) -> ExtendedModel:
    """Model from the text of a file, for a joint with parameters `own`, ready to run.

    The model may hold effects of a catalogue, by default the package's and installed ones. Raises ConfigError
    with one line on what is wrong, without the file's name.
    """
    found = parse(text, catalogue)
    for name, value in found.base.items():  # refitted parameters may have the value before or after the fit
        if own[name] != value and not (name in REFITTED and own[name] == found.parameters[name]):
            raise ConfigError(f"was fitted to a joint with another {name}; this one has {shown(own[name])}")
    _try(found.model)
    return found.model


def parse(text: str, catalogue: Catalogue | None = None) -> ModelFile:
    """Content of a file, checked; arguments and errors as for :func:`model_for`."""
    try:
        return _parsed(text, load() if catalogue is None else catalogue)
    except ConfigError as error:
        raise ContentError(str(error)) from error


@lru_cache(maxsize=64)
def _parsed(text: str, catalogue: Catalogue) -> ModelFile:
    content = json_shape.parse(text, _SHAPE)
    if len(content["effects"]) > _MOST_EFFECTS:
        raise ConfigError(
            f"effects: {len(content['effects'])} are more than the {_MOST_EFFECTS} that can run"
        )
    if content["schema"] != SCHEMA:
        raise ConfigError(f"schema is {shown(content['schema'])}, not '{SCHEMA}'")
    parameters = _parameters(content["parameters"])
    base = _base(content["base"], parameters, content["parameters"])
    try:
        drive = drive_from(parameters)
    except ValueError as error:
        raise ConfigError(f"parameters: {error}") from error
    known = of_drive((*catalogue, ORDER_LINE, *REMAINDERS), drive)
    terms = [_term(item, f"effects[{i}]", known) for i, item in enumerate(content["effects"])]
    once = [term.effect.name for term in terms if term.effect.name != ORDER_LINE.name]
    if len(set(once)) != len(once):
        raise ConfigError("effects: a name appears twice")
    ranges = Ranges(*(_range(name, content["valid_range"][name]) for name in _UNITS))  # type: ignore[arg-type]
    return ModelFile(ExtendedModel(drive, tuple(terms), float(content["offset"]), ranges), parameters, base)


def document(
    joint: str,
    configured: Mapping[str, Value],
    model: ExtendedModel,
    spreads: Mapping[str, float],
    effects: Sequence[tuple[Mapping[str, float], Sequence[str]]],
    evidence: Mapping[str, Any],
    version: str,
) -> dict[str, Any]:
    """Content of a file.

    `configured` are the joint's parameters when the model was fitted; `spreads` are standard deviations of
    the refitted ones. `effects` gives for every term of the model the standard deviations of its quantities
    (zero: not estimated) and its class: names that the record could not distinguish from it, itself first.
    `evidence` is the support of the model: bags, held-out figures.
    """
    base = drive_parameters(configured)
    refitted = base | _refitted(model)
    every = zip(model.effects, effects, strict=True)
    return {
        "schema": SCHEMA,
        "version": version,
        "joint": joint,
        "parameters": refitted,
        "standard_deviations": {name: spreads[name] for name in REFITTED if name in spreads},
        "base": {
            "sha256": base_hash(base),
            "before_the_fit": {name: value for name, value in base.items() if refitted[name] != value},
        },
        "offset": model.offset,
        "effects": [_effect(term, spread, alike) for term, (spread, alike) in every],
        "valid_range": {
            name: None if limits is None else {"low": limits.low, "high": limits.high, "unit": unit}
            for (name, unit), limits in zip(_UNITS.items(), model.ranges, strict=True)
        },
        "evidence": dict(evidence),
    }


def write(path: str | Path, content: Mapping[str, Any], catalogue: Catalogue | None = None) -> None:
    """Write a file, whole or not at all; raises ConfigError, also for content that `parse` refuses."""
    try:
        text = json.dumps(content, indent=1, allow_nan=False) + "\n"
        parse(text, catalogue)
        with whole_file(path) as place:
            place.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from error
    except ValueError as error:
        raise ConfigError(f"{path}: the model cannot be written: {error}") from error


def _refitted(model: ExtendedModel) -> dict[str, Value]:
    mesh = model.drive.mesh
    sizes = {"eccentricity": mesh.eccentricity, "runout": mesh.runout, "tilt": mesh.tilt}
    return {
        "circular_spline_datum": mesh.geometry.circular_spline_datum,
        "tooth_compliance": mesh.tooth_compliance,
        "cup_compliance": model.drive.cup_compliance,
        **{f"{name}.magnitude": float(abs(value)) for name, value in sizes.items()},
        **{f"{name}.direction": float(np.angle(value)) for name, value in sizes.items()},
    }


def _effect(term: Term, spread: Mapping[str, float], alike: Sequence[str]) -> dict[str, Any]:
    values = term.effect.to_physical(term.coefficients, term.nonlinear)
    return {
        "name": term.effect.name,
        "class": list(alike),
        "parameters": {
            name: {"value": value, "std": spread.get(name) or None, "unit": unit}
            for name, (value, unit) in values.items()
        },
    }


def _parameters(given: Mapping[str, Any]) -> dict[str, Value]:
    check_known(list(given), _DRIVE)
    missing = [name for name in _DRIVE if name not in given and name not in _LATER]
    if missing:
        raise ConfigError(f"parameters lack '{missing[0]}'")
    return {name: checked(name, given.get(name, known.default), known) for name, known in _DRIVE.items()}


def _base(
    found: Mapping[str, Any], parameters: Mapping[str, Value], given: Mapping[str, Any]
) -> dict[str, Value]:
    """Parameters before the fit: the model's, with changed values restored; the hash is of those given."""
    before = found["before_the_fit"]
    for name in before:
        if name not in REFITTED:
            raise ConfigError(f"base.before_the_fit: {shown(name)} is not a parameter that a fit changes")
    base = {**parameters, **{name: checked(name, one, _DRIVE[name]) for name, one in before.items()}}
    if found["sha256"] != base_hash({name: value for name, value in base.items() if name in given}):
        raise ConfigError("base.sha256 is not that of the parameters: the file was changed")
    return base


def _term(found: Mapping[str, Any], where: str, catalogue: Catalogue) -> Term:
    known = {effect.name: effect for effect in catalogue}
    check_known([found["name"]], known, f"{where}: unknown effect", "; your own must be given or installed")
    effect = known[found["name"]]
    if not effect.lasting:
        raise ConfigError(f"{where}: {effect.name} is an event of one record; a running model cannot hold it")
    where = f"{where} ({effect.name})"
    units = {quantity.name: quantity.unit for quantity in effect.quantities}
    for name, one in found["parameters"].items():
        check_known([name], units, f"{where} has an unknown quantity")
        if one.get("unit", units[name]) != units[name]:
            wrong = shown(one["unit"])
            raise ConfigError(f"{where}.{name}: expected the unit {shown(units[name])}, not {wrong}")
    try:
        values = {name: float(one["value"]) for name, one in found["parameters"].items()}
        coefficients, nonlinear = effect.from_physical(values)
    except ValueError as error:
        raise ConfigError(f"{where}: {error}") from error
    return Term(effect, tuple(coefficients.tolist()), nonlinear)


def _range(name: str, found: Mapping[str, float] | None) -> Range | None:
    if found is None:
        return None
    low, high = float(found["low"]), float(found["high"])
    if low > high:
        raise ConfigError(f"valid_range.{name}: low ({low:g}) must not be above high ({high:g})")
    return Range(low, high)


def _try(model: ExtendedModel) -> None:
    """Compute two samples, so that everything needed is built now and not at the first message."""
    still = np.zeros(2)
    torque = np.array([model.ranges.torque.low, model.ranges.torque.high])
    heat = None if model.ranges.temperature is None else np.full(2, model.ranges.temperature.low)
    try:
        with np.errstate(all="ignore"):
            error, _ = model.step(model.start(), np.array([0.0, 1e-3]), still, None, torque, heat)
    except Exception as found:  # any failure comes from the file's numbers
        raise ContentError(f"the model cannot be computed: {found}") from found
    if not np.isfinite(error).any():
        raise ContentError("the model has no transmission error at the torques of its valid range")

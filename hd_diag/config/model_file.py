"""Files of extended models (JSON): written by a diagnosis, read and checked before a joint uses one."""

from __future__ import annotations

import difflib
import hashlib
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from hd_diag.config.configured_drive import drive_from
from hd_diag.config.parameters import JOINT_PARAMETERS, ConfigError, Value, check_known, checked, shown
from hd_diag.effects import CATALOGUE
from hd_diag.effects.effect import Effect
from hd_diag.extended_model import ExtendedModel, Range, Ranges, Term

SCHEMA = "hd_diag/model/1"

REFITTED = (
    "circular_spline_datum",
    "tooth_compliance",
    "cup_compliance",
    "eccentricity.magnitude",
    "eccentricity.direction",
    "runout.magnitude",
    "runout.direction",
)
"""Parameters of a drive that a fit changes; in all others a joint must be what the model was fitted to."""

_LARGEST = 1_000_000  # [byte]
_NOT_OF_THE_DRIVE = ("input_joint", "output_joint", "torque", "model_file")
_DRIVE = {
    p.name: p
    for p in JOINT_PARAMETERS
    if p.name not in _NOT_OF_THE_DRIVE and not p.name.startswith(("limits.", "tolerance."))
}
_EFFECTS = {effect.name: effect for effect in CATALOGUE}
_ONE_MOMENT = ("tooth_skip",)  # happened once in one record
_KEYS = (
    "schema",
    "version",
    "joint",
    "parameters",
    "standard_deviations",
    "base",
    "offset",
    "effects",
    "valid_range",
    "evidence",
)
_LARGEST_OFFSET = 10.0  # [rad]
_UNITS = {"torque": "N m", "speed": "rad/s", "temperature": "degC"}


@dataclass(frozen=True)
class ModelFile:
    """What a file holds.

    Attributes
    ----------
    model : ExtendedModel
    parameters : mapping
        Of the refitted drive, by their names within a joint.
    base : mapping
        The same of the drive that was configured when the model was fitted.
    """

    model: ExtendedModel
    parameters: Mapping[str, Value]
    base: Mapping[str, Value]

    def check_base(self, configured: Mapping[str, Value]) -> None:
        """Refuse a joint that is configured otherwise than the one that the model was fitted to.

        Parameters
        ----------
        configured : mapping
            Parameters of the joint; those that the fit changed may be as before it or as after.

        Raises
        ------
        ConfigError
            Naming the first parameter that differs.
        """
        for name, value in self.base.items():
            now = configured[name]
            if now != value and not (name in REFITTED and now == self.parameters[name]):
                raise ConfigError(
                    f"was fitted to a joint with {name} {shown(value)}, but this one has {shown(now)}"
                )


def drive_parameters(own: Mapping[str, Value]) -> dict[str, Value]:
    """Those of a joint's parameters that make its drive."""
    return {name: own[name] for name in _DRIVE}


def base_hash(base: Mapping[str, Value]) -> str:
    """SHA-256 of the parameters of a drive, in hexadecimal digits."""
    return hashlib.sha256(json.dumps(base, sort_keys=True).encode()).hexdigest()


def text_hash(text: str) -> str:
    """SHA-256 of a file's text, in hexadecimal digits."""
    return hashlib.sha256(text.encode()).hexdigest()


def reader(*folders: Path) -> Callable[[str, str], str]:
    """Text of a joint's model file; relative paths are looked for in these folders, then in the present one.

    Returns
    -------
    callable
        Of the joint's name and the path; raises ConfigError with the cause alone.
    """

    def read(joint: str, path: str) -> str:
        places = [folder / path for folder in folders if (folder / path).exists()]
        return _read(places[0] if places else Path(path))

    return read


def model_for(text: str, own: Mapping[str, Value]) -> ExtendedModel:
    """Model from the text of a file, for a joint with certain parameters, ready to run.

    Parameters
    ----------
    text : str
    own : mapping
        Parameters of the joint by their names within it.

    Raises
    ------
    ConfigError
        Saying in one line what is wrong; without the file's name.
    """
    found = parse(text)
    found.check_base(own)
    _try(found.model)
    return found.model


@lru_cache(maxsize=64)
def parse(text: str) -> ModelFile:
    """Content of a file, checked.

    Raises
    ------
    ConfigError
        Saying in one line what is wrong; without the file's name.
    """
    content = _object(_json(text), "the file", _KEYS)
    if content["schema"] != SCHEMA:
        raise ConfigError(f"schema is {shown(content['schema'])}, not '{SCHEMA}'")
    for key in ("version", "joint"):
        if not isinstance(content[key], str):
            raise ConfigError(f"{key}: expected a text, not {shown(content[key])}")
    parameters = _parameters(content["parameters"])
    base = _base(content["base"], parameters)
    for key in ("evidence", "standard_deviations"):
        _mapping(content[key], key)
    try:
        drive = drive_from(parameters)
    except ValueError as error:
        raise ConfigError(f"parameters: {error}") from error
    offset = _number(content["offset"], "offset", -_LARGEST_OFFSET, _LARGEST_OFFSET)
    model = ExtendedModel(drive, _terms(content["effects"]), offset, _ranges(content["valid_range"]))
    return ModelFile(model, parameters, base)


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

    Parameters
    ----------
    joint : str
    configured : mapping
        Parameters of the joint when the model was fitted.
    model : ExtendedModel
    spreads : mapping
        Standard deviations of the refitted parameters.
    effects : sequence of (mapping, sequence of str)
        Of every term of the model the standard deviations of its quantities (zero: not estimated), and its
        class: the names that the record could not tell from it, itself first.
    evidence : mapping
        What speaks for the model: bags, held-out figures.
    version : str
        Of the program.

    Returns
    -------
    dict
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
            for (name, unit), limits in zip(_UNITS.items(), _limits(model.ranges), strict=True)
        },
        "evidence": dict(evidence),
    }


def write(path: str | Path, content: Mapping[str, Any]) -> None:
    """Write a file, whole or not at all.

    Raises
    ------
    ConfigError
        Where the content is none that `parse` takes, or the file cannot be written.
    """
    try:
        text = json.dumps(content, indent=1, allow_nan=False) + "\n"
        parse(text)
        partly = Path(f"{path}.part")
        partly.write_text(text, encoding="utf-8")
        os.replace(partly, path)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from error
    except ValueError as error:
        raise ConfigError(f"{path}: the model cannot be written: {error}") from error


def _limits(ranges: Ranges) -> tuple[Range, Range, Range | None]:
    return ranges.torque, ranges.speed, ranges.temperature


def _refitted(model: ExtendedModel) -> dict[str, Value]:
    mesh = model.drive.mesh
    sizes = {"eccentricity": mesh.eccentricity, "runout": mesh.runout}
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


def _read(path: Path) -> str:
    try:
        with path.open("rb") as file:
            data = file.read(_LARGEST + 1)
    except (OSError, ValueError) as error:
        cause = error.strerror if isinstance(error, OSError) else error
        raise ConfigError(f"cannot be read: {cause}") from error
    if len(data) > _LARGEST:
        raise ConfigError(f"longer than {_LARGEST} bytes: not a model file")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise ConfigError(f"not a text in UTF-8: {error.reason} at byte {error.start}") from error


def _json(text: str) -> Any:
    try:
        return json.loads(text, parse_constant=_refuse, object_pairs_hook=_once)
    except ConfigError:
        raise
    except (ValueError, RecursionError) as error:
        reason = "nested too deep" if isinstance(error, RecursionError) else " ".join(str(error).split())
        raise ConfigError(f"not JSON: {reason}") from error


def _refuse(constant: str) -> Any:
    raise ConfigError(f"holds {constant}, which is no number")


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ConfigError(f"{shown(twice)} stands twice")
    return found


def _mapping(value: Any, what: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ConfigError(f"{what}: expected an object {{...}}, not {shown(value)}")
    return value


def _object(value: Any, what: str, keys: Sequence[str], optional: Sequence[str] = ()) -> dict[str, Any]:
    """The mapping, which must have these keys and may have the optional ones."""
    found = _mapping(value, what)
    for name in found:
        if name not in (*keys, *optional):
            raise ConfigError(f"{what} has an unknown key {shown(name)}; {_nearest(name, keys)}")
    for name in keys:
        if name not in found:
            raise ConfigError(f"{what} lacks '{name}'")
    return found


def _nearest(name: str, known: Sequence[str]) -> str:
    return f"the nearest known is '{difflib.get_close_matches(name[:80], known, n=1, cutoff=0.0)[0]}'"


def _number(value: Any, what: str, low: float, high: float) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ConfigError(f"{what}: expected a number, not {shown(value)}")
    if not low <= value <= high:
        raise ConfigError(f"{what}: expected a number from {low:g} to {high:g}, not {shown(value)}")
    return float(value)


def _parameters(value: Any) -> dict[str, Value]:
    given = _mapping(value, "parameters")
    check_known(list(given), _DRIVE)
    missing = [name for name in _DRIVE if name not in given]
    if missing:
        raise ConfigError(f"parameters lack '{missing[0]}'")
    return {name: checked(name, given[name], parameter) for name, parameter in _DRIVE.items()}


def _base(value: Any, parameters: Mapping[str, Value]) -> dict[str, Value]:
    found = _object(value, "base", ("sha256", "before_the_fit"))
    before = _mapping(found["before_the_fit"], "base.before_the_fit")
    for name in before:
        if name not in REFITTED:
            raise ConfigError(f"base.before_the_fit: {shown(name)} is none that a fit changes")
    base = {**parameters, **{name: checked(name, one, _DRIVE[name]) for name, one in before.items()}}
    if found["sha256"] != base_hash(base):
        raise ConfigError("base.sha256 is not that of the parameters: the file was changed")
    return base


def _terms(value: Any) -> tuple[Term, ...]:
    if not isinstance(value, list):
        raise ConfigError(f"effects: expected a list, not {shown(value)}")
    terms = tuple(_term(item, f"effects[{index}]") for index, item in enumerate(value))
    names = [term.effect.name for term in terms]
    if len(set(names)) != len(names):
        raise ConfigError("effects: a name stands twice")
    return terms


def _term(value: Any, where: str) -> Term:
    found = _object(value, where, ("name", "parameters"), ("class",))
    effect = _named(found["name"], where)
    where = f"{where} ({effect.name})"
    given = _mapping(found["parameters"], f"{where}.parameters")
    units = {quantity.name: quantity.unit for quantity in effect.quantities}
    for name in given:
        if name not in units:
            raise ConfigError(f"{where} has an unknown quantity {shown(name)}; {_nearest(name, list(units))}")
    values = {name: _quantity(one, f"{where}.{name}", units[name]) for name, one in given.items()}
    try:
        coefficients, nonlinear = effect.from_physical(values)
    except ValueError as error:
        raise ConfigError(f"{where}: {error}") from error
    return Term(effect, tuple(coefficients.tolist()), nonlinear)


def _named(name: Any, where: str) -> Effect:
    if not isinstance(name, str):
        raise ConfigError(f"{where}.name: expected a text, not {shown(name)}")
    if name in _ONE_MOMENT:
        raise ConfigError(f"{where}: {name} happened once in a record, a model that runs cannot hold it")
    if name not in _EFFECTS:
        raise ConfigError(f"{where}: unknown effect {shown(name)}; {_nearest(name, list(_EFFECTS))}")
    return _EFFECTS[name]


def _quantity(value: Any, where: str, unit: str) -> float:
    found = _object(value, where, ("value",), ("std", "unit"))
    if found.get("unit", unit) != unit:
        raise ConfigError(f"{where}: expected the unit {shown(unit)}, not {shown(found['unit'])}")
    if found.get("std") is not None:
        _number(found["std"], f"{where}.std", 0.0, 1e300)
    return _number(found["value"], where, -1e300, 1e300)


def _ranges(value: Any) -> Ranges:
    found = _object(value, "valid_range", tuple(_UNITS))
    torque, speed = (_range(found[name], f"valid_range.{name}") for name in ("torque", "speed"))
    heat = found["temperature"]
    return Ranges(torque, speed, None if heat is None else _range(heat, "valid_range.temperature"))


def _range(value: Any, where: str) -> Range:
    found = _object(value, where, ("low", "high"), ("unit",))
    low, high = (_number(found[end], f"{where}.{end}", -1e9, 1e9) for end in ("low", "high"))
    if low > high:
        raise ConfigError(f"{where}: low ({low:g}) must not be above high ({high:g})")
    return Range(low, high)


def _try(model: ExtendedModel) -> None:
    """Compute two samples: what is needed beside the file is built now, not at the first message."""
    still = np.zeros(2)
    torque = np.array([model.ranges.torque.low, model.ranges.torque.high])
    heat = None if model.ranges.temperature is None else np.full(2, model.ranges.temperature.low)
    try:
        with np.errstate(all="ignore"):
            error, _ = model.step(model.start(), np.array([0.0, 1e-3]), still, None, torque, heat)
    except Exception as found:  # whatever is wrong with the numbers together, it is the file's fault
        raise ConfigError(f"the model cannot be computed: {found}") from found
    if not np.isfinite(error).any():
        raise ConfigError("the model has no transmission error at the torques of its valid range")

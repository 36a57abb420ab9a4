"""Limits and tolerances of a joint, out of its configuration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from hd_diag.config.parameters import JOINT_PARAMETERS, Value

_PREFIX = "tolerance."
_LIMITS = f"{_PREFIX}limits."


@dataclass(frozen=True)
class Spread:
    """How a quantity differs between assemblies: name of the distribution, and its size in its unit."""

    distribution: str
    size: float


@dataclass(frozen=True)
class Settings:
    """Limits by the names of the criteria [m, N, -, rad], spreads by the names of the quantities."""

    limits: Mapping[str, float]
    spreads: Mapping[str, Spread]


def settings(flat: Mapping[str, Value], joint: str) -> Settings:
    """Limits and tolerances of a joint.

    Parameters
    ----------
    flat : mapping
        Every parameter of a configuration by its full name, checked.
    joint : str

    Returns
    -------
    Settings
    """
    own = {p.name: flat[f"{joint}.{p.name}"] for p in JOINT_PARAMETERS if p.name.startswith(_PREFIX)}
    limits = {name.removeprefix(_LIMITS): _number(own[name]) for name in own if name.startswith(_LIMITS)}
    quantities = [name.removeprefix(_PREFIX).removesuffix(".size") for name in own if name.endswith(".size")]
    spreads = {
        name: Spread(str(own[f"{_PREFIX}{name}.distribution"]), _number(own[f"{_PREFIX}{name}.size"]))
        for name in quantities
    }
    return Settings(limits, spreads)


def _number(value: Value) -> float:
    assert isinstance(value, (int, float))
    return float(value)

"""A drive from the parameters of a joint, and the parameters of a geometry."""

from __future__ import annotations

import cmath
from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import Any

from hd_diag.config.parameters import Value, flatten
from hd_diag.drive import Drive
from hd_diag.model.cams import CAMS, Cam
from hd_diag.model.flank_chain import FlankChain, chain_of_points
from hd_diag.model.geometry import Geometry
from hd_diag.model.mesh import Mesh
from hd_diag.model.tooth_profile import DoubleArc
from hd_diag.model.transmission_error import Kinematics

# Parameters of a geometry that have other names than its fields.
_NAMES = {
    "flexspline_root": "flexspline_tooth.root",
    "flexspline_tip": "flexspline_tooth.tip",
    "flexspline_tooth.numbers": "flexspline_tooth.chain",
    "circular_spline_slot.numbers": "circular_spline_slot.chain",
}


def drive_from(own: Mapping[str, Any], teeth: bool = True) -> Drive:
    """Drive from a joint's parameters by their names within it; raises ValueError naming what is impossible.

    Without `teeth` the ratio need not match the teeth; only kinematics, rated torque and accuracy then hold.
    """
    values: dict[str, Any] = {
        name: _flank(own, name) for name in ("flexspline_tooth", "circular_spline_slot")
    }
    values["neutral_curve"] = _cam(own)
    names = [field.name for field in fields(Geometry) if field.name not in values]
    geometry = Geometry(**values, **{name: own[_NAMES.get(name, name)] for name in names})
    eccentricity, runout, tilt = (_polar(own, name) for name in ("eccentricity", "runout", "tilt"))
    mesh = Mesh(geometry, own["tooth_compliance"], eccentricity, runout, own["arc_offset"], tilt)
    kinematics = Kinematics(own["ratio"], own["output"], own["wave_generator_phase"], teeth)
    beside = ("rated_torque", "cup_compliance", "accuracy")
    return Drive(mesh, kinematics, *(own[name] for name in beside if name in own))


def geometry_parameters(geometry: Geometry) -> dict[str, Value]:
    """Parameters of a joint that describe a geometry."""
    shape = next(name for name, cam in CAMS.items() if isinstance(geometry.neutral_curve, cam))
    every = flatten({**asdict(geometry), "neutral_curve.shape": shape})
    return {_NAMES.get(name, name): list(v) if isinstance(v, tuple) else v for name, v in every}


def _cam(own: Mapping[str, Any]) -> Cam:
    cam: Any = CAMS[own["neutral_curve.shape"]]
    values = [own[f"neutral_curve.{field.name}"] for field in fields(cam)]
    found: Cam = cam(*(tuple(value) if isinstance(value, list) else value for value in values))
    return found


def _flank(own: Mapping[str, Any], name: str) -> DoubleArc | FlankChain:
    points, chain = (tuple(own[f"{name}.{way}"]) for way in ("points", "chain"))
    try:
        if len(points) > 1:
            return chain_of_points(points)
        if len(chain) > 1:
            return FlankChain(chain)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from error
    radii = (own[f"{name}.{arc}_radius"] for arc in ("addendum", "dedendum"))
    centers = (tuple(own[f"{name}.{arc}_center"]) for arc in ("addendum", "dedendum"))
    return DoubleArc(*radii, *centers)


def _polar(own: Mapping[str, Any], name: str) -> complex:
    return cmath.rect(own[f"{name}.magnitude"], own[f"{name}.direction"])

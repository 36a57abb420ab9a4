"""A drive from the parameters of a joint."""

from __future__ import annotations

import cmath
from collections.abc import Mapping

from hd_diag.config.parameters import Value
from hd_diag.drive import Drive
from hd_diag.model.geometry import Geometry
from hd_diag.model.mesh import Mesh
from hd_diag.model.tooth_profile import DoubleArc
from hd_diag.model.transmission_error import Kinematics


def number(parameters: Mapping[str, Value], name: str) -> float:
    """One of the parameters that are numbers."""
    value = parameters[name]
    assert isinstance(value, (int, float))
    return float(value)


def drive_from(own: Mapping[str, Value]) -> Drive:
    """Drive from a joint's parameters by their names within it; raises ValueError naming what cannot be."""
    geometry = Geometry(
        int(number(own, "flexspline_teeth")),
        int(number(own, "circular_spline_teeth")),
        number(own, "neutral_curve.semi_major"),
        number(own, "neutral_curve.semi_minor"),
        _arcs(own, "flexspline_tooth"),
        number(own, "flexspline_tooth.root"),
        number(own, "flexspline_tooth.tip"),
        _arcs(own, "circular_spline_slot"),
        number(own, "circular_spline_datum"),
        number(own, "circular_spline_tip_radius"),
    )
    mesh = Mesh(
        geometry,
        number(own, "tooth_compliance"),
        _polar(own, "eccentricity"),
        _polar(own, "runout"),
        number(own, "arc_offset"),
    )
    output = "flexspline" if own["output"] == "flexspline" else "circular_spline"
    kinematics = Kinematics(number(own, "ratio"), output, number(own, "wave_generator_phase"))  # type: ignore[arg-type]
    names = ("rated_torque", "cup_compliance", "accuracy")
    return Drive(mesh, kinematics, *(number(own, name) for name in names if name in own))


def _arcs(own: Mapping[str, Value], name: str) -> DoubleArc:
    outer, inner = own[f"{name}.addendum_center"], own[f"{name}.dedendum_center"]
    assert isinstance(outer, list)
    assert isinstance(inner, list)
    return DoubleArc(
        number(own, f"{name}.addendum_radius"),
        number(own, f"{name}.dedendum_radius"),
        (float(outer[0]), float(outer[1])),
        (float(inner[0]), float(inner[1])),
    )


def _polar(own: Mapping[str, Value], name: str) -> complex:
    return cmath.rect(number(own, f"{name}.magnitude"), number(own, f"{name}.direction"))

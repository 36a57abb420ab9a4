"""The parameter file of a drive from its catalogue page; comments say what was given and what is assumed."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.config.assessment import Assessment
from hd_diag.config.configuration import Config, JointConfig
from hd_diag.config.defaults import DEFAULTS, EXAMPLE, resolved
from hd_diag.config.parameters import JOINT_PARAMETERS, Parameter, nested
from hd_diag.formatting import ARCSEC
from hd_diag.gears.characteristics import slot_shift
from hd_diag.gears.page import ASSUMED_PROFILE
from hd_diag.model.geometry import Geometry

_WIDTH = 118  # of a comment line
_COLUMN = 62  # at which the comment of a value begins
_STEP = "  "

_GROUPS = {
    "input_joint": "Names in sensor_msgs/JointState",
    "ratio": "Given, from the catalogue page. To change it run the command again: what stands below holds",
    "accuracy": "Given, or 1.5 arcmin as for most pages",
    "flexspline_teeth": "Assumed by similarity: put in what you know better",
    "tooth_compliance": "Fitted to the torsion curve of K1, K2, K3",
    "limits": "Diagnostics, scaled with the gear: WARN above the first, ERROR above the second",
    "tolerance": "hd-diag tolerance, scaled with the gear; the others: config/example_drive.yaml",
}
_SCALES = {
    "module": "the module",
    "radius": "the size",
    "force": "the tooth force",
    "accuracy": "the accuracy",
    "compliance": "the compliance of teeth and cup",
    "error": "the accuracy",
    "preload": "the tooth force",
}


def text(config: Config, joint: JointConfig, assessed: Assessment, command: str) -> str:
    """Text of the file for a joint with a page, with the command that writes it."""
    given = {name: config.given.get(f"{joint.name}.{name}") for name in DEFAULTS}
    assert assessed.page is not None
    kept = {*resolved(assessed.page), *(name for name, value in given.items() if value is not None)}
    kept |= {"input_joint", "output_joint", "ratio", "output", "accuracy"}
    known = {p.name: p for p in JOINT_PARAMETERS if p.name in kept or p.scale}
    values: dict[str, Any] = {name: config.flat[f"{joint.name}.{name}"] for name in known}
    values |= {"input_joint": joint.input_joint, "output_joint": joint.output_joint}
    lines = [f"# {line}".rstrip() for line in _head(assessed, joint, command)]
    lines += ["hd_diag:", "  ros__parameters:", f"    joints: [{joint.name}]", f"    {joint.name}:"]
    return "\n".join([*lines, *_lines(nested(values), known, "", 3)]) + "\n"


def reached(assessed: Assessment) -> Iterator[str]:
    """Lines that compare the torsion curve and its slopes with the page."""
    page, found = assessed.page, assessed.found
    assert page is not None
    torque, given, own = assessed.torsion
    off = 100.0 * (own / given - 1.0)
    yield f"torsion at {_list(torque)} N m: {_list(own / ARCSEC)} arcsec"
    yield f"the page's curve: {_list(given / ARCSEC)} arcsec; off by at most {np.abs(off).max():.1f} %"
    slopes = zip(found.stiffness, page.stiffness, strict=True)
    listed = ", ".join(f"K{n} {value:.3g} ({wanted:.3g})" for n, (value, wanted) in enumerate(slopes, 1))
    yield f"secants, the page's in brackets: {listed} N m/rad; T1 {page.t1:.3g}, T2 {page.t2:.3g} N m"


def _list(values: Floats) -> str:
    return ", ".join(f"{value:.3g}" for value in values)


def assumed(joint: JointConfig) -> str:
    """Assumptions by similarity, in words."""
    geometry, example = joint.configured.mesh.geometry, EXAMPLE.mesh.geometry
    shift = slot_shift(example, geometry)
    side = "out" if shift >= 0.0 else "in"
    return (
        f"teeth of the example drive (size 25, ratio 100; config/example_drive.yaml) times "
        f"{geometry.module / example.module:.3g}, its pitch circle times "
        f"{geometry.curve.radius / example.curve.radius:.3g}, deformation with the teeth; slots "
        f"{abs(shift) * 1e6:.1f} µm further {side}, where the page's torsion curve has them; "
        f"{width_in_words(geometry)}"
    )


def width_in_words(geometry: Geometry) -> str:
    """Width of the teeth, length of the cup, number of sections."""
    if geometry.sections == 1:
        return "the middle section stands for the width"
    length = (
        f"{1e3 * geometry.cup_length:.3g} mm from the cup's bottom" if geometry.cup_length else "of a ring"
    )
    return f"teeth {1e3 * geometry.face_width:.3g} mm wide, {length}, in {geometry.sections} sections"


def _head(assessed: Assessment, joint: JointConfig, command: str) -> Iterator[str]:
    found = assessed.found
    yield from _wrapped(f"A drive from its catalogue page, as this writes it: {command}")
    yield ""
    yield from _wrapped(f"Assumed by similarity: {assumed(joint)}.")
    yield from (f"Reached: {line}" for line in reached(assessed))
    gap = "overlap" if found.loads.overlap > 0.0 else "clearance"
    yield (
        f"At rest: lost motion {found.lost_motion / ARCSEC / 60:.2g} arcmin, least backlash "
        f"{found.least_backlash * 1e6:.2g} µm, {gap} of the lobes {abs(found.loads.overlap) * 1e6:.2g} µm"
    )
    yield from _wrapped(
        "Stiffness, lost motion and the error of order 2 that an eccentricity makes are fitted or follow. "
        f"{ASSUMED_PROFILE.capitalize()}."
    )
    for warning in assessed.warnings:
        yield from _wrapped(f"Warning: {warning}.")


def _wrapped(line: str) -> list[str]:
    return textwrap.wrap(line, _WIDTH - 2)


def _lines(tree: Mapping[str, Any], known: Mapping[str, Parameter], prefix: str, depth: int) -> Iterator[str]:
    for key, value in tree.items():
        name = f"{prefix}{key}"
        if name in _GROUPS:
            yield ""
            yield f"{_STEP * depth}# {_GROUPS[name]}"
        if isinstance(value, dict):
            yield f"{_STEP * depth}{key}:"
            yield from _lines(value, known, f"{name}.", depth + 1)
        else:
            line = f"{_STEP * depth}{key}: {_shown(value)}"
            yield f"{line:<{_COLUMN}} # {_meaning(known[name])}"


def _shown(value: Any) -> str:
    """A value as YAML and ROS read it: a float has a decimal point."""
    if isinstance(value, list):
        return f"[{', '.join(map(_shown, value))}]"
    if isinstance(value, float):
        number = repr(value)
        return number if "." in number else number.replace("e", ".0e")
    return str(value) or "''"


def _meaning(parameter: Parameter) -> str:
    unit = f"[{parameter.unit}] " if parameter.unit else ""
    scaled = f"; with {_SCALES[parameter.scale]}" if parameter.scale in _SCALES else ""
    return f"{unit}{parameter.meaning}{scaled}"

"""``hd-diag gear``: a parameter file for a drive from its catalogue page."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from hd_diag.cli.check import describe
from hd_diag.cli.examples import load_example
from hd_diag.cli.lines import tell
from hd_diag.cli.targets import Problem, check_new, write_json, writing
from hd_diag.config import gear_file
from hd_diag.config.assessment import Assessment, assess
from hd_diag.config.configuration import Config, JointConfig, resolve
from hd_diag.gears.catalogue import named

_ARCMIN = math.pi / 10800.0  # [rad]
_PARAMETERS = {"accuracy": "accuracy", "output": "output"}  # the other options belong to the page
_IN_ARCMIN = ("accuracy", "gear.lost_motion")
# Usual ratios on pages, where the circular spline is fixed.
_USUAL = (30, 50, 80, 100, 120, 160)


def gear(
    name: str | None,
    out: Path | None,
    overwrite: bool,
    joint: str,
    figure: Path | None,
    json_file: str | None,
    **given: Any,
) -> None:
    """Run ``hd-diag gear``."""
    if out and not overwrite:
        check_new(out)
    own = {_PARAMETERS.get(key, f"gear.{key}"): value for key, value in given.items() if value is not None}
    own |= {key: value * _ARCMIN for key, value in own.items() if key in _IN_ARCMIN}
    if not name and not any(key.startswith("gear.") for key in own):
        raise Problem(
            "give the name of a gear, as CSG-25-100, or the numbers of its page: --size, --ratio, ..."
        )
    words = [f"hd-diag gear{f' {name}' if name else ''} --joint {joint}", *_options(given)]
    config = _resolved(joint, _of_name(name, own["output"]) | own)
    found = config.joints[0]
    assessed = assess(config, found)
    if out:
        with writing(out) as place:
            place.write_text(gear_file.text(config, found, assessed, " ".join(words)), encoding="utf-8")
    if figure:
        from hd_diag.report.pictures.canvas import save  # late: matplotlib takes its time

        drawn = load_example("tooth_pair").tooth_pair_picture(found.configured.mesh.geometry)
        with writing(figure) as place:
            save(drawn, place)
    content = {"schema": "hd_diag/gear/1", "file": str(out) if out else None, "parameters": dict(config.flat)}
    if write_json(json_file, content | {"joints": {joint: assessed.content()}}):
        _show(found, assessed)
        tell(f"{out}: written" if out else "No file was written: --out FILE writes one.")


def _of_name(name: str | None, output: str) -> dict[str, Any]:
    """Parameters of a gear of the table, which gives the ratio with a fixed circular spline."""
    if not name:
        return {}
    try:
        found = named(name)[1]
    except ValueError as error:
        raise Problem(str(error)) from error
    values = {f"gear.{key}": value for key, value in found.given.items()}
    return values | {"gear.ratio": found.page.ratio + (output == "circular_spline")}


def _resolved(joint: str, own: dict[str, Any]) -> Config:
    if "gear.pitch_diameter" in own:
        own.pop("gear.size", None)
    return resolve({"joints": [joint]} | {f"{joint}.{name}": value for name, value in own.items()})


def _options(given: dict[str, Any]) -> list[str]:
    """The options that reproduce the file, without its path."""
    return [
        f"--{key.replace('_', '-')} {value if isinstance(value, str) else f'{value:.6g}'}"
        for key, value in given.items()
        if value is not None
    ]


def _show(joint: JointConfig, assessed: Assessment) -> None:
    tell(f"Assumed: {gear_file.assumed(joint)}.")
    describe(joint, assessed)
    note = _usual_ratio(joint)
    if note:
        tell(f"  note: {note}")


def _usual_ratio(joint: JointConfig) -> str:
    """Advice if the ratio differs by one from a usual one on pages; empty otherwise."""
    geometry, kinematics = joint.configured.mesh.geometry, joint.configured.kinematics
    teeth = f"{geometry.flexspline_teeth}/{geometry.circular_spline_teeth} teeth"
    ratio = round(abs(kinematics.ratio))
    if kinematics.output == "circular_spline" and ratio in _USUAL:
        return (
            f"{teeth}. A page's ratio {ratio} is that of a fixed circular spline: the joint's is {ratio + 1}"
        )
    if kinematics.output == "flexspline" and ratio - 1 in _USUAL:
        return f"{teeth}. If the page's ratio is {ratio - 1}, the output is the circular spline: --output"
    return ""

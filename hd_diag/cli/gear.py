"""``hd-diag gear``: a parameter file for a drive from its catalogue page."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from hd_diag.cli.check import describe
from hd_diag.cli.examples import load_example
from hd_diag.cli.lines import tell
from hd_diag.cli.targets import write_json, writing
from hd_diag.config import gear_file
from hd_diag.config.assessment import Assessment, assess
from hd_diag.config.configuration import JointConfig, resolve

_ARCMIN = math.pi / 10800.0  # [rad]
# Pages name the ratio with the circular spline fixed; these are on them.
_USUAL = (30, 50, 80, 100, 120, 160)


def gear(out: Path, joint: str, figure: Path | None, json_file: str | None, **given: Any) -> None:
    """Do what ``hd-diag gear`` is asked for."""
    accuracy, output = given.pop("accuracy"), given.pop("output")
    own = {f"gear.{name}": value for name, value in given.items() if value is not None}
    own |= {"output": output} | ({} if accuracy is None else {"accuracy": accuracy * _ARCMIN})
    config = resolve({"joints": [joint]} | {f"{joint}.{name}": value for name, value in own.items()})
    found = config.joints[0]
    assessed = assess(config, found)
    written = gear_file.text(config, found, assessed, _command(own, joint))
    with writing(out) as place:
        place.write_text(written, encoding="utf-8")
    if figure:
        from hd_diag.report.pictures.canvas import save  # matplotlib takes its time

        drawn = load_example("tooth_pair").tooth_pair_picture(found.configured.mesh.geometry)
        with writing(figure) as place:
            save(drawn, place)
    content = {"schema": "hd_diag/gear/1", "file": str(out), "parameters": dict(config.flat)}
    if write_json(json_file, content | {"joints": {joint: assessed.content()}}):
        _show(found, assessed)
        tell(f"{out}: written")


def _command(own: dict[str, Any], joint: str) -> str:
    """The command that gives the same file, without where it is written to."""
    words = [f"hd-diag gear --joint {joint}"]
    for name, value in own.items():
        flag = name.removeprefix("gear.").replace("_", "-")
        given = value / _ARCMIN if name == "accuracy" else value
        words.append(f"--{flag} {given if name == 'output' else f'{given:.6g}'}")
    return " ".join(words)


def _show(joint: JointConfig, assessed: Assessment) -> None:
    tell(f"Assumed: {gear_file.assumed(joint)}.")
    describe(joint, assessed)
    for line in gear_file.reached(assessed):
        tell(f"  {line}")
    note = _usual_ratio(joint)
    if note:
        tell(f"  note: {note}")


def _usual_ratio(joint: JointConfig) -> str:
    """What to look at where the ratio is off by one from those that pages name, or nothing."""
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

"""``hd-diag figures``: the model's counterparts of the paper's figures, and a drawing of the drive."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from hd_diag.cli.examples import load_example
from hd_diag.cli.joints import configured
from hd_diag.cli.lines import tell
from hd_diag.cli.options import check_files
from hd_diag.cli.targets import Problem, write_columns, writing
from hd_diag.report.pictures.canvas import save
from hd_diag.streams.columns import LARGEST_TORQUE

_CAPTIONS = "figures.md"
_MOST_SIZES = 6  # eccentricities that colours and dashes distinguish


def figures(
    out: Path,
    config_file: str | None,
    format: str,
    torque: float | None,
    eccentricities_um: str | None,
    direction_deg: float | None,
) -> None:
    """Run ``hd-diag figures``."""
    joint = configured(config_file).joints[0]
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise Problem(f"{out}: cannot be made: {error.strerror}") from error
    paper = load_example("paper_figures")
    study = paper.PAPER._replace(**_asked(torque, eccentricities_um, direction_deg))
    try:
        entries = paper.figures(joint.drive, study)
        if joint.drive.mesh.geometry.sections > 1:
            entries += load_example("section_figures").figures(joint.drive, study)
    except ValueError as error:
        raise Problem(str(error)) from error
    drawing = out / f"drive.{format}"
    kinds = (format, "csv")
    check_files((*(out / f"{e.name}.{kind}" for e in entries for kind in kinds), drawing, out / _CAPTIONS))
    captions = [f"Drive of {joint.name}; claims are those of Dong et al. (2019), sections 4.2, 4.3 and 5."]
    for name, title, figure, claims, data in entries:
        file, wrong = out / f"{name}.{format}", " **This does not agree.**"
        listed = [f"* ({c.letter}) {c.text}{'' if c.holds else wrong}" for c in claims]
        with writing(file) as place:
            save(figure, place)
        write_columns(out / f"{name}.csv", data)
        captions.append("\n".join([f"## {title}\n\n![{title}]({file.name})\n", *listed]))
        for line in (f"{file}: {title}", *listed):
            tell(line)
    with writing(drawing) as place:
        save(load_example("eccentric_drive").drive_picture(joint.drive), place)
    tell(f"{drawing}: what is eccentric to what, positive directions, interference")
    with writing(out / _CAPTIONS) as place:
        place.write_text("\n\n".join(captions) + "\n", encoding="utf-8")
    tell(f"{out / _CAPTIONS}: captions")


def _asked(torque: float | None, sizes_um: str | None, direction_deg: float | None) -> dict[str, Any]:
    """Fields of the study that the options set."""
    found: dict[str, Any] = {}
    if sizes_um is not None:
        try:
            sizes = np.array([float(size) for size in sizes_um.split(",")]) * 1e-6
        except ValueError:
            sizes = np.empty(0)
        if not (1 <= sizes.size <= _MOST_SIZES and np.all(sizes >= 0.0) and np.isfinite(sizes).all()):
            raise Problem(
                f"--eccentricities-um takes one to {_MOST_SIZES} numbers like 0,5,10, not {sizes_um}"
            )
        found["sizes"] = sizes
    if direction_deg is not None:
        if not math.isfinite(direction_deg):
            raise Problem(f"--direction-deg must be a number, not {direction_deg:g}")
        found["direction"] = math.radians(direction_deg)
    if torque is not None:
        if not 0.0 < torque <= LARGEST_TORQUE:
            raise Problem(f"--torque must be above 0 and at most {LARGEST_TORQUE:g} N m, not {torque:g}")
        found["torque"] = torque
    return found

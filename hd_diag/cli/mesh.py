"""``hd-diag mesh``: one moment of a drive."""

from __future__ import annotations

import cmath
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.cli.joints import chosen_joint, configured
from hd_diag.cli.lines import number_table, show_table, tell
from hd_diag.cli.targets import Problem, write_columns, write_json, writing
from hd_diag.config.configuration import JointConfig
from hd_diag.config.defaults import page_of
from hd_diag.config.parameters import of_joint
from hd_diag.drive import Drive, mesh_state, transmission_error
from hd_diag.formatting import ARCSEC, json_ready
from hd_diag.gears.page import ASSUMED_PROFILE
from hd_diag.streams.columns import LARGEST_ANGLE, LARGEST_TORQUE

_PER_SLOT = 8  # angles of a sweep per slot pitch
_TORQUES, _MOST_TORQUE = 401, 2.0  # of a sweep: number, largest over rated torque [-]


def mesh(
    config_file: str | None,
    joint: str | None,
    input_angle: float,
    torque: float,
    eccentricity_um: float | None,
    direction_deg: float | None,
    tilt_mrad: float | None,
    section: int | None,
    sweep: str | None,
    out: Path | None,
    figure: Path | None,
    json_file: str | None,
) -> None:
    """Run ``hd-diag mesh``."""
    given = ("input-angle", input_angle, LARGEST_ANGLE), ("torque", torque, LARGEST_TORQUE)
    for name, value, largest in given:
        if not abs(value) <= largest:
            raise Problem(f"--{name} must be a number of at most {largest:g}, not {value:g}")
    if sweep and not (out or figure):
        raise Problem("--sweep needs --out or --figure")
    if sweep and section is not None:
        raise Problem("--section is of one moment, --sweep of many: give one of them")
    config = configured(config_file)
    found = chosen_joint(config, joint)
    found = replace(found, drive=_eccentric(found.drive, eccentricity_um, direction_deg))
    found = replace(found, drive=_tilted(found.drive, tilt_mrad, direction_deg))
    result = moment(found, input_angle, torque)
    shown = result if section is None else _in_section(result, section)
    table = swept(found.drive, sweep, input_angle, torque) if sweep else _teeth(shown)
    if out:
        write_columns(out, table)
    if figure:
        from hd_diag.report.pictures.canvas import save  # late: matplotlib takes its time
        from hd_diag.report.pictures.moment import table_picture

        with writing(figure) as place:
            save(table_picture(table), place)
    if write_json(json_file, result) and not sweep:
        _show(shown)
        if page_of(of_joint(config.flat, found.name)):
            tell(f"{ASSUMED_PROFILE.capitalize()}.")
    for file in (out, figure):
        if file:
            tell(f"{file}: {len(table['torque [N m]' if sweep else 'tooth'])} rows", err=json_file == "-")


def _eccentric(drive: Drive, size: float | None, direction: float | None) -> Drive:
    """The drive with an eccentricity [µm] in a direction [°]; None stands for the configured value."""
    if size is None and direction is None:
        return drive
    given = cmath.polar(drive.mesh.eccentricity)
    radius = given[0] if size is None else size * 1e-6
    angle = given[1] if direction is None else math.radians(direction)
    if not (0.0 <= radius < math.inf and math.isfinite(angle)):
        raise Problem("--eccentricity-um must be a number that is not negative, --direction-deg a number")
    try:
        return replace(drive, mesh=replace(drive.mesh, eccentricity=cmath.rect(radius, angle)))
    except ValueError as error:
        raise Problem(f"--eccentricity-um: {error}") from error


def _tilted(drive: Drive, size: float | None, direction: float | None) -> Drive:
    """The drive with a tilt [mrad] in a direction [°], by default that of the configured tilt."""
    if size is None:
        return drive
    angle = cmath.phase(drive.mesh.tilt) if direction is None else math.radians(direction)
    if not math.isfinite(size):
        raise Problem("--tilt-mrad must be a number")
    try:
        return replace(drive, mesh=replace(drive.mesh, tilt=1e-3 * size * cmath.exp(1j * angle)))
    except ValueError as error:
        raise Problem(f"--tilt-mrad: {error}") from error


def _in_section(result: dict[str, Any], number: int) -> dict[str, Any]:
    """A moment with backlash and load of one section, counted from the cup's bottom."""
    sections = result.get("sections", [])
    if not 1 <= number <= max(len(sections), 1):
        raise Problem(f"--section {number}: the drive has {max(len(sections), 1)}, counted from the bottom")
    if not sections:
        return result
    return {**result, **sections[number - 1], "pressure_angle": None, "section": number}


def swept(drive: Drive, over: str, input_angle: float, torque: float) -> dict[str, Floats]:
    """Columns of a sweep by their names with units: the quantities of `moment`.

    The sweep is over a turn of the wave generator from `input_angle` [rad], or over torques [N m] there.
    """
    if over == "angle":
        turn = 2.0 * np.pi / abs(drive.frame.turning)
        count = _PER_SLOT * drive.mesh.geometry.circular_spline_teeth
        angle = input_angle + turn * np.arange(count + 1) / count
        load = np.full(angle.size, torque)
    else:
        load = _MOST_TORQUE * drive.rated_torque * np.linspace(-1.0, 1.0, _TORQUES)
        angle = np.full(load.size, input_angle)
    state = mesh_state(drive, angle, load)
    return {
        "input_angle [rad]": angle,
        "torque [N m]": load,
        "transmission_error [rad]": transmission_error(drive, angle, load),
        "torsion [rad]": state.torsion,
        "lost_motion [rad]": state.lost_motion,
        "overlap [m]": state.overlap,
        "least_backlash [m]": state.minimum_backlash,
        "loaded_pairs": state.loaded_pairs.astype(np.float64),
        "peak_tooth_load [N]": state.peak_load,
        "load_concentration": state.load_concentration,
    }


def _teeth(result: dict[str, Any]) -> dict[str, Floats]:
    """Columns of the teeth of a moment by their names with units; nan where a pair cannot touch."""
    units = {"backlash": "m", "load": "N", "pressure_angle": "rad"}
    columns = {
        f"{name} {sign} [{unit}]": np.array(result[name][sign], dtype=np.float64)
        for name, unit in units.items()
        if result[name]
        for sign in "+-"
    }
    return {"tooth": np.arange(len(result["load"]["+"]), dtype=np.float64), **columns}


def moment(joint: JointConfig, input_angle: float, torque: float) -> dict[str, Any]:
    """Content of `hd-diag mesh --json` for a reported input angle [rad] and a torque [N m]."""
    drive = joint.drive
    angle, load = np.array([input_angle]), np.array([torque])
    state = mesh_state(drive, angle, load)
    driven = mesh_state(drive, angle, drive.frame.cup_torque(load))
    content = {
        "schema": "hd_diag/mesh/1",
        "joint": joint.name,
        "input_angle": input_angle,
        "torque": torque,
        "torsion": state.torsion[0],
        "transmission_error": transmission_error(drive, angle, load)[0],
        "lost_motion": state.lost_motion[0],
        "interference": state.interference[0],
        "overlap": state.overlap[0],
        "loaded_pairs": state.loaded_pairs[0],
        "peak_tooth_load": state.peak_load[0],
        "load_concentration": state.load_concentration[0],
        "backlash": _flanks(state.backlash[0]),
        "load": _flanks(state.load[0]),
        "pressure_angle": _flanks(state.pressure_angle[0]),
        "as_driven": {"torsion": driven.torsion[0], "load": _flanks(driven.load[0])},
        "units": {
            "angle": "rad",
            "torque": "N m",
            "backlash": "m, circumferential, at zero torsion",
            "load": "N, normal to the flank",
        },
    }
    places = drive.mesh.geometry.section_places.tolist()
    if len(places) > 1:
        apart = zip(places, state.section_backlash[0], state.section_load[0], strict=True)
        content["sections"] = [
            {"z": z, "backlash": _flanks(backlash), "load": _flanks(load)} for z, backlash, load in apart
        ]
    return dict(json_ready(content))


def _flanks(values: Floats) -> dict[str, Floats]:
    return dict(zip("+-", values, strict=True))


def _show(result: dict[str, Any]) -> None:
    def scaled(value: float | None, scale: float, decimals: int = 3) -> str:
        return "-" if value is None else f"{value * scale:.{decimals}f}"

    tell(f"{result['joint']} at input angle {result['input_angle']:g} rad, torque {result['torque']:g} N m")
    tell(
        f"transmission error {scaled(result['transmission_error'], 1 / ARCSEC)} arcsec, "
        f"torsion {scaled(result['torsion'], 1 / ARCSEC)} arcsec, "
        f"lost motion {scaled(result['lost_motion'], 1 / ARCSEC / 60)} arcmin"
    )
    overlap = result["overlap"] or 0.0
    tell(
        f"{result['loaded_pairs']} loaded flanks, largest force {scaled(result['peak_tooth_load'], 1)} N, "
        f"{scaled(result['load_concentration'], 1)} times the mean; "
        f"interference: {'yes' if result['interference'] else 'no'} "
        f"({'overlap' if overlap > 0.0 else 'clearance'} {scaled(abs(overlap), 1e6)} µm)"
    )
    if "section" in result:
        tell(f"Section {result['section']}, {result['z'] * 1e3:.2f} mm from the middle of the teeth:")
    table = number_table("tooth", "backlash +\n[µm]", "-\n[µm]", "load +\n[N]", "-\n[N]")
    for tooth in range(len(result["backlash"]["+"])):
        cells = [result[what][sign][tooth] for what in ("backlash", "load") for sign in "+-"]
        if cells[0] is not None or cells[1] is not None:
            scales = (1e6, 1e6, 1.0, 1.0)
            table.add_row(str(tooth), *(scaled(c, s, 2) for c, s in zip(cells, scales, strict=True)))
    show_table(table)
    tell("Teeth that are not listed cannot touch.")

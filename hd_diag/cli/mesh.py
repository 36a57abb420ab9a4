"""``hd-diag mesh``: one moment of a drive."""

from __future__ import annotations

from typing import Any

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.cli.joints import chosen_joint, configured
from hd_diag.cli.lines import number_table, show_table, tell
from hd_diag.cli.targets import Problem, write_json
from hd_diag.config.configuration import JointConfig
from hd_diag.drive import mesh_state, transmission_error
from hd_diag.formatting import ARCSEC, json_ready
from hd_diag.streams.columns import LARGEST_ANGLE, LARGEST_TORQUE


def mesh(
    config_file: str | None, joint: str | None, input_angle: float, torque: float, json_file: str | None
) -> None:
    """Do what ``hd-diag mesh`` is asked for."""
    given = ("input-angle", input_angle, LARGEST_ANGLE), ("torque", torque, LARGEST_TORQUE)
    for name, value, largest in given:
        if not abs(value) <= largest:
            raise Problem(f"--{name} must be a number of at most {largest:g}, not {value:g}")
    result = moment(chosen_joint(configured(config_file), joint), input_angle, torque)
    if write_json(json_file, result):
        _show(result)


def moment(joint: JointConfig, input_angle: float, torque: float) -> dict[str, Any]:
    """What `hd-diag mesh --json` writes of a moment: input angle as reported [rad], torque [N m]."""
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
    table = number_table("tooth", "backlash +\n[µm]", "-\n[µm]", "load +\n[N]", "-\n[N]")
    for tooth in range(len(result["backlash"]["+"])):
        cells = [result[what][sign][tooth] for what in ("backlash", "load") for sign in "+-"]
        if cells[0] is not None or cells[1] is not None:
            scales = (1e6, 1e6, 1.0, 1.0)
            table.add_row(str(tooth), *(scaled(c, s, 2) for c, s in zip(cells, scales, strict=True)))
    show_table(table)
    tell("Teeth that are not listed cannot touch.")

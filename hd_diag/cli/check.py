"""``hd-diag check``: whether a configuration is valid, and what it describes."""

from __future__ import annotations

import click

from hd_diag.cli.options import JSON, verb, write_json
from hd_diag.config.configuration import load


@verb("check config/example_drive.yaml")
@click.argument("config_file", metavar="CONFIG", type=click.Path(dir_okay=False))
@JSON
def check(config_file: str, json_file: str | None) -> None:
    """Validate a configuration without ROS and say what it describes.

    Every value is checked alone and the geometry as a whole; an unknown key is an error that names the
    nearest known one.
    """
    config = load(config_file)
    if json_file:
        write_json(json_file, {"schema": "hd_diag/check/1", "valid": True, "parameters": dict(config.flat)})
        if json_file == "-":
            return
    for joint in config.joints:
        mesh = joint.drive.mesh
        click.echo(
            f"{joint.name}: {joint.input_joint} -> {joint.output_joint}, "
            f"ratio {joint.drive.kinematics.ratio:g}, "
            f"{mesh.geometry.flexspline_teeth}/{mesh.geometry.circular_spline_teeth} teeth, "
            f"rated {joint.drive.rated_torque:g} N m, eccentricity {abs(mesh.eccentricity) * 1e6:g} um"
        )
    click.echo(f"{config_file}: valid")

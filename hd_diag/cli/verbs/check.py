"""What ``hd-diag check`` takes, and its help."""

from __future__ import annotations

import click

from hd_diag.cli import options


@options.verb("check config/example_drive.yaml")
@click.argument("config_file", metavar="CONFIG", type=options.Source(dir_okay=False))
@options.JSON
def check() -> None:
    """Validate a configuration without ROS and say what it describes.

    Every value is checked alone and the geometry as a whole; an unknown key is an error that names the
    nearest known one. Of each joint are told torsional stiffness, lost motion, clearance without torque and
    what an eccentricity does to the error; warnings where these cannot be a gear's, or not that of its
    catalogue page.
    """

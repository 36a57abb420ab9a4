"""What ``hd-diag check`` takes, and its help."""

from __future__ import annotations

import click

from hd_diag.cli import options


@options.verb("check config/example_drive.yaml")
@click.argument("config_file", metavar="CONFIG", type=options.Source(dir_okay=False))
@options.JSON
def check() -> None:
    """Check a configuration without ROS and describe its drives.

    Every value is checked alone, and the geometry as a whole. An unknown key is an error; the message names
    the nearest known key. For each joint the torsional stiffness, the lost motion, the clearance without
    torque and the effect of an eccentricity are printed. A warning says where no gear can have such a value,
    or where it differs from the gear's catalogue page.
    """

"""Options and help of the verbs about bags."""

from __future__ import annotations

import math
from pathlib import Path

import click

from hd_diag.cli import options


@options.verb("recover torn.mcap --out whole.mcap", "bags")
@options.BAG
@options.OUT_BAG
@options.OVERWRITE
@options.JSON
def recover() -> None:
    """Save what can be read of an unfinished or damaged bag.

    Everything in closed chunks, and what can be read of the open one, is copied into a new bag. The new bag
    is read back. The command says what was saved and what was lost. Exit codes: 0 something was saved, even
    if not everything; 2 nothing can be saved; 130 after Ctrl-C, which leaves a valid file. After an error the
    output has no end, so that it never passes for complete. With --overwrite the old bag stays until the new
    one is complete.
    """


@options.verb("replay log --out again.mcap", "bags")
@options.BAG
@options.OUT_BAG
@click.option(
    "--config",
    "config_file",
    type=options.Source(dir_okay=False),
    help="ROS parameter file. [default: what the node's log holds]",
)
@click.option(
    "--topic",
    "topics",
    multiple=True,
    help="Topic with joint states; repeatable. [default: all but what a node published]",
)
@options.OVERWRITE
@options.JSON
def replay() -> None:
    """Run the model over a bag and write what the node would publish.

    Time is the bag's, computed as fast as possible. Without --config the bag must be a log of the node: its
    configuration and every change of it are followed, and the outputs equal those of the live run bit for
    bit. Reads MCAP files and rosbag2 folders (MCAP or sqlite3), also unfinished ones. If the bag has no
    sample of a joint, stderr says what the bag has, and the exit code is 2. Ctrl-C leaves a valid file and
    ends with code 130. After an error the output has no end, so that it never passes for complete. With
    --overwrite the old bag stays until the new one is complete.
    """


_DEGREE = math.pi / 180.0

SHORT = {
    "eccentricity_um": ("eccentricity.magnitude", 1e-6, "Eccentricity, fixed in the housing [µm]."),
    "direction_deg": ("eccentricity.direction", _DEGREE, "Its direction [degrees]."),
    "runout_um": ("runout.magnitude", 1e-6, "Runout, which turns with the wave generator [µm]."),
    "runout_direction_deg": ("runout.direction", _DEGREE, "Its direction at input angle 0 [degrees]."),
    "datum_mm": ("circular_spline_datum", 1e-3, "Datum radius of the circular spline's slots [mm]."),
}
"""Options for common values: parameter, unit in SI, and help."""


@options.verb("simulate --out joint.mcap --eccentricity-um 18")
@options.OUT_BAG
@options.CONFIG
@options.JOINTS
@options.shown("--duration", 60.0, "Length of the record [s].")
@options.shown("--rate", 500.0, "Samples per second [Hz].")
@options.shown("--speed", (1.0, 2.0, 4.0), "Of the input [rev/s]; repeatable.", type=float, multiple=True)
@click.option(
    "--torque-level",
    type=float,
    multiple=True,
    help="Torque on the link [N m]; repeatable. [default: -71, -25, 25, 71 % of the rated torque]",
)
@click.option("--one-way", is_flag=True, help="Turn forwards only.")
@options.numbers((name, click.FLOAT, text) for name, (_, _, text) in SHORT.items())
@click.option(
    "--set",
    "assignments",
    multiple=True,
    metavar="PARAMETER=VALUE",
    help="Any parameter, such as joint_1.torque=5; repeatable.",
)
@options.shown("--offset-arcsec", 0.0, "Zero error of the output encoder [arcsec].")
@options.shown("--angle-noise-arcsec", 0.0, "White noise of the output angle [arcsec rms].")
@options.shown("--angle-drift-arcsec", 0.0, "Correlated noise of the output angle [arcsec rms].")
@options.shown("--torque-noise", 0.0, "White noise of the torque [N m rms].")
@options.shown("--seed", 0, "Seed of the noise.", type=click.IntRange(min=0))
@options.shown("--start-time", 1767225600.0, "First stamp, Unix time [s].")
@click.option("--temperature", is_flag=True, help="Write /<joint>/temperature at 1 Hz too.")
@options.OVERWRITE
@options.json_option("the true values")
def simulate() -> None:
    """Write a bag of a simulated joint.

    The joint is that of --config; options change single values. It moves in both directions at every speed
    under every torque. Ctrl-C leaves a valid file and ends with code 130. With --overwrite the old bag stays
    until the new one is complete.
    """


@options.verb("topics joint.mcap --urdf arm.urdf")
@options.BAG
@click.option(
    "--urdf",
    type=options.Source(dir_okay=False, path_type=Path),
    help="The robot's description. [default: the bag's own, of a topic robot_description]",
)
@click.option(
    "--config",
    "config_file",
    type=options.Source(dir_okay=False),
    help="ROS parameter file whose ratios are compared with the description's.",
)
@options.JSON
def topics() -> None:
    """List what is in a bag and propose the configuration of its joints.

    Two angles whose speeds have the ratio of a gear, or that look like two encoders of one joint, are
    proposed as input and output. Signals with the joint's name or number are its torque, current or
    temperature. Units are guessed from names and jumps. The first 50 000 messages of each topic are read.
    Transmissions of the robot's description give the ratios; one that the angles or the configuration
    contradict is a warning.
    """

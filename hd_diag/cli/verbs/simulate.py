"""What ``hd-diag simulate`` takes, and its help."""

from __future__ import annotations

import click

from hd_diag.cli import options


@options.verb("simulate --out joint.mcap --eccentricity-um 18")
@options.BAG
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
@click.option("--eccentricity-um", type=float, help="Eccentricity, fixed in the housing [µm].")
@click.option("--direction-deg", type=float, help="Its direction [degrees].")
@click.option("--runout-um", type=float, help="Runout, which turns with the wave generator [µm].")
@click.option("--runout-direction-deg", type=float, help="Its direction at input angle 0 [degrees].")
@click.option("--datum-mm", type=float, help="Datum radius of the circular spline's slots [mm].")
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

"""Options and help of the verbs about a drive."""

from __future__ import annotations

from pathlib import Path

import click

from hd_diag.cli import options
from hd_diag.formatting import ARCSEC


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


@options.verb("figures --out figures --format png")
@click.option(
    "--out", required=True, type=click.Path(file_okay=False, path_type=Path), help="Folder for the files."
)
@options.CONFIG
@options.shown("--format", "svg", "Of the figures.", type=click.Choice(["svg", "png", "pdf"]))
@click.option("--torque", type=click.FLOAT, help="Torque of the loads [N m]. [default: the rated one]")
@click.option("--eccentricities-um", help="Up to six eccentricities [µm], as 0,5,10. [default: the paper's]")
@click.option("--direction-deg", type=click.FLOAT, help="Their angle from the long axis [°]. [default: 90]")
def figures() -> None:
    """Draw the model's counterparts of the paper's Figs. 5 to 7.

    For the first configured joint: the neutral layer's motion, backlash and load over the teeth, one tooth
    over time, for eccentricities from none to 23 µm. figures.md gets captions with the numbers that the
    paper's claims come to. Beside them drive.*: what is eccentric to what, positive directions, where teeth
    interfere.
    """


@options.verb("layout --config arm.yaml --out layouts")
@click.option(
    "--out", required=True, type=click.Path(file_okay=False, path_type=Path), help="Folder for the files."
)
@options.CONFIG
@options.shown("--node", "/hd_diag", "Full name of the node.", type=str)
def layout() -> None:
    """Write layouts of Foxglove and PlotJuggler for the configured joints.

    foxglove_layout.json and plotjuggler_layout.xml show each joint in tabs of its own: errors, residual,
    diagnostics, backlash and load of the teeth. In Foxglove errors are found by the joint's place in the
    configuration: all joints have to come in one message.
    """


_PAGE = {
    "size": "Size on the page: pitch diameter in tenths of an inch.",
    "pitch_diameter": "Pitch diameter [m], in place of the size.",
    "ratio": "Input angle over output angle as the joint reports them, signed.",
    "rated_torque": "Rated torque [N m].",
    "k1": "Torsional stiffness up to T1 [N m/rad].",
    "k2": "Torsional stiffness from T1 to T2 [N m/rad].",
    "k3": "Torsional stiffness from T2 on [N m/rad].",
    "t1": "T1 [N m]. [default: a quarter of the rated torque]",
    "t2": "T2 [N m]. [default: 0.86 of the rated torque]",
    "lost_motion": "Lost motion [arcmin]. [default: none]",
}


@options.verb(
    "gear --size 20 --ratio 160 --rated-torque 40 --k1 16e3 --k2 25e3 --k3 29e3 --t1 7 --t2 25 --out f.yaml"
)
@click.argument("name", required=False)
@options.numbers((name, click.FLOAT, text) for name, text in _PAGE.items())
@click.option("--accuracy", type=float, help="Transmission accuracy [arcmin]. [default: 1.5]")
@options.shown(
    "--output",
    "flexspline",
    "Member that drives the link; the other is fixed.",
    type=click.Choice(["flexspline", "circular_spline"]),
)
@options.shown("--joint", "joint_1", "Name of the joint.")
@click.option("--out", type=options.Target(), help="The file. [default: none; the drive is only shown]")
@options.OVERWRITE
@options.figure_option("the tooth pair")
@options.JSON
def gear() -> None:
    """Write a parameter file for a drive from its catalogue page.

    NAME is a gear of the table in this package: CSG-25-100 is series, size and ratio. No numbers are needed
    then; those that are given beat the table's. A gear that is not in it needs size, ratio, rated torque, K1,
    K2 and K3, better T1 and T2, too.

    Teeth and neutral curve are scaled from the example drive; the place of the slots and the compliances are
    fitted to the page's torsion curve from zero torque on; limits and tolerances are scaled. The file says
    what was given, what is assumed and how well the curve is met. A catalogue gives the ratio with the
    circular spline fixed, for example 100; if the output is the circular spline, the joint's ratio is 101.
    """


@options.verb("mesh --config arm.yaml --joint elbow --torque 14")
@options.CONFIG
@options.JOINT
@options.shown("--input-angle", 0.0, "Reported input angle [rad].")
@options.shown("--torque", 0.0, "Torque M [N m].")
@click.option(
    "--eccentricity-um", type=click.FLOAT, help="Eccentricity [µm], in place of the configured one."
)
@click.option(
    "--direction-deg", type=click.FLOAT, help="Its direction in the housing, and that of a given tilt [°]."
)
@click.option(
    "--tilt-mrad",
    type=click.FLOAT,
    help="Tilt of the wave generator [mrad], in place of the configured one; negative: the other way.",
)
@click.option("--section", type=int, help="Show one section, 1 at the cup's bottom. [default: all together]")
@click.option(
    "--sweep",
    type=click.Choice(["angle", "torque"]),
    help="Instead of one moment: a turn of the wave generator, or torques to twice the rated one both ways.",
)
@click.option("--out", type=options.Target(".csv"), help="Table of the teeth, or of the sweep: *.csv, in SI.")
@options.figure_option("backlash and load of the teeth, or the sweep")
@options.JSON
def mesh() -> None:
    """Show backlash and load of every tooth at one input angle and torque.

    In sections: the least backlash and the whole load of each tooth, or those of one section.
    Torsion and transmission error are shown, too. Torsion and loads are those of a torque M that turns the
    cup counter-clockwise (M > 0 bears on + flanks). The transmission error is the drive's when it exerts M on
    the link, whose reaction on the cup is -M for an output at the flexspline; "as_driven" holds torsion and
    loads of that state, which the node publishes.
    """


_SHARE = click.FloatRange(0.0, 1.0)
LIMITS = {
    "interference_um": ("interference", 1e-6, click.FLOAT, "the overlap of teeth at one lobe [µm]"),
    "overlap_um": ("overlap", 1e-6, click.FLOAT, "the overlap of both lobes, no torque [µm]"),
    "peak_load": ("peak_tooth_load", 1.0, click.FloatRange(0.0), "the force on a flank [N]"),
    "load_concentration": ("load_concentration", 1.0, click.FloatRange(1.0), "largest over mean force [-]"),
    "stiffness_loss": ("stiffness_loss", 1.0, _SHARE, "the share of torsional stiffness lost [-]"),
    "te_arcsec": ("transmission_error", ARCSEC, click.FloatRange(0.0), "the error, peak to peak [arcsec]"),
}
"""Options that replace configured limits: criterion, unit in SI, type and meaning of the value."""


@options.verb("tolerance --config arm.yaml --joint elbow --te-arcsec 20")
@options.CONFIG
@options.JOINT
@click.option(
    "--torque",
    "torques",
    type=float,
    multiple=True,
    help="On the link [N m]; repeatable. [default: the rated torque]",
)
@options.numbers((name, kind, f"Limit on {what}.") for name, (*_, kind, what) in LIMITS.items())
@click.option(
    "--largest-um", type=float, help="Look for limits up to here [µm]. [default: a fifth of the module]"
)
@options.shown("--samples", 500, "Assemblies to draw; 0 = none.", type=click.IntRange(0, 1_000_000))
@options.shown(
    "--sensitivity-samples",
    128,
    "For the Sobol indices, a power of two; 0 = none.",
    type=click.IntRange(0, 1 << 20),
)
@options.shown("--seed", 0, "Of the random assemblies.", type=click.IntRange(0))
@options.shown("--target", 0.95, "Share of assemblies that shall be good [-].", type=_SHARE)
@options.JOBS
@options.JSON
@options.figure_option("the result")
def tolerance() -> None:
    """Compute how much eccentricity, and how much tilt, an assembly may have.

    For every criterion: the smallest eccentricity that exceeds its limit, over all directions and input
    angles. For a drive in sections also the smallest tilt without eccentricity, and a chart of both together
    with the limits of interference and load (--figure, --json). Then random assemblies are drawn from the
    configured tolerances: the share of good ones over the tolerance of the eccentricity, and which tolerance
    matters most. Limits and tolerances are in the section "tolerance" of the configuration; an option
    replaces a limit.
    """

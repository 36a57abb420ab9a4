"""What ``hd-diag gear`` takes, and its help."""

from __future__ import annotations

from typing import Any

import click

from hd_diag.cli import options

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
}
_REQUIRED = ("ratio", "rated_torque", "k1", "k2", "k3")


def _page_options(function: Any) -> Any:
    for name, text in reversed(_PAGE.items()):
        flag = f"--{name.replace('_', '-')}"
        function = click.option(flag, name, type=float, required=name in _REQUIRED, help=text)(function)
    return function


@options.verb(
    "gear --size 20 --ratio 160 --rated-torque 40 --k1 16e3 --k2 25e3 --k3 29e3 --t1 7 --t2 25 --out f.yaml"
)
@_page_options
@click.option("--accuracy", type=float, help="Transmission accuracy [arcmin]. [default: 1.5]")
@options.shown(
    "--output",
    "flexspline",
    "Member that drives the link; the other is fixed.",
    type=click.Choice(["flexspline", "circular_spline"]),
)
@options.shown("--joint", "joint_1", "Name of the joint.")
@click.option("--out", required=True, type=options.Target(), help="The file.")
@click.option("--table", is_flag=True, help="Print the drive's parameters, limits and tolerances.")
@options.figure_option("the tooth pair")
@options.JSON
def gear() -> None:
    """Write a parameter file for a drive from its catalogue page.

    Teeth, neutral curve and clearance are scaled from the example drive; the compliances are fitted to K1, K2
    and K3; limits and tolerances are scaled. The file says what was given, what is assumed and how well K1,
    K2 and K3 are met. A catalogue gives the ratio with the circular spline fixed, for example 100; if the
    output is the circular spline, the joint's ratio is 101.
    """

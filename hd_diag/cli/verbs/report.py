"""What ``hd-diag report`` takes, and its help."""

from __future__ import annotations

import click

from hd_diag.cli import options


@options.verb("report joint.mcap --config arm.yaml --out joint.html")
@options.records
@click.option(
    "--out",
    type=options.PAGE,
    help="Write the page here. [default: the first bag's name with .html]",
)
@options.JSON
def report() -> None:
    """Draw a bag: verdict, what to inspect, measured against simulated, teeth, data.

    Diagnoses the bag as `hd-diag diagnose` does, with the same JSON, and writes one HTML file that needs
    nothing else. Where a bag does not hold the output angle, or its record cannot be judged, it shows the
    model's side of the motion and says so; the JSON then has the reason as "error". Several bags are runs of
    the same joint. A joint of which nothing can be shown is reported on stderr, the others go on, and the
    exit code is 2.
    """

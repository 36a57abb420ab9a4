"""What ``hd-diag report`` takes, and its help."""

from __future__ import annotations

import click

from hd_diag.cli import options


@options.verb("report joint.mcap --config arm.yaml --out joint.html")
@options.records
@options.TIME_LIMIT
@click.option(
    "--out",
    type=options.PAGE,
    help="Write the page here. [default: the first bag's name with .html]",
)
@options.JSON
def report() -> None:
    """Diagnose a bag and write one HTML page: verdict, what to inspect, measured beside simulated, teeth.

    The diagnosis and its JSON are those of `hd-diag diagnose`. The page is one file that needs nothing else.
    If a bag has no output angle, or its record cannot be judged, the page says so and shows what the model
    predicts for the motion; the JSON then has the reason as "error". Several bags are runs of the same joint.
    If nothing of a joint can be shown, stderr says so, the other joints are shown, and the exit code is 2.
    """

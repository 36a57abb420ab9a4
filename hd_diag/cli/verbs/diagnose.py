"""What ``hd-diag diagnose`` takes, and its help."""

from __future__ import annotations

import click

from hd_diag.cli import options


@options.verb("diagnose joint.mcap --config arm.yaml --report joint.html")
@options.records
@options.FAIL_ON_CAUSE
@click.option(
    "--orders-only",
    is_flag=True,
    help="Describe the error by its orders alone, for a gear of which nobody has the geometry: of the "
    "configuration only names, ratio, rated torque and accuracy are used.",
)
@click.option(
    "--model",
    "model_file",
    type=options.Target(),
    help="Write the extended model here, for the parameter <joint>.model_file; of several joints each gets a "
    "file with _<joint> in its name.",
)
@click.option("--report", "report_file", type=options.PAGE, help="Draw it all on one HTML page here.")
@options.JSON
def diagnose() -> None:
    """Show what the simulation gets wrong, name the physical cause and measure the gain.

    The model's own parameters are refitted first; causes are then searched among the catalogue's and named
    only where data that nothing was fitted to confirm them. Several bags are runs of the same joint. "None
    of the known causes" and "this record cannot tell these apart" are answers too. A record too long to be
    fitted is looked through sample by sample for a wrong ratio, steps and outliers; stretches spread over
    all of it are fitted. A joint that cannot be judged, for its signals are wrong or too few, is reported on
    stderr, the others go on, and the exit code is 2.
    """

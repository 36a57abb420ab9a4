"""What ``hd-diag diagnose`` takes, and its help."""

from __future__ import annotations

import click

from hd_diag.cli import options


@options.verb("diagnose joint.mcap --config arm.yaml --report joint.html")
@options.records
@options.TIME_LIMIT
@options.FAIL_ON_CAUSE
@click.option(
    "--orders-only",
    is_flag=True,
    help="Describe the error by its orders alone, for a gear of unknown geometry. Only names, ratio, rated "
    "torque and accuracy of the configuration are used.",
)
@click.option(
    "--model",
    "model_file",
    type=options.Target(),
    help="Write the extended model here, for the parameter <joint>.model_file. With several joints each gets "
    "its own file with _<joint> in the name.",
)
@click.option("--report", "report_file", type=options.PAGE, help="Write the HTML report here.")
@options.JSON
def diagnose() -> None:
    """Find what the model gets wrong in a bag, name the physical cause and measure the gain.

    First the model's own parameters are fitted. Then the catalogue is searched for causes. A cause is named
    only where it also predicts the part of the record that was not used in the fit. "None of the known
    causes" and "this record cannot tell these apart" are possible answers. Several bags are runs of the same
    joint. Of a very long record every sample is checked for a wrong ratio, steps and outliers, and stretches
    from all over it are fitted. If a joint's signals are wrong or too few, stderr says so, the other joints
    are diagnosed, and the exit code is 2.
    """

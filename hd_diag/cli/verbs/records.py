"""Options and help of the verbs about measured joints."""

from __future__ import annotations

from pathlib import Path

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
    """Find what the model gets wrong in a bag, and the physical cause.

    The first line says what to do about the joint, and how sure that is. The model's own parameters are
    fitted first. Then the catalogue is searched for causes. A cause is named only where it also predicts the
    part of the record that was not used in the fit. "None of the known causes" and "this record cannot
    distinguish these" are possible answers. Several bags are runs of the same joint. Of a very long record
    every sample is checked for a wrong ratio, steps and outliers, and stretches from all over it are fitted.
    If a joint's signals are wrong or too few, stderr says so, the other joints are diagnosed, and the exit
    code is 2.
    """


@options.verb("fleet bags/ --config arm.yaml --out arm.parquet")
@click.argument(
    "bags", metavar="BAGS_OR_FOLDERS...", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@options.CONFIG
@options.JOINTS
@click.option("--out", required=True, type=options.Target(".parquet"), help="The table: *.parquet.")
@click.option(
    "--report",
    type=options.PAGE,
    help="Write one HTML page here, one row for each joint with its colour. A page for the last recording of "
    "each joint goes into the folder <name>_joints beside it.",
)
@options.figure_option("the series")
@options.JOBS
@click.option(
    "--memory",
    type=click.FloatRange(min=0.0, min_open=True),
    help="Memory of each process [GiB]; a bag that needs more gets an error. "
    "[default: 90 % of the machine's over the processes]",
)
@options.shown(
    "--bag-timeout",
    1800.0,
    "Time to read a bag, and to diagnose each of its joints [s]; a bag that takes "
    "longer gets an error and is tried again by the next run. 0: no limit.",
    type=click.FloatRange(min=0.0),
    metavar="SECONDS",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Work on the cluster of this Dask scheduler, e.g. tcp://host:8786. Paths are sent, not data: "
    "workers must see the bags under the same paths.",
)
@click.option(
    "--robot",
    metavar="REGEX",
    help="Bags are of several robots; the first group in a bag's path names its robot.",
)
@click.option(
    "--limit",
    "limits",
    multiple=True,
    metavar="QUANTITY=VALUE",
    help="Judge by this, and predict when it is reached: eccentricity [m], transmission_error, "
    "residual_nominal, residual_refit, a cause's amplitude [rad] or a ripple_ORDER [N m]; repeatable. "
    "[default: the joint's accuracy and the eccentricity that hd-diag tolerance allows]",
)
@click.option("--fresh", is_flag=True, help="Ignore the results of earlier runs.")
@options.FAIL_ON_CAUSE
@click.option("--fail-on-change", is_flag=True, help="Exit with code 1 if something steps or drifts.")
@click.option(
    "--fail-on",
    type=click.Choice(("amber", "red")),
    help="Exit with code 1 if a joint is red; with amber also if a joint is not green, or a bag could not be "
    "judged or is cut off.",
)
@options.JSON
def fleet() -> None:
    """Diagnose every joint of many bags and show what changes over time.

    Folders are searched for bags; a folder with a metadata.yaml is one bag. The table has one row for each
    bag and joint, with the result of ``hd-diag diagnose``; a joint that cannot be judged has a row with the
    reason. Each result is saved at once in OUT.journal.jsonl beside the table. The same command therefore
    continues after an interruption, and later judges only new bags.

    Over time are shown: the eccentricity, the residuals and the amplitude of each cause; for a joint with one
    angle, its torque ripple. Steps and drifts are reported with a chance of 5 % for a false alarm in the
    whole run. The colour of a joint comes from its last recording: its transmission error is compared with
    its accuracy, its eccentricity with what the assembly may have. Amber means that the limit is within the
    95 % interval, or that the bag is cut off. Exit code 2 if no bag could be judged, 130 after Ctrl-C.
    """


@options.verb("report joint.mcap --config arm.yaml --out joint.html", "diagnose")
@options.records
@options.TIME_LIMIT
@click.option(
    "--out", type=options.PAGE, help="Write the page here. [default: the first bag's name with .html]"
)
@options.JSON
def report() -> None:
    """Diagnose a bag and write one HTML page.

    It begins with what to do about each joint, as a traffic light. Then come the verdict, what to inspect,
    measured beside simulated, and the teeth. The diagnosis and its JSON are those of `hd-diag diagnose`. The
    page is one file that needs nothing else. If a bag has no output angle, or its record cannot be judged,
    the page says so and shows what the model predicts for the motion; the JSON then has the reason as
    "error". Several bags are runs of the same joint. If nothing of a joint can be shown, stderr says so, the
    other joints are shown, and the exit code is 2.
    """


@options.verb("ripple joint.mcap --config arm.yaml", "diagnose")
@options.records
@options.JSON
def ripple() -> None:
    """Find periodic torque ripple at the gear's orders, for robots that report one angle for each joint.

    With one angle and a torque or a current, neither the transmission error nor an eccentricity can be
    measured; a periodic ripple of the torque can. Friction, gravity and inertia are removed as smooth parts.
    A line is reported only if it has the same phase in all stretches of the motion and is larger than the
    orders beside it. Several bags are recordings of the same joint. If a joint cannot be judged, stderr says
    so, the other joints are judged, and the exit code is 2.
    """

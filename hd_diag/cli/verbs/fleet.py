"""What ``hd-diag fleet`` takes, and its help."""

from __future__ import annotations

from pathlib import Path

import click

from hd_diag.cli import options


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
    help="Write one HTML page here, a row a joint with its colour; pages of the joints' last recordings go "
    "into the folder <name>_joints beside it.",
)
@options.figure_option("the series")
@options.JOBS
@click.option(
    "--memory",
    type=click.FloatRange(min=0.0, min_open=True),
    help="What each process may have [GiB]; a bag that needs more gets an error. "
    "[default: 90 % of the machine's over the processes]",
)
@options.shown(
    "--bag-timeout",
    1800.0,
    "What may be spent on looking at a bag, and on diagnosing each of its joints [s]; a bag that takes "
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
@click.option("--fresh", is_flag=True, help="Forget what earlier runs have kept.")
@options.FAIL_ON_CAUSE
@click.option("--fail-on-change", is_flag=True, help="Exit with 1 where something steps or drifts.")
@click.option(
    "--fail-on",
    type=click.Choice(("amber", "red")),
    help="Exit with 1 where a joint is red; with amber also where one is not green, or a bag could not be "
    "judged or was cut off.",
)
@options.JSON
def fleet() -> None:
    """Diagnose every joint of every bag, in parallel, and report what changes over time.

    Folders are searched for bags; a folder with a metadata.yaml is one. The table has one row for each bag
    and joint, as ``hd-diag diagnose`` judges it alone; what cannot be judged has a row that says why. Each
    result is kept beside the table in OUT.journal.jsonl as soon as it is there: the same command goes on
    after an interruption, and later judges new bags only. Series over time are eccentricity, residuals and
    the amplitude of each cause, of a joint with one angle those of its torque's ripple; steps and drifts are
    reported with a chance of false alarm of 5 % for the whole run. Each joint is green, amber, red or not
    judged by its last recording: its transmission error beside its accuracy, its eccentricity beside what the
    assembly may have; amber where the 95 % interval holds the limit, or the bag is cut off. Exit code 2 where
    no bag could be judged, 130 after Ctrl-C.
    """

"""``hd-diag report``: a bag on a page, judged where its output was measured."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hd_diag.cli.options import CONFIG, JOINTS, JSON, Problem, chosen_joints, configured, verb
from hd_diag.cli.record import (
    BAGS,
    COLUMNS,
    DIVIDED,
    Unjudged,
    check_targets,
    diagnosed,
    not_judged,
    telling,
    write_diagnoses,
)
from hd_diag.config.configuration import Config, JointConfig
from hd_diag.diagnosis.record import RecordError

if TYPE_CHECKING:  # scipy and matplotlib are slow to import: only where they are used
    from hd_diag.diagnosis.diagnosis import Diagnosis
    from hd_diag.report.facts import JointReport


@verb("report joint.mcap --config arm.yaml --out joint.html")
@BAGS
@CONFIG
@JOINTS
@COLUMNS
@DIVIDED
@click.option(
    "--out",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write the page here. [default: the first bag's name with .html]",
)
@JSON
def report(
    bags: tuple[Path, ...],
    config_file: str | None,
    names: tuple[str, ...],
    columns: str | None,
    input_divided: bool,
    out: Path | None,
    json_file: str | None,
) -> None:
    """Draw a bag: verdict, what to inspect, measured against simulated, teeth, data.

    Diagnoses the bag as `hd-diag diagnose` does, with the same JSON, and writes one HTML file that needs
    nothing else. Where a bag does not hold the output angle, or its record cannot be judged, it shows the
    model's side of the motion and says so; the JSON then has the reason as "error". Several bags are runs of
    the same joint. A joint of which nothing can be shown is told on stderr, the others go on, and the exit
    code is 2.
    """
    config = configured(config_file)
    target = out or Path(f"{bags[0].stem}.html")
    check_targets(bags, target, json_file)
    reports, results = [], []
    chosen = chosen_joints(config, names)
    unjudged = Unjudged(len(chosen))
    for joint in chosen:
        try:
            with telling(joint.name) as progress:
                page, result = _of_joint(bags, joint, config, columns, input_divided, progress)
        except RecordError as error:
            results.append(unjudged.told(joint.name, error))
            continue
        reports.append(page)
        results.append(result)
        if json_file != "-":
            click.echo(f"{joint.name}: {page.verdict}")
    if reports:
        write_report(target, reports, bags)
        click.echo(f"report written: {target}", err=json_file == "-")
    if json_file:
        write_diagnoses(json_file, results)
    sys.exit(unjudged.code())


def _of_joint(
    bags: Sequence[Path],
    joint: JointConfig,
    config: Config,
    columns: str | None,
    divided: bool,
    progress: Callable[[str], None],
) -> tuple[JointReport, dict[str, Any]]:
    """A joint's part of the page, and its JSON."""
    from hd_diag.bag.joint_record import read_motion
    from hd_diag.diagnosis.verdict import as_json
    from hd_diag.report.facts import of_motion

    try:
        found = diagnosed(bags, joint, columns, divided, progress)
    except RecordError as error:
        motion = read_motion(bags, joint) if columns is None else None
        if motion is None:
            raise
        return of_motion(motion, joint, config.flat, str(error)), not_judged(joint.name, error)
    progress("gathering the report's numbers")
    return joint_report(found, joint, config), as_json(found, joint.name)


def joint_report(found: Diagnosis, joint: JointConfig, config: Config) -> JointReport:
    """A joint's part of a page, out of its diagnosis."""
    from hd_diag.report.facts import of_diagnosis

    return of_diagnosis(found, joint, config.flat)


def write_report(target: Path, reports: Sequence[JointReport], bags: Sequence[Path]) -> None:
    """Write a page, told where it came from.

    Raises
    ------
    Problem
        If the file cannot be written.
    """
    from hd_diag.diagnosis.verdict import digests
    from hd_diag.report.page import write_page
    from hd_diag.report.quality import Fact

    sources = [
        Fact(f"{bag.resolve().name}/{name}" if bag.is_dir() else name, f"SHA-256 {digest}")
        for bag in bags
        for name, digest in digests(bag).items()
    ]
    try:
        write_page(target, reports, sources)
    except OSError as error:
        raise Problem(f"{target}: cannot be written: {error.strerror}") from error

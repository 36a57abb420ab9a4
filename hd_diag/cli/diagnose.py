"""``hd-diag diagnose``: measured against simulated, the cause, the gain."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from hd_diag.cli.options import CONFIG, JOINTS, JSON, chosen_joints, configured, verb
from hd_diag.cli.record import (
    BAGS,
    COLUMNS,
    DIVIDED,
    Unjudged,
    check_targets,
    diagnosed,
    telling,
    write_diagnoses,
)
from hd_diag.cli.report import joint_report, write_report
from hd_diag.config.configuration import Config, JointConfig
from hd_diag.config.model_file import write
from hd_diag.config.parameters import JOINT_PARAMETERS
from hd_diag.diagnosis.record import RecordError


@verb("diagnose joint.mcap --config arm.yaml --report joint.html")
@BAGS
@CONFIG
@JOINTS
@COLUMNS
@DIVIDED
@click.option(
    "--fail-on-cause", is_flag=True, help="Exit with 1 where a cause or something unexplained is found."
)
@click.option(
    "--model",
    "model_file",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write the extended model here, for the parameter <joint>.model_file; of several joints each gets a "
    "file with _<joint> in its name.",
)
@click.option(
    "--report",
    "report_file",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Draw it all on one HTML page here.",
)
@JSON
def diagnose(
    bags: tuple[Path, ...],
    config_file: str | None,
    names: tuple[str, ...],
    columns: str | None,
    input_divided: bool,
    fail_on_cause: bool,
    model_file: Path | None,
    report_file: Path | None,
    json_file: str | None,
) -> None:
    """Show what the simulation gets wrong, name the physical cause and measure the gain.

    The model's own parameters are refitted first; causes are then searched among the catalogue's and named
    only where data that nothing was fitted to confirm them. Several bags are runs of the same joint. "None
    of the known causes" and "this record cannot tell these apart" are answers too. A record too long to be
    fitted is looked through sample by sample for a wrong ratio, steps and outliers; stretches spread over
    all of it are fitted. A joint that cannot be judged is told on stderr, the others go on, and the exit code
    is 2.
    """
    config = configured(config_file)
    check_targets(bags, model_file, report_file, json_file)
    results, pages = [], []
    chosen = chosen_joints(config, names)
    unjudged = Unjudged(len(chosen))
    for joint in chosen:
        path = model_file
        if path is not None and len(chosen) > 1:
            path = path.with_name(f"{path.stem}_{joint.name}{path.suffix}")
        try:
            result = _one(bags, joint, config, columns, input_divided, path)
        except RecordError as error:
            results.append(unjudged.told(joint.name, error))
            continue
        results.append(result)
        found, lines = result.pop("diagnosis"), result.pop("lines")
        if report_file is not None:
            pages.append(joint_report(found, joint, config))
        if json_file != "-":
            for line in lines:
                click.echo(f"{joint.name}: {line}")
        del found  # its arrays, before the next joint's
    if report_file is not None and pages:
        write_report(report_file, pages, bags)
        click.echo(f"report written: {report_file}", err=json_file == "-")
    if json_file:
        write_diagnoses(json_file, results)
    named = any(result.get("causes") or result.get("unexplained") for result in results)
    sys.exit(unjudged.code(1 if fail_on_cause and named else 0))


def _one(
    bags: tuple[Path, ...],
    joint: JointConfig,
    config: Config,
    columns: str | None,
    divided: bool,
    model_file: Path | None,
) -> dict[str, Any]:
    from hd_diag.diagnosis.verdict import as_json, model_document, summary

    with telling(joint.name) as progress:
        result = diagnosed(bags, joint, columns, divided, progress)
    lines, written = summary(result), None
    if model_file is not None and result.model is None:
        lines.append("no model was written: the record does not allow one")
    elif model_file is not None:
        own = {p.name: config.flat[f"{joint.name}.{p.name}"] for p in JOINT_PARAMETERS}
        write(model_file, model_document(result, joint.name, own, bags))
        written = str(model_file)
        lines.append(f"model written: {written}")
    return {**as_json(result, joint.name, written), "lines": lines, "diagnosis": result}

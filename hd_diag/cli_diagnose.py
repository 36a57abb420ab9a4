"""``hd-diag diagnose``: measured against simulated, the cause, the gain."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click
from rich.console import Console

from hd_diag.cli_options import CONFIG, JSON, Problem, chosen_joints, configured, problems, write_json
from hd_diag.cli_report import check_folder, joint_report, write_report
from hd_diag.config import JOINT_PARAMETERS, Config, JointConfig
from hd_diag.criticism.record import Record, RecordError
from hd_diag.model_file import write


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("bags", nargs=-1, required=True, type=click.Path(path_type=Path))
@CONFIG
@click.option("--joint", "names", multiple=True, help="Joint; repeatable. [default: all configured]")
@click.option(
    "--columns",
    "columns",
    metavar="time=T,input=I,output=O[,torque=M,temperature=C,record=R]",
    help="The BAG is a CSV file with these columns [s, rad, rad, N m, degree Celsius].",
)
@click.option(
    "--input-divided", is_flag=True, help="In a CSV file the input angle is already divided by the ratio."
)
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
    help="Draw it all on one HTML page.",
)
@JSON
@problems
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
    all of it are fitted.
    """
    config = configured(config_file)
    if model_file is not None and not model_file.parent.is_dir():
        raise Problem(f"{model_file}: cannot be written: no such folder")
    if report_file is not None:
        check_folder(report_file)
    results, pages = [], []
    chosen = chosen_joints(config, names)
    for joint in chosen:
        path = model_file
        if path is not None and len(chosen) > 1:
            path = path.with_name(f"{path.stem}_{joint.name}{path.suffix}")
        result = _one(bags, joint, config, columns, input_divided, path)
        results.append(result)
        found = result.pop("diagnosis")
        if report_file is not None:
            pages.append(joint_report(found, joint, config))
        if json_file != "-":
            for line in result["lines"]:
                click.echo(f"{joint.name}: {line}")
        del found  # its arrays, before the next joint's
    if report_file is not None:
        write_report(report_file, pages, bags)
        click.echo(f"report written: {report_file}", err=json_file == "-")
    if json_file:
        plain = [{key: value for key, value in result.items() if key != "lines"} for result in results]
        write_json(
            json_file, plain[0] if len(plain) == 1 else {"schema": "hd_diag/diagnoses/1", "joints": plain}
        )
    named = any(result["causes"] or result["unexplained"] for result in results)
    sys.exit(1 if fail_on_cause and named else 0)


def _one(
    bags: tuple[Path, ...],
    joint: JointConfig,
    config: Config,
    columns: str | None,
    divided: bool,
    model_file: Path | None,
) -> dict[str, Any]:
    from hd_diag.criticism.diagnosis import diagnose as criticise
    from hd_diag.criticism.screening import screened
    from hd_diag.verdict import as_json, model_document, summary

    console = Console(stderr=True)
    try:
        if console.is_terminal:
            with console.status(f"{joint.name}: reading") as status:
                looked = screened(_record(bags, joint, columns, divided), joint.configured)
                result = criticise(
                    looked, joint.configured, lambda text: status.update(f"{joint.name}: {text}")
                )
        else:
            looked = screened(_record(bags, joint, columns, divided), joint.configured)
            result = criticise(looked, joint.configured)
    except RecordError as error:
        raise Problem(f"{joint.name}: {error}") from error
    lines, written = summary(result), None
    if model_file is not None and result.model is None:
        lines.append("no model was written: the record does not allow one")
    elif model_file is not None:
        own = {p.name: config.flat[f"{joint.name}.{p.name}"] for p in JOINT_PARAMETERS}
        write(model_file, model_document(result, joint.name, own, bags))
        written = str(model_file)
        lines.append(f"model written: {written}")
    return {**as_json(result, joint.name, written), "lines": lines, "diagnosis": result}


def _record(bags: tuple[Path, ...], joint: JointConfig, columns: str | None, divided: bool) -> Record:
    from hd_diag.recording import read_bags, read_table

    if columns is None:
        return read_bags(bags, joint)
    pairs = [item.split("=", 1) for item in columns.split(",")]
    if any(len(pair) != 2 for pair in pairs):
        raise Problem("--columns takes pairs like time=t,input=motor_position,output=joint_position")
    if len(bags) > 1:
        raise Problem("only one CSV file at a time")
    return read_table(bags[0], {key.strip(): name.strip() for key, name in pairs}, joint, divided)

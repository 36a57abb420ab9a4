"""``hd-diag diagnose``: measured against simulated, the cause, the gain."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click
from rich.console import Console

from hd_diag.cli_options import CONFIG, JSON, Problem, configured, problems, write_json
from hd_diag.config import Config, JointConfig
from hd_diag.criticism.record import Record, RecordError


@click.command()
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
@JSON
@problems
def diagnose(
    bags: tuple[Path, ...],
    config_file: str | None,
    names: tuple[str, ...],
    columns: str | None,
    input_divided: bool,
    fail_on_cause: bool,
    json_file: str | None,
) -> None:
    """Show what the simulation gets wrong, name the physical cause and measure the gain.

    The model's own parameters are refitted first; causes are then searched among the catalogue's and named
    only where data that nothing was fitted to confirm them. Several bags are runs of the same joint. "None
    of the known causes" and "this record cannot tell these apart" are answers too.
    """
    config = configured(config_file)
    results = []
    for joint in _chosen(config, names):
        result = _one(bags, joint, columns, input_divided)
        results.append(result)
        if json_file != "-":
            for line in result["lines"]:
                click.echo(f"{joint.name}: {line}")
    if json_file:
        plain = [{key: value for key, value in result.items() if key != "lines"} for result in results]
        write_json(
            json_file, plain[0] if len(plain) == 1 else {"schema": "hd_diag/diagnoses/1", "joints": plain}
        )
    found = any(result["causes"] or result["unexplained"] for result in results)
    sys.exit(1 if fail_on_cause and found else 0)


def _chosen(config: Config, names: tuple[str, ...]) -> list[JointConfig]:
    known = {joint.name: joint for joint in config.joints}
    for name in names:
        if name not in known:
            raise Problem(f"no joint {name!r} in the configuration; it has {', '.join(known)}")
    return [known[name] for name in names] or list(config.joints)


def _one(bags: tuple[Path, ...], joint: JointConfig, columns: str | None, divided: bool) -> dict[str, Any]:
    from hd_diag.criticism.diagnosis import diagnose as criticise
    from hd_diag.verdict import as_json, summary

    console = Console(stderr=True)
    try:
        if console.is_terminal:
            with console.status(f"{joint.name}: reading") as status:
                record = _record(bags, joint, columns, divided)
                result = criticise(record, joint.drive, lambda text: status.update(f"{joint.name}: {text}"))
        else:
            result = criticise(_record(bags, joint, columns, divided), joint.drive)
    except RecordError as error:
        raise Problem(f"{joint.name}: {error}") from error
    return {**as_json(result, joint.name), "lines": summary(result)}


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

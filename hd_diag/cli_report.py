"""``hd-diag report``: a bag on a page, judged where its output was measured."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.console import Console

from hd_diag.cli_options import CONFIG, Problem, chosen_joints, configured, problems
from hd_diag.config import Config, JointConfig
from hd_diag.criticism.record import RecordError

if TYPE_CHECKING:  # scipy and matplotlib are slow to import: only where they are used
    from hd_diag.criticism.diagnosis import Diagnosis
    from hd_diag.report import JointReport


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("bags", nargs=-1, required=True, type=click.Path(path_type=Path))
@CONFIG
@click.option("--joint", "names", multiple=True, help="Joint; repeatable. [default: all configured]")
@click.option(
    "--out",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write the page here. [default: the first bag's name with .html]",
)
@problems
def report(bags: tuple[Path, ...], config_file: str | None, names: tuple[str, ...], out: Path | None) -> None:
    """Draw a bag: verdict, what to inspect, measured against simulated, teeth, data.

    Diagnoses the bag as `hd-diag diagnose` does and writes one HTML file that needs nothing else. Where the
    output angle was not measured, or the record cannot be judged, it shows the model's side of the motion and
    says so. Several bags are runs of the same joint.
    """
    config = configured(config_file)
    target = out or Path(f"{bags[0].stem}.html")
    check_folder(target)
    reports = []
    for joint in chosen_joints(config, names):
        with _telling(joint.name) as progress:
            reports.append(_of_joint(bags, joint, config, progress))
        click.echo(f"{joint.name}: {reports[-1].verdict}")
    write_report(target, reports, bags)
    click.echo(f"report written: {target}")


@contextmanager
def _telling(joint: str) -> Iterator[Callable[[str], None]]:
    """Says on a terminal what is being done."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda text: None
        return
    with console.status(f"{joint}: reading") as status:
        yield lambda text: status.update(f"{joint}: {text}")


def _of_joint(
    bags: Sequence[Path], joint: JointConfig, config: Config, progress: Callable[[str], None]
) -> JointReport:
    from hd_diag.criticism.diagnosis import diagnose
    from hd_diag.criticism.screening import screened
    from hd_diag.recording import read_bags, read_motion
    from hd_diag.report import of_motion

    try:
        found = diagnose(screened(read_bags(bags, joint), joint.configured), joint.configured, progress)
    except RecordError as error:
        motion = read_motion(bags, joint)
        if motion is None:
            raise Problem(f"{joint.name}: {error}") from error
        return of_motion(motion, joint, config.flat, str(error))
    progress("gathering the report's numbers")
    return joint_report(found, joint, config)


def check_folder(target: Path) -> None:
    """Refuse a page that could not be written, before the work."""
    if not target.absolute().parent.is_dir():
        raise Problem(f"{target}: cannot be written: no such folder")


def joint_report(found: Diagnosis, joint: JointConfig, config: Config) -> JointReport:
    """A joint's part of a page, out of its diagnosis."""
    from hd_diag.report import of_diagnosis

    return of_diagnosis(found, joint, config.flat)


def write_report(target: Path, reports: Sequence[JointReport], bags: Sequence[Path]) -> None:
    """Write a page, told where it came from.

    Raises
    ------
    Problem
        If the file cannot be written.
    """
    from hd_diag.report_page import write_page
    from hd_diag.report_quality import Fact
    from hd_diag.verdict import digests

    sources = [Fact(name, f"SHA-256 {digest}") for bag in bags for name, digest in digests(bag).items()]
    try:
        write_page(target, reports, sources)
    except OSError as error:
        raise Problem(f"{target}: cannot be written: {error.strerror}") from error

"""What ``hd-diag diagnose`` and ``hd-diag report`` share: which records, their diagnosis, its JSON."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from rich.console import Console

from hd_diag.cli.options import Problem, check_target, write_json
from hd_diag.config.configuration import JointConfig

if TYPE_CHECKING:  # scipy is slow to import: only where it is used
    from hd_diag.diagnosis.diagnosis import Diagnosis
    from hd_diag.diagnosis.record import Record

BAGS = click.argument("bags", nargs=-1, required=True, type=click.Path(path_type=Path))
COLUMNS = click.option(
    "--columns",
    metavar="time=T,input=I,output=O[,torque=M,temperature=C,record=R]",
    help="The BAG is a CSV file with these columns [s, rad, rad, N m, degree Celsius].",
)
DIVIDED = click.option(
    "--input-divided", is_flag=True, help="In a CSV file the input angle is already divided by the ratio."
)


@contextmanager
def telling(joint: str) -> Iterator[Callable[[str], None]]:
    """What says on a terminal, and only there, what is being done."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda text: None
        return
    with console.status(f"{joint}: reading") as status:
        yield lambda text: status.update(f"{joint}: {text}")


def diagnosed(
    bags: Sequence[Path],
    joint: JointConfig,
    columns: str | None,
    divided: bool,
    progress: Callable[[str], None],
) -> Diagnosis:
    """Diagnosis of a joint of bags, or of a CSV file where columns are given.

    Raises
    ------
    Problem
        Where the columns are not named as they must be.
    BagError, RecordError
        Where there is nothing that can be judged.
    """
    from hd_diag.diagnosis.diagnosis import diagnose
    from hd_diag.diagnosis.screening import screened

    # No name for the record: it goes as soon as it was looked through.
    looked = screened(_record(bags, joint, columns, divided), joint.configured)
    return diagnose(looked, joint.configured, progress)


def _record(bags: Sequence[Path], joint: JointConfig, columns: str | None, divided: bool) -> Record:
    from hd_diag.bag.joint_record import read_bags, read_table

    if columns is None:
        return read_bags(bags, joint)
    pairs = [item.split("=", 1) for item in columns.split(",")]
    if any(len(pair) != 2 for pair in pairs):
        raise Problem("--columns takes pairs like time=t,input=motor_position,output=joint_position")
    if len(bags) > 1:
        raise Problem("only one CSV file at a time")
    return read_table(bags[0], {key.strip(): name.strip() for key, name in pairs}, joint, divided)


class Unjudged:
    """Joints of a run that cannot be judged: told on stderr, the others go on, and the exit code is 2.

    The only joint that is asked for ends the run instead.

    Parameters
    ----------
    asked : int
        Number of joints.
    """

    def __init__(self, asked: int) -> None:
        self._asked = asked
        self.joints: list[str] = []

    def told(self, joint: str, error: Exception) -> dict[str, Any]:
        """What the JSON has of such a joint.

        Raises
        ------
        Problem
            Where no other joint is asked for.
        """
        if self._asked == 1:
            raise Problem(f"{joint}: {error}") from error
        self.joints.append(joint)
        click.echo(f"hd-diag: {joint}: not judged: {' '.join(str(error).split())}", err=True)
        return not_judged(joint, error)

    def code(self, otherwise: int = 0) -> int:
        """Exit code."""
        return Problem.exit_code if self.joints else otherwise


def not_judged(joint: str, error: Exception) -> dict[str, Any]:
    """JSON of a joint whose record cannot be judged."""
    return {"schema": "hd_diag/not_judged/1", "joint": joint, "error": str(error)}


def check_targets(bags: Sequence[Path], *targets: Path | str | None) -> None:
    """Refuse before the work what could not be written, or would overwrite a bag or another result."""
    wanted = [target for target in targets if target is not None]
    for target in wanted:
        check_target(target, *bags)
    if len({os.path.realpath(target) for target in wanted}) < len(wanted):
        raise Problem(f"{' and '.join(map(str, wanted))} must be different files")


def write_diagnoses(path: str, joints: Sequence[Mapping[str, Any]]) -> None:
    """Write the diagnosis of one joint, or a list of several, as JSON."""
    several = {"schema": "hd_diag/diagnoses/1", "joints": list(joints)}
    write_json(path, joints[0] if len(joints) == 1 else several)

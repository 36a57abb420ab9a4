"""What the verbs of the command line share: options, one-line errors, JSON."""

from __future__ import annotations

import functools
import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import click

from hd_diag.bag import BagError, check_output
from hd_diag.config.configuration import Config, ConfigError, JointConfig, load, resolve
from hd_diag.effects import Catalogue
from hd_diag.formatting import json_ready, visible

_Command = TypeVar("_Command", bound=Callable[..., Any])

_LONGEST_LINE = 2000
_FIGURES = (".png", ".svg", ".pdf")


class Problem(click.ClickException):
    """Bad input: one line on stderr, exit code 2."""

    exit_code = 2

    def format_message(self) -> str:
        """The message as one line that a terminal can show."""
        return visible(" ".join(self.message.split()), _LONGEST_LINE)

    def show(self, file: Any = None) -> None:
        """Print the line."""
        click.echo(f"hd-diag: {self.format_message()}", file=file or sys.stderr)


def tell(line: str, *, err: bool = False) -> None:
    """Print one line of which some may come from a file."""
    click.echo(visible(line, _LONGEST_LINE), err=err)


def verb(example: str, **settings: Any) -> Callable[[Callable[..., Any]], click.Command]:
    """A function as a verb: help with an example, bad input in one line; settings are of click's context."""

    def made(function: Callable[..., Any]) -> click.Command:
        @functools.wraps(function)
        def run(*args: Any, **kwargs: Any) -> Any:
            try:
                return function(*args, **kwargs)
            except (ConfigError, BagError) as error:
                raise Problem(str(error)) from error

        return click.command(epilog=f"\b\nExample: hd-diag {example}", context_settings=settings)(run)

    return made


def shown(flag: str, default: Any, text: str, **more: Any) -> Callable[[_Command], _Command]:
    """An option whose default the help shows."""
    return click.option(flag, default=default, show_default=True, help=text, **more)


def check_writable(context: click.Context, parameter: click.Parameter, value: Any) -> Any:
    """Refuse before the work a file that could not be written after it."""
    check_targets((value,))
    return value


def json_option(what: str) -> Callable[[_Command], _Command]:
    """Option ``--json`` for a verb that writes this there."""
    kind = click.Path(dir_okay=False, allow_dash=True)
    return click.option(
        "--json", "json_file", type=kind, callback=check_writable, help=f"Write {what} here; - is stdout."
    )


def _check_figure(context: click.Context, parameter: click.Parameter, path: Path | None) -> Path | None:
    """Refuse before the work what cannot be drawn after it."""
    if path is not None and path.suffix.lower() not in _FIGURES:
        raise Problem(f"{path}: a figure ends with {', '.join(_FIGURES)}")
    return check_writable(context, parameter, path)  # type: ignore[no-any-return]


def figure_option(what: str) -> Callable[[_Command], _Command]:
    """Option ``--figure`` for a verb that draws this."""
    text = f"Draw {what}: *.png, *.svg or *.pdf."
    return click.option("--figure", type=FILE, callback=_check_figure, help=text)


FILE = click.Path(dir_okay=False, path_type=Path)
CONFIG = click.option(
    "--config",
    "config_file",
    type=click.Path(dir_okay=False),
    help="ROS parameter file. [default: the example drive]",
)
JOINT = click.option("--joint", help="Joint. [default: the first configured]")
JOINTS = click.option("--joint", "names", multiple=True, help="Joint; repeatable. [default: all configured]")
BAG = click.option(
    "--out", required=True, type=click.Path(path_type=Path), help="*.mcap or a rosbag2 folder."
)
OVERWRITE = click.option("--overwrite", is_flag=True, help="Replace the output where it exists.")
JOBS = click.option(
    "--jobs", type=click.IntRange(1), help="Processes on this machine. [default: one per core that is free]"
)
FAIL_ON_CAUSE = click.option(
    "--fail-on-cause", is_flag=True, help="Exit with 1 where a cause or something unexplained is found."
)
JSON = json_option("the result")


def configured(config_file: str | None, catalogue: Catalogue | None = None) -> Config:
    """The configuration of a file, or the example drive's; its model files hold effects of the catalogue."""
    return load(config_file, catalogue) if config_file else resolve({}, catalogue=catalogue)


def chosen_joint(config: Config, name: str | None) -> JointConfig:
    """The joint of this name, or the first."""
    return chosen_joints(config, () if name is None else (name,))[0]


def chosen_joints(config: Config, names: tuple[str, ...]) -> list[JointConfig]:
    """The joints of these names, or all."""
    known = {joint.name: joint for joint in config.joints}
    for name in names:
        if name not in known:
            raise Problem(f"no joint {name!r} in the configuration; it has {', '.join(known)}")
    return [known[name] for name in names] or list(config.joints)


def check_targets(targets: Iterable[str | Path | None], *inputs: Path) -> None:
    """Refuse before the work files that could not be written, would overwrite each other or an input."""
    wanted = [Path(target) for target in targets if target not in (None, "-")]
    if len(set(map(os.path.realpath, wanted))) < len(wanted):
        raise Problem(f"{' and '.join(map(str, wanted))} must be different files")
    for target in wanted:
        folder = target.absolute().parent
        if not folder.is_dir():
            raise Problem(f"{target}: cannot be written: no such folder")
        if not os.access(target if target.exists() else folder, os.W_OK):
            raise Problem(f"{target}: cannot be written: no permission, or a disk that is read-only")
        # What does not exist, like links in a circle, is reported when it is read.
        check_output(target, *filter(os.path.exists, inputs))


@contextmanager
def writing(path: str | Path) -> Iterator[Path]:
    """Where to write a file, put in place when it is whole; pipes, devices and links are written to."""
    target = Path(path)
    plain = not os.path.lexists(target) or (target.is_file() and not target.is_symlink())
    beside = plain and os.access(target.parent, os.W_OK)
    place = target.with_name(f".part.{target.name}") if beside else target
    try:
        yield place
        os.replace(place, target)
    except OSError as error:
        raise Problem(f"{path}: cannot be written: {error.strerror}") from error
    finally:
        if beside:
            place.unlink(missing_ok=True)


@contextmanager
def needing_ros(what: str) -> Iterator[None]:
    """Imports inside are of ROS."""
    try:
        yield
    except ImportError as error:
        raise Problem(f"{what} needs ROS 2 Jazzy (rclpy), which is not to be imported: {error}") from error


def write_json(path: str, result: Any) -> None:
    """Write a result as JSON; numbers that are not finite become null."""
    text = json.dumps(json_ready(result), indent=1, allow_nan=False)
    if path == "-":
        click.echo(text)
        return
    with writing(path) as place:
        place.write_text(text + "\n", encoding="utf-8")

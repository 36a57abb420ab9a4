"""What the verbs of the command line share: options, one-line errors, JSON."""

from __future__ import annotations

import functools
import json
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from hd_diag.bag import BagError, check_output
from hd_diag.config import Config, ConfigError, JointConfig, load, resolve
from hd_diag.demo.process import DemoError

SIGNALLED = 128
"""Plus the number of a signal: exit code of what it has ended, as shells have it."""

INTERRUPTED = SIGNALLED + signal.SIGINT
"""Exit code after Ctrl-C."""


class Problem(click.ClickException):
    """Bad input: one line on stderr, exit code 2."""

    exit_code = 2

    def show(self, file: Any = None) -> None:
        """Print the line."""
        click.echo(f"hd-diag: {' '.join(self.message.split())}", file=file or sys.stderr)


def problems(command: Callable[..., Any]) -> Callable[..., Any]:
    """The command, with input that cannot be used told in one line."""

    @functools.wraps(command)
    def run(*args: Any, **kwargs: Any) -> Any:
        try:
            return command(*args, **kwargs)
        except (ConfigError, BagError, DemoError) as error:
            raise Problem(str(error)) from error

    return run


CONFIG = click.option(
    "--config",
    "config_file",
    type=click.Path(dir_okay=False),
    help="ROS parameter file. [default: the example drive]",
)
JOINT = click.option("--joint", help="Joint. [default: the first configured]")
JOINTS = click.option("--joint", "names", multiple=True, help="Joint; repeatable. [default: all configured]")
JSON = click.option(
    "--json",
    "json_file",
    type=click.Path(dir_okay=False, allow_dash=True),
    help="Write the result here; - is stdout.",
)


def configured(config_file: str | None) -> Config:
    """The configuration of a file, or the example drive's."""
    return load(config_file) if config_file else resolve({})


def chosen_joints(config: Config, names: tuple[str, ...]) -> list[JointConfig]:
    """The joints of these names, or all."""
    known = {joint.name: joint for joint in config.joints}
    for name in names:
        if name not in known:
            raise Problem(f"no joint {name!r} in the configuration; it has {', '.join(known)}")
    return [known[name] for name in names] or list(config.joints)


def check_target(path: str | Path, *inputs: Path) -> None:
    """Refuse before the work a file that could not be written, or that would overwrite an input; - is stdout.

    Raises
    ------
    Problem, BagError
        Where there is no such folder; where it is an input, or a part of one.
    """
    if path == "-":
        return
    if not Path(path).absolute().parent.is_dir():
        raise Problem(f"{path}: cannot be written: no such folder")
    # What does not exist, like links in a circle, is told when it is read.
    check_output(path, *filter(os.path.exists, inputs))


def write_json(path: str, result: Any) -> None:
    """Write a result as JSON; numbers that are not finite become null."""
    text = json.dumps(result, indent=1, allow_nan=False)
    if path == "-":
        click.echo(text)
        return
    try:
        Path(path).write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        raise Problem(f"{path}: cannot be written: {error.strerror}") from error

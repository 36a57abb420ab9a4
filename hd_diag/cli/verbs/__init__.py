"""The verbs of the command line: what each takes, and its help.

The work of a verb is in a module of its own that is imported when the verb is called. Exit codes: 0 done, 1 a
finding to fail on, 2 bad usage or input, 130 after Ctrl-C.
"""

from __future__ import annotations

import difflib
import errno
import os
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

import click

import hd_diag
from hd_diag.cli import options
from hd_diag.cli.lines import discard_output, tell
from hd_diag.cli.targets import Problem
from hd_diag.cli.verbs import bags, drives, records, ros
from hd_diag.memory import is_memory
from hd_diag.ros.stop_signals import signalled

FAULT = "an error of hd-diag itself"
"""Words for an unexpected error."""

_TRACEBACK = "HD_DIAG_TRACEBACK"  # environment variable: unexpected errors are raised
_LONGEST_NAME = 200  # characters of a file's name that are shown


class _Verbs(click.Group):
    """A group that reports errors in one line on stderr."""

    def resolve_command(self, context: click.Context, words: list[str]) -> Any:
        try:
            return super().resolve_command(context, words)
        except click.UsageError as error:
            near = difflib.get_close_matches(words[0], self.commands, 1)
            advice = f"Did you mean '{near[0]}'?" if near else "'hd-diag --help' lists them."
            raise click.UsageError(f"{error.message} {advice}", context) from error

    def make_context(self, *args: Any, **kwargs: Any) -> click.Context:
        with _checked_output():
            return super().make_context(*args, **kwargs)

    def invoke(self, context: click.Context) -> Any:
        with _checked_output():
            return super().invoke(context)

    def main(self, *args: Any, **kwargs: Any) -> Any:
        try:
            code = super().main(*args, **kwargs | {"standalone_mode": False})
        except Exception as error:
            code, text = _outcome(error)
            tell(f"hd-diag: {text}", err=True)
        sys.exit(code if isinstance(code, int) else 0)


@contextmanager
def _checked_output() -> Iterator[None]:
    """Exit with 0 if the reader of stdout closes it (click exits with 1); report a full disk in one line."""
    try:
        yield
    except BrokenPipeError:
        discard_output(sys.stdout)
        sys.exit(0)
    except OSError as error:
        if error.errno != errno.ENOSPC or error.filename is not None:
            raise
        discard_output(sys.stdout)
        raise Problem(f"the output cannot be written: {error.strerror}") from error


def _outcome(error: Exception) -> tuple[int, str]:
    """Exit code and line for an error that ended a verb; 1 is reserved for findings, whatever goes wrong.

    An error of the program itself is raised if the environment variable `_TRACEBACK` is set.
    """
    if code := signalled(error):
        return code, "interrupted"
    if isinstance(error, click.ClickException):
        return error.exit_code, " ".join(error.format_message().split())
    if isinstance(error, ModuleNotFoundError) and error.name and not error.name.startswith("hd_diag"):
        return 2, f"{error}: python3 -m pip install {error.name}"  # numba, which rosdep cannot install
    if is_memory(error):
        return 2, "there is not enough memory"
    if os.environ.get(_TRACEBACK):
        raise error
    if isinstance(error, OSError):
        name = "" if error.filename is None else f"{str(error.filename)[:_LONGEST_NAME]}: "
        return 2, f"{name}{error.strerror or error}"
    frames = traceback.extract_tb(error.__traceback__)
    place = next(f for f in reversed(frames) if "hd_diag" in f.filename)
    text = f"{type(error).__name__}: {error}".rstrip(": ").partition("\n")[0]
    return 2, f"{FAULT}, please report it: {text} ({place.name}, line {place.lineno})"


@click.group(
    cls=_Verbs,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(hd_diag.__version__, prog_name="hd-diag")
@click.pass_context
def cli(context: click.Context) -> None:
    """Model, monitor and diagnose harmonic drives in robot joints, live and from bags.

    Lengths, angles and torques are SI: m, rad, N m. A configuration is a ROS parameter file, the same for the
    node and for every command. Exit codes: 0 done, 1 a finding that you asked to fail on, 2 bad usage or
    input, 130 after Ctrl-C.
    """
    if context.invoked_subcommand is None:
        click.echo(context.get_help())


@options.verb("completion bash")
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
def completion() -> None:
    """Print a completion script for bash, zsh or fish.

    With it the shell completes commands, options and files. Write it where the shell looks. bash (4.4 or
    newer): ~/.local/share/bash-completion/completions/hd-diag; zsh: a file _hd-diag in a folder of $fpath;
    fish: ~/.config/fish/completions/hd-diag.fish. A new shell reads it.
    """


for found in (completion, *(each for room in (bags, drives, records, ros) for each in vars(room).values())):
    if isinstance(found, click.Command):
        cli.add_command(found)


def main() -> None:
    """Entry point of the ``hd-diag`` command."""
    # Matrices are small: more threads only wait for each other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if "_HD_DIAG_COMPLETE" in os.environ:
        import_module("hd_diag.cli.completion")  # a request from bash
    cli()

"""The verbs of the command line, each in a module of its own that is imported when the verb is called.

Exit codes: 0 done, 1 a finding to fail on, 2 bad usage or input, 130 after Ctrl-C.
"""

from __future__ import annotations

import difflib
import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

import click

import hd_diag
from hd_diag.cli.lines import tell
from hd_diag.ros.stop_signals import signalled

# Module of each verb, and its line in the list of all.
VERBS = {
    "check": ("check", "Check a configuration without ROS and describe its drives."),
    "completion": ("completion", "Print a completion script for bash, zsh or fish."),
    "demo": ("demo", "Run the node beside a simulated joint, then replay and diagnose its log."),
    "diagnose": ("diagnose", "Find what the model gets wrong in a bag, and the physical cause."),
    "figures": ("figures", "Draw the model's counterparts of the paper's Figs. 5 to 7."),
    "fleet": ("fleet", "Diagnose every joint of many bags and show what changes over time."),
    "gear": ("gear", "Write a parameter file for a drive from its catalogue page."),
    "mesh": ("mesh", "Show backlash and load of every tooth at one input angle and torque."),
    "node": ("node", "Run the ROS node."),
    "recover": ("bags", "Save what can be read of an unfinished or damaged bag."),
    "replay": ("bags", "Run the model over a bag and write what the node would publish."),
    "report": ("report", "Diagnose a bag and write one HTML page."),
    "ripple": ("ripple", "Find periodic torque ripple of robots that report one angle for each joint."),
    "simulate": ("simulate", "Write a bag of a simulated joint."),
    "tolerance": ("tolerance", "Compute how much eccentricity an assembly may have."),
    "topics": ("topics", "List what is in a bag and propose the configuration of its joints."),
    "watch": ("watch", "Show the values and faults of a running node in the terminal."),
}


class _Verbs(click.Group):
    """Verbs found by their names; what is wrong is one line on stderr."""

    def list_commands(self, context: click.Context) -> list[str]:
        return list(VERBS)

    def get_command(self, context: click.Context, name: str) -> click.Command | None:
        if name not in VERBS:
            return None
        command: click.Command = getattr(import_module(f"{__name__}.{name}"), name)
        return command

    def resolve_command(self, context: click.Context, words: list[str]) -> Any:
        try:
            return super().resolve_command(context, words)
        except click.UsageError as error:
            near = difflib.get_close_matches(words[0], VERBS, 1)
            advice = f"Did you mean '{near[0]}'?" if near else "'hd-diag --help' lists them."
            raise click.UsageError(f"{error.message} {advice}", context) from error

    def format_commands(self, context: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, line) for name, (_, line) in VERBS.items()])

    def make_context(self, *args: Any, **kwargs: Any) -> click.Context:
        with _read_or_not():
            return super().make_context(*args, **kwargs)

    def invoke(self, context: click.Context) -> Any:
        with _read_or_not():
            return super().invoke(context)

    def main(self, *args: Any, **kwargs: Any) -> Any:
        try:
            code = super().main(*args, **kwargs | {"standalone_mode": False})
        except Exception as error:
            code, text = _ended(error)
            tell(f"hd-diag: {text}", err=True)
        sys.exit(code if isinstance(code, int) else 0)


@contextmanager
def _read_or_not() -> Iterator[None]:
    """End well where nobody reads the rest: click ends with 1, which is that of a finding.

    A full disk under what is printed is an error of one line.
    """
    try:
        yield
    except BrokenPipeError:
        _print_no_more()
        sys.exit(0)
    except OSError as error:
        if error.errno != errno.ENOSPC or error.filename is not None:
            raise
        _print_no_more()
        raise _Full(f"the output cannot be written: {error.strerror}") from error


class _Full(click.ClickException):
    exit_code = 2


def _print_no_more() -> None:
    """Let nothing come of what the interpreter has still to print."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _ended(error: Exception) -> tuple[int, str]:
    """Exit code of what ended a verb, and the line on it; raises what nobody expects."""
    if code := signalled(error):
        return code, "interrupted"
    if isinstance(error, click.ClickException):
        return error.exit_code, " ".join(error.format_message().split())
    if isinstance(error, ModuleNotFoundError) and error.name and not error.name.startswith("hd_diag"):
        return 2, f"{error}: python3 -m pip install {error.name}"  # numba, which rosdep cannot install
    raise error


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


def main() -> None:
    """Entry point of the ``hd-diag`` command."""
    # Matrices are small: more threads only wait for each other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if "_HD_DIAG_COMPLETE" in os.environ:
        import_module("hd_diag.cli.completion")  # how bash asks
    cli()


if __name__ == "__main__":
    main()

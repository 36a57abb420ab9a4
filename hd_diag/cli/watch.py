"""``hd-diag watch``: running nodes in the terminal."""

from __future__ import annotations

import contextlib
import json
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from types import FrameType
from typing import TYPE_CHECKING, TextIO

import click

from hd_diag.cli.options import Problem, verb, write_json
from hd_diag.cli.verbs import SIGNALLED
from hd_diag.formatting import visible
from hd_diag.watch import Watch, as_json
from hd_diag.watch.display import PLAIN_PERIOD, Display

if TYPE_CHECKING:
    from hd_diag.watch.listener import Listener

_STEP = 0.2  # longest sleep between looks at signals [s]
# Between the first report and a look at who else is there [s]: DDS may take 2.7 s to discover a second node.
_SETTLE = 3.0
_SETTLE_JOINTS = 0.5  # where it is known what is waited for
_FAULT = 1

Show = Callable[[Watch, float, bool], None]


@contextlib.contextmanager
def _signals() -> Iterator[list[int]]:
    """Signals that came since; a second one ends the program at once.

    A KeyboardInterrupt at any place could leave the terminal without a cursor; so would SIGTERM.
    """
    came: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        came.append(number)
        signal.signal(number, signal.SIG_DFL)

    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, note) for number in numbers]
    try:
        yield came
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)


@verb("watch --once --joint joint_1 --fail-on-fault")
@click.option("--joint", "joints", multiple=True, help="Joint; repeatable. [default: all]")
@click.option(
    "--namespace",
    "namespaces",
    multiple=True,
    help="Nodes in this namespace, or below it; repeatable. [default: all]",
)
@click.option(
    "--once",
    is_flag=True,
    help="Show one report of every joint and end; finding all nodes takes 3 s, less with --joint.",
)
@click.option(
    "--timeout",
    type=click.FloatRange(0.1, 3600.0),
    default=10.0,
    show_default=True,
    help="With --once: longest wait for a report [s].",
)
@click.option("--fail-on-fault", is_flag=True, help="End with code 1 once a joint has a fault.")
@click.option(
    "--json",
    "json_file",
    is_flag=False,
    flag_value="-",
    metavar="[FILE]",
    type=click.Path(dir_okay=False, allow_dash=True),
    help="Everything reported as JSON, to stdout or a file; without --once a line a second.",
)
def watch(
    joints: tuple[str, ...],
    namespaces: tuple[str, ...],
    once: bool,
    timeout: float,
    fail_on_fault: bool,
    json_file: str | None,
) -> None:
    """A running node in the terminal: what its diagnostics say of every joint.

    A table in a terminal, a line for each report on a pipe (one a second). Needs ROS 2 Jazzy. Exit codes: 0
    done, 1 a fault with --fail-on-fault, 2 nothing came within --timeout, 130 after Ctrl-C.
    """
    try:
        from hd_diag.watch.listener import listening
    except ImportError as error:
        raise Problem(f"watch needs ROS 2 Jazzy (rclpy), which is not to be imported: {error}") from error
    state = Watch(joints, namespaces)
    with _signals() as came, contextlib.ExitStack() as stack:
        try:
            listener = stack.enter_context(listening(state))
        except Exception as error:  # rclpy raises several kinds, of a wrong ROS_DOMAIN_ID for instance
            raise Problem(f"no access to ROS: {error}") from error
        try:
            if once:
                code = _once(state, listener, came, timeout, fail_on_fault, json_file)
            else:
                code = _follow(state, listener, came, fail_on_fault, json_file)
        except BrokenPipeError:  # whoever read has enough; the interpreter must not write the rest
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            code = 0
    sys.exit(code)


def _once(
    state: Watch,
    listener: Listener,
    came: list[int],
    timeout: float,
    fail_on_fault: bool,
    json_file: str | None,
) -> int:
    """Wait for every joint that is known of, and show them; exit code."""
    _wait_for_all(state, listener, came, timeout)
    if came:
        return SIGNALLED + came[0]
    now = time.monotonic()
    if json_file:
        write_json(json_file, as_json(state, now))
    if json_file != "-" and state.view(now):
        with Display() as display:
            display.show_once(state, now)
    if not state.view(now) or (state.joints and state.missing()):
        raise Problem(
            visible(f"no report{_of(state)} within {timeout:g} s: {'; '.join(state.explanation())}")
        )
    return _FAULT if fail_on_fault and _is_faulty(state, now) else 0


def _wait_for_all(state: Watch, listener: Listener, came: list[int], timeout: float) -> None:
    """Wait until all is reported that the graph shows, which takes its time to show all."""
    end, settled = time.monotonic() + timeout, math.inf
    settle = _SETTLE_JOINTS if state.joints else _SETTLE
    while not came and (left := end - time.monotonic()) > 0.0:
        listener.wait(min(_STEP, left))
        now = time.monotonic()
        if math.isinf(settled) and state.view(now):
            settled = now + settle
        if now >= settled:
            listener.look()
            if not state.missing():
                return


def _follow(
    state: Watch, listener: Listener, came: list[int], fail_on_fault: bool, json_file: str | None
) -> int:
    """Show what comes until a signal ends it, or a fault where that is asked for; exit code."""
    with _shown(json_file) as show:
        while not came:
            listener.wait(_STEP)
            now = time.monotonic()
            is_last = fail_on_fault and _is_faulty(state, now)
            show(state, now, is_last)
            if is_last:
                return _FAULT
    return SIGNALLED + came[0]


@contextlib.contextmanager
def _shown(json_file: str | None) -> Iterator[Show]:
    """How a state is shown: as JSON Lines where a file is given, in the terminal otherwise."""
    if json_file is None or json_file == "-":
        with Display() if json_file is None else contextlib.nullcontext() as display:
            yield display.show if display is not None else _json_lines(sys.stdout)
        return
    try:
        file = open(json_file, "w", encoding="utf-8")  # noqa: SIM115 - closed below, opened apart for its error
    except OSError as error:
        raise Problem(f"{json_file}: cannot be written: {error.strerror}") from error
    with file, Display() as display:
        write = _json_lines(file)

        def both(state: Watch, now: float, is_last: bool) -> None:
            display.show(state, now, is_last)
            write(state, now, is_last)

        yield both


def _json_lines(file: TextIO) -> Show:
    """Writes a state as a line of JSON where something came, once a second at most."""
    told, due = 0, 0.0

    def write(state: Watch, now: float, is_last: bool) -> None:
        nonlocal told, due
        if state.messages > told and (now >= due or is_last):
            told, due = state.messages, now + PLAIN_PERIOD
            file.write(json.dumps(as_json(state, now), allow_nan=False) + "\n")
            file.flush()

    return write


def _is_faulty(state: Watch, now: float) -> bool:
    return any(view.is_faulty for view in state.view(now))


def _of(state: Watch) -> str:
    return f" of {', '.join(state.missing() or state.joints)}" if state.joints else " of an hd_diag node"

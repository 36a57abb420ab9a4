"""``hd-diag watch``: running nodes in the terminal."""

from __future__ import annotations

import contextlib
import json
import math
import os
import select
import sys
import termios
import time
import tty
from collections.abc import Callable, Iterator, Sequence
from typing import IO, TYPE_CHECKING

import click

from hd_diag.cli.options import needing_ros
from hd_diag.cli.targets import Problem, write_json
from hd_diag.ros.stop_signals import SIGNALLED, noted_signals
from hd_diag.watch.display import PERIOD, Display
from hd_diag.watch.state import Watch

if TYPE_CHECKING:
    from hd_diag.watch.listener import Listener

_DIAGNOSE, _QUIT = "d", "q"  # keys: ask the nodes for a diagnosis, end
_STEP = 0.2  # longest sleep between looks at signals [s]
# Wait for more nodes after the first report [s]: DDS may take 2.7 s to discover a second one.
_SETTLE = 3.0
_SETTLE_JOINTS = 0.5  # the same if the joints are given


def watch(
    joints: tuple[str, ...],
    namespaces: tuple[str, ...],
    once: bool,
    timeout: float,
    fail_on_fault: bool,
    json_file: str | None,
) -> int:
    """Run ``hd-diag watch``."""
    with needing_ros("watch"):
        from hd_diag.watch.listener import listening
    state = Watch(joints, namespaces)
    with noted_signals() as came, contextlib.ExitStack() as stack:
        try:
            listener = stack.enter_context(listening(state))
        except Exception as error:  # rclpy raises several kinds, for instance if ROS_DOMAIN_ID is wrong
            raise Problem(f"no access to ROS: {error}") from error
        try:
            if once:
                _wait_for_all(state, listener, came, timeout)
                is_faulty = not came and _show_once(state, timeout, json_file)
            else:
                is_faulty = _follow(state, listener, came, fail_on_fault, json_file)
        except BrokenPipeError:  # the reader has closed: a signal does not matter
            raise
        except OSError as error:
            raise Problem(f"{json_file}: cannot be written: {error.strerror}") from error
    return SIGNALLED + came[0] if came else int(fail_on_fault and is_faulty)


def _wait_for_all(state: Watch, listener: Listener, came: Sequence[int], timeout: float) -> None:
    """Wait until the chosen joints are reported, and other nodes have had time to be discovered."""
    end, settled = time.monotonic() + timeout, math.inf
    settle = _SETTLE_JOINTS if state.joints else _SETTLE
    while not came and (remaining := end - time.monotonic()) > 0.0:
        listener.wait(min(_STEP, remaining))
        now = time.monotonic()
        if math.isinf(settled) and state.view(now):
            settled = now + settle
        if now >= settled and not state.missing():
            return


def _show_once(state: Watch, timeout: float, json_file: str | None) -> bool:
    """Show every joint that was reported; return whether one has a fault."""
    now = time.monotonic()
    if write_json(json_file, state.as_json(now)) and state.view(now):
        with Display(state, sys.stdout) as display:
            display.show(now)
    if lack := state.lack(f"within {timeout:g} s"):
        raise Problem(lack)
    return _is_faulty(state, now)


def _follow(
    state: Watch, listener: Listener, came: Sequence[int], fail_on_fault: bool, json_file: str | None
) -> bool:
    """Show reports until a signal, a key or, with `fail_on_fault`, a fault; return whether it was a fault."""
    with contextlib.ExitStack() as stack:
        shows: list[Callable[[float, bool], None]] = []
        if json_file:
            shows.append(_json_lines(state, stack.enter_context(click.open_file(json_file, "w"))))
        if json_file != "-":
            display = stack.enter_context(Display(state, sys.stdout))
            shows.append(lambda now, _: display.show(now))
        pressed = stack.enter_context(_pressed_keys())
        while not came:
            listener.wait(_STEP)
            if _DIAGNOSE in (keys := pressed()):
                listener.diagnose()
            now = time.monotonic()
            is_faulty = fail_on_fault and _is_faulty(state, now)
            is_last = is_faulty or _QUIT in keys
            for show in shows:
                show(now, is_last)
            if is_last:
                return is_faulty
    return False


def _json_lines(state: Watch, file: IO[str]) -> Callable[[float, bool], None]:
    """Function that writes the state as a line of JSON after new messages, at most once a second."""
    written, due = 0, 0.0

    def write(now: float, is_last: bool) -> None:
        nonlocal written, due
        if state.messages > written and (now >= due or is_last):
            written, due = state.messages, now + PERIOD
            file.write(json.dumps(state.as_json(now), allow_nan=False) + "\n")
            file.flush()

    return write


@contextlib.contextmanager
def _pressed_keys() -> Iterator[Callable[[], str]]:
    """A function that gives the keys pressed since its last call. The terminal is left as it was.

    It gives no keys if stdin is no terminal or the program is in the background, where reading would stop it.
    """
    fd = sys.stdin.fileno() if sys.stdin.isatty() else -1
    if fd < 0 or os.tcgetpgrp(fd) != os.getpgrp():
        yield str
        return
    before = termios.tcgetattr(fd)
    try:
        tty.setcbreak(fd)
        yield lambda: os.read(fd, 64).decode(errors="replace") if select.select([fd], [], [], 0.0)[0] else ""
    finally:
        termios.tcsetattr(fd, termios.TCSADRAIN, before)


def _is_faulty(state: Watch, now: float) -> bool:
    return any(view.level != "ok" for view in state.view(now))

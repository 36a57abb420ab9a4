"""A process of the demo: a Python module, ended by SIGINT, never left behind."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

_STEP = 0.05  # between looks at a process and at signals [s]


class DemoError(RuntimeError):
    """Why the demo cannot go on, in one line."""


class Child(subprocess.Popen[bytes]):
    """A Python process in a process group of its own: Ctrl-C reaches it only through its owner.

    What it prints goes to the file `output`; after SIGINT it has `end_limit` [s] before it is killed. It runs
    in that file's folder: in a source tree `python -m` would import the tree, not the installed package.
    """

    def __init__(self, arguments: Sequence[str], output: Path, end_limit: float = 10.0) -> None:
        self._name, self._output, self._end_limit = _name(arguments), output, end_limit
        # With setpriv the system ends the child with this process, even if that is killed.
        setpriv = shutil.which("setpriv")
        parent = [setpriv, "--pdeathsig", "TERM"] if setpriv else []
        command = [*parent, sys.executable, *arguments]
        with output.open("wb") as file:
            super().__init__(
                command,
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
                cwd=output.parent,
                start_new_session=True,
            )

    @property
    def lines(self) -> list[str]:
        """Lines that the process has printed."""
        return self._output.read_text(encoding="utf-8", errors="replace").splitlines()

    def check_running(self) -> None:
        """Raise a DemoError with exit code and last words of a process that has ended."""
        code = self.poll()
        if code is not None:
            words = self.lines[-1] if self.lines else "nothing printed"
            raise DemoError(f"{self._name} ended early with code {code}: {words} (all of it: {self._output})")

    def finish(self, limit: float, stopped: Sequence[int]) -> int:
        """Wait for the process to end, or end it after a time [s]; return its exit code.

        Raises KeyboardInterrupt if `stopped` holds a signal.
        """
        end = time.monotonic() + limit
        while self.poll() is None and time.monotonic() < end:
            if stopped:
                raise KeyboardInterrupt
            time.sleep(_STEP)
        return self.end()

    def end(self) -> int:
        """End it by SIGINT, or by force if that fails; return its exit code, negative after a signal."""
        try:
            if self.poll() is None:
                self.send_signal(signal.SIGINT)
                with contextlib.suppress(subprocess.TimeoutExpired):
                    self.wait(self._end_limit)
        finally:  # whatever interrupts the wait
            if self.poll() is None:
                os.killpg(self.pid, signal.SIGKILL)
        return self.wait()

    def __exit__(self, *_: object) -> None:
        self.end()


def _name(arguments: Sequence[str]) -> str:
    """Name of a module after -m, or of a script."""
    return arguments[1] if arguments[0] == "-m" else Path(arguments[0]).name

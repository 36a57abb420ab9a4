"""A process of the demo: a Python module, ended by SIGINT, never left behind."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

_END_LIMIT = 10.0  # for a process to end after SIGINT [s]


class DemoError(RuntimeError):
    """Why the demo cannot go on, in one line."""


class Child:
    """A module run by this Python as a process, in a group of its own: Ctrl-C reaches it by its owner only.

    Parameters
    ----------
    module : str
        Run as ``python -m module``.
    arguments : sequence of str
    output : Path
        File that takes what it prints.
    """

    def __init__(self, module: str, arguments: Sequence[str], output: Path) -> None:
        self.name = module
        self._output = output
        # With setpriv the system ends the child with this process, even if that is killed.
        setpriv = shutil.which("setpriv")
        parent = [setpriv, "--pdeathsig", "TERM"] if setpriv else []
        with output.open("wb") as file:
            self._process = subprocess.Popen(
                [*parent, sys.executable, "-m", module, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    @property
    def pid(self) -> int:
        """Number of the process, and of its group."""
        return self._process.pid

    @property
    def is_running(self) -> bool:
        """Whether it has not ended yet."""
        return self._process.poll() is None

    @property
    def lines(self) -> list[str]:
        """What it has printed."""
        return self._output.read_text(encoding="utf-8", errors="replace").splitlines()

    def check(self) -> None:
        """See that it lives.

        Raises
        ------
        DemoError
            If it has ended, with its code and last words.
        """
        code = self._process.poll()
        if code is not None:
            words = self.lines[-1] if self.lines else "nothing printed"
            raise DemoError(f"{self.name} ended early with code {code}: {words} (all of it: {self._output})")

    def end(self) -> int:
        """End it by SIGINT, by force if that does nothing; its exit code, negative after a signal."""
        if self.is_running:
            self._process.send_signal(signal.SIGINT)
            try:
                self._process.wait(_END_LIMIT)
            except subprocess.TimeoutExpired:
                self._kill()
        return int(self._process.wait())

    def __enter__(self) -> Child:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, exc: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.end()
        finally:  # whatever interrupts the wait
            self._kill()

    def _kill(self) -> None:
        if self.is_running:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.pid, signal.SIGKILL)
            self._process.wait()

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
from types import TracebackType

_END_LIMIT = 10.0  # for a process to end after SIGINT [s]
_STEP = 0.05  # between looks at a process and at signals [s]


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
    end_limit : float
        How long it may take to end after SIGINT before it is killed [s].
    """

    def __init__(
        self, module: str, arguments: Sequence[str], output: Path, end_limit: float = _END_LIMIT
    ) -> None:
        self.name = module
        self._output = output
        self._end_limit = end_limit
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
    def is_running(self) -> bool:
        """Whether it has not ended yet."""
        return self._process.poll() is None

    @property
    def lines(self) -> list[str]:
        """What it has printed."""
        return self._output.read_text(encoding="utf-8", errors="replace").splitlines()

    def check_running(self) -> None:
        """Refuse a process that has ended.

        Raises
        ------
        DemoError
            With its exit code and last words.
        """
        code = self._process.poll()
        if code is not None:
            words = self.lines[-1] if self.lines else "nothing printed"
            raise DemoError(f"{self.name} ended early with code {code}: {words} (all of it: {self._output})")

    def wait(self, limit: float, stopped: Sequence[int]) -> int:
        """Exit code once it ends by itself.

        Parameters
        ----------
        limit : float
            [s]; it is ended then.
        stopped : sequence of int
            Signals that came: the first one raises KeyboardInterrupt.
        """
        end = time.monotonic() + limit
        while self.is_running and time.monotonic() < end:
            if stopped:
                raise KeyboardInterrupt
            time.sleep(_STEP)
        return self.end()

    def end(self) -> int:
        """End it by SIGINT, by force if that does nothing; its exit code, negative after a signal."""
        if self.is_running:
            self._process.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(self._end_limit)
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
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()

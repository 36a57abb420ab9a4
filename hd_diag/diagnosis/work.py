"""The work of a diagnosis: its progress, its time limit, and the steps left out."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

Progress = Callable[[float, str], None]
"""Receives the finished share of the work and a description of the current step."""


class OutOfTime(Exception):
    """A step of the work reached its time limit."""


class Work:
    """Limits the work to some `seconds` of computing time of this process, counted from here.

    Computing time on a free core is no less than wall time, and a busy machine does not change the result.
    `left_out` lists in words the steps that were skipped for lack of time.
    """

    def __init__(self, seconds: float = math.inf, progress: Progress = lambda share, text: None) -> None:
        self.seconds, self.progress, self.left_out = seconds, progress, list[str]()
        self._begin, self._most, self._share = time.process_time(), math.inf, 0.0

    @property
    def spent(self) -> float:
        """Computing time so far [s]."""
        return time.process_time() - self._begin

    def tell(self, share: float, text: str) -> None:
        """Report the current step and the finished share, which is at least the share of time spent."""
        least = self.spent / self.seconds if self.spent < self.seconds else 0.0
        self._share = max(self._share, share, least)
        self.progress(self._share, text)

    def check(self) -> None:
        """Raise OutOfTime if the current step has reached its time limit."""
        if self._most < math.inf and self.spent > self._most:  # reading the clock is slow on some systems
            raise OutOfTime

    @contextmanager
    def until(self, share: float, what: str) -> Iterator[None]:
        """Context of a step that is stopped once this share of the total time is spent.

        Then `what` is added to `left_out`, and the work continues after the step.
        """
        before, self._most = self._most, share * self.seconds
        try:
            yield
        except OutOfTime:
            self.left_out += [what] if what not in self.left_out else []
        finally:
            self._most = before

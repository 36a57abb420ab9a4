"""The work of a diagnosis: how far it is, how long it may take, and what there was no time for."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

Progress = Callable[[float, str], None]
"""Takes the share of the time that is done, and what is being done now."""


class OutOfTime(Exception):
    """A part of the work has no more time."""


class Work:
    """Computing time of this process, counted from here, of which the work may take some `seconds`.

    On a free core it is no less than the time by the clock, and a busy machine does not change what is found.
    What there was no time for is in `left_out`, in words.
    """

    def __init__(self, seconds: float = math.inf, progress: Progress = lambda share, text: None) -> None:
        self.seconds, self.progress, self.left_out = seconds, progress, list[str]()
        self._begin, self._most, self._share = time.process_time(), math.inf, 0.0

    @property
    def spent(self) -> float:
        """Computing time until now [s]."""
        return time.process_time() - self._begin

    def tell(self, share: float, text: str) -> None:
        """Report what is done now and the share that is done, at least that of the time that was spent."""
        least = self.spent / self.seconds if self.spent < self.seconds else 0.0
        self._share = max(self._share, share, least)
        self.progress(self._share, text)

    def check(self) -> None:
        """Raise OutOfTime where the part that is being done has no more time."""
        if self._most < math.inf and self.spent > self._most:  # asking for the time is slow on some systems
            raise OutOfTime

    @contextmanager
    def until(self, share: float, what: str) -> Iterator[None]:
        """A part of the work that ends, wherever it is, when a share of all the time is gone.

        Then `what` is left out, and what follows the part goes on.
        """
        before, self._most = self._most, share * self.seconds
        try:
            yield
        except OutOfTime:
            self.left_out += [what] if what not in self.left_out else []
        finally:
            self._most = before

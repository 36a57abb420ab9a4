"""Where chunks are compressed and written: at once, or in a thread beside the work that fills them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

# Chunks that may wait to be written: they bound the memory, and what a crash costs.
_MOST = 4


class AtOnce:
    """Does what it is given."""

    def do(self, action: Callable[[], None]) -> None:
        """Do it."""
        action()

    def wait(self) -> None:
        """Nothing is ever left to be done."""

    def close(self) -> None:
        """There is nothing to end."""


class Beside(AtOnce):
    """Does what it is given in its order, in a thread; what goes wrong is raised by one of the next calls."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="bag writer")
        self._waiting: deque[Future[None]] = deque()

    def do(self, action: Callable[[], None]) -> None:
        """Do it soon; waits where too much is waiting."""
        self._waiting.append(self._pool.submit(action))
        while len(self._waiting) > _MOST or (self._waiting and self._waiting[0].done()):
            self._waiting.popleft().result()

    def wait(self) -> None:
        """Until everything is done; raises the first error that was not raised yet."""
        waiting, self._waiting = self._waiting, deque()
        errors = [error for error in (future.exception() for future in waiting) if error is not None]
        if errors:
            raise errors[0]

    def close(self) -> None:
        """End the thread."""
        self._pool.shutdown()

"""What is read of a file before it is asked for, in a thread beside the work on what was read before."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Generic, TypeVar

Item = TypeVar("Item")
Content = TypeVar("Content")

# What is read ahead takes no more memory than this [byte].
_MOST = 12 << 20


class Ahead(Generic[Item, Content]):
    """Contents of items in their order, a few of them read before their turn.

    Parameters
    ----------
    items : sequence
    read : callable
        Gives the content of an item; what it raises is raised when it is the item's turn.
    size : callable
        Memory that an item's content takes at most [byte]; a large one is read when its turn has come.
    """

    def __init__(
        self, items: Sequence[Item], read: Callable[[Item], Content], size: Callable[[Item], int]
    ) -> None:
        self._items, self._read, self._size = deque(items), read, size
        self._waiting: deque[tuple[int, Future[Content]]] = deque()
        self._held = 0
        self._closed = False
        # A thread for a single item would only cost time.
        self._pool = ThreadPoolExecutor(2, thread_name_prefix="bag reader") if len(items) > 1 else None

    def take(self) -> Content:
        """The next content.

        Raises
        ------
        ValueError
            Where it was closed before.
        """
        if self._closed:
            raise ValueError("the bag was closed")
        self._read_on()
        if not self._waiting:
            return self._read(self._items.popleft())
        size, future = self._waiting.popleft()
        self._held -= size
        try:
            return future.result()
        finally:
            del future  # an error's traceback would keep the content

    def close(self) -> None:
        """End the thread; nothing is read any more when this returns."""
        self._closed = True
        self._items.clear()
        self._waiting.clear()
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def _read_on(self) -> None:
        """Ask for as many of the next items as the memory allows."""
        while self._pool is not None and self._items:
            size = self._size(self._items[0])
            if self._held + size > _MOST:
                return
            self._held += size
            self._waiting.append((size, self._pool.submit(self._read, self._items.popleft())))

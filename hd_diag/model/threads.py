"""Large batches spread over cores: threads run compiled kernels in parallel, each on some of the rows."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

MOMENTS = 16
"""Moments of a mesh that a thread takes at a time: 0.3 ms of work; a thread costs 0.1 ms."""


def cores() -> int:
    """Number of cores that this process may use; 1 in a pool's process, as the pool has one per core."""
    if multiprocessing.parent_process() is not None:
        return 1
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def spread(work: Callable[[int, int], object], size: int, share: int) -> None:
    """Work on all rows, in several threads if each gets at least two shares.

    `work` is called with the first row and the one after the last, and fills these rows of its results. A
    thread takes `share` rows at a time. The threads end with the call, so that a process forked later
    inherits none of them.
    """
    if size < 4 * share or (threads := min(cores(), size // (2 * share))) < 2:
        work(0, size)
        return
    shares = iter([(first, min(first + share, size)) for first in range(0, size, share)])

    def some() -> None:
        for first, last in shares:  # a free thread takes the next share: cores may be busy with other work
            work(first, last)

    with ThreadPoolExecutor(threads - 1, thread_name_prefix="rows") as pool:
        others = [pool.submit(some) for _ in range(threads - 1)]
        some()
    for other in others:
        other.result()

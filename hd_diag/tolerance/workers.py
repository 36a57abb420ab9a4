"""Independent tasks on several cores; the same results, in the same order, as on one."""

from __future__ import annotations

import concurrent.futures
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import TypeVar

from hd_diag.tolerance.moments import warm_up

Task = TypeVar("Task")
Result = TypeVar("Result")


class Workers:
    """Processes for tasks; none with one job: the tasks then run here.

    Parameters
    ----------
    jobs : int
        How many tasks at a time.
    """

    def __init__(self, jobs: int) -> None:
        warm_up()  # here first: the others then read the kernels from the disk
        self._pool: concurrent.futures.ProcessPoolExecutor | None = None
        if jobs > 1:
            # A fresh process each: a fork would take over the threads' locks of a progress bar.
            context = multiprocessing.get_context("spawn")
            self._pool = concurrent.futures.ProcessPoolExecutor(jobs, context, _begin)

    def __enter__(self) -> Workers:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)

    def map(
        self,
        function: Callable[[Task], Result],
        tasks: Sequence[Task],
        done: Callable[[], None] = lambda: None,
    ) -> list[Result]:
        """Results of the tasks in their order.

        Parameters
        ----------
        function : callable
            Of one task; both can be pickled.
        tasks : sequence
        done : callable
            Called after each.
        """
        if self._pool is None:
            return [_told(function(task), done) for task in tasks]
        futures = [self._pool.submit(function, task) for task in tasks]
        for future in concurrent.futures.as_completed(futures):
            future.result()
            done()
        return [future.result() for future in futures]


def _told(result: Result, done: Callable[[], None]) -> Result:
    done()
    return result


def _begin() -> None:
    """Leave Ctrl-C to the parent, which then ends this process; end with it however it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    warm_up()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)

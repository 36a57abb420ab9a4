"""Many tasks on several processes, of one thread each; a process that dies or hangs costs only its task."""

from __future__ import annotations

import contextlib
import functools
import multiprocessing
import os
import resource
import signal
import sys
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

ATTEMPTS = 3
"""Number of attempts at a task whose worker dies."""

_PATIENCE = 0.2  # between calls of `tick` [s]
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


@dataclass(frozen=True)
class Failure:
    """A task that gave no result: the reason, and whether its worker died."""

    text: str
    died: bool = False


class Pool(Protocol):
    """Workers; each does one task at a time."""

    def workers(self) -> Iterable[Any]:
        """Workers that are present, busy or idle."""

    def send(self, worker: Any, function: Callable[[Any], Any], item: Any) -> Any:
        """Give a worker a task and return its handle."""

    def done(self, at_work: Mapping[Any, Any], patience: float) -> list[tuple[Any, Any]]:
        """Tasks at work that have ended, with result or `Failure`; waits at most `patience` [s]."""


def run(
    pool: Pool,
    function: Callable[[Item], Result],
    items: Sequence[Item],
    tick: Callable[[], None] = lambda: None,
    timeout: float = 0.0,
) -> Iterator[tuple[int, Result | Failure]]:
    """Call a function with many items, started in their order, and yield index and outcome as each comes.

    The function must be in a module that workers can import. An exception becomes a `Failure`. So does an
    item that takes longer than the timeout [s] (0 = none), whose worker is killed, and one whose worker died
    in `ATTEMPTS` attempts. `tick` is called several times a second; an exception of it ends the run.
    """
    waiting, numbers, at_work = deque(range(len(items))), dict[Any, int](), dict[Any, Any]()
    deaths, started = [0] * len(items), [0.0] * len(items)
    attempt = functools.partial(_attempt, function, timeout)
    while waiting or at_work:
        tick()
        taken = set(at_work.values())
        idle = [worker for worker in pool.workers() if worker not in taken] if waiting else []
        for worker in idle[: len(waiting)]:
            number = waiting.popleft()
            started[number] = time.monotonic()
            task = pool.send(worker, attempt, items[number])
            numbers[task], at_work[task] = number, worker
        for task, outcome in pool.done(at_work, _PATIENCE):
            number = numbers.pop(task)
            del at_work[task]
            if isinstance(outcome, Failure) and outcome.died:
                deaths[number] += 1
                if 0.0 < timeout <= time.monotonic() - started[number]:
                    outcome = Failure(f"took longer than {timeout:g} s")
                elif deaths[number] == ATTEMPTS:
                    outcome = Failure(f"its worker died in each of {ATTEMPTS} attempts: {outcome.text}")
                else:
                    waiting.appendleft(number)
                    continue
            yield number, outcome


def _attempt(function: Callable[[Any], Any], timeout: float, item: Any) -> Any:
    """The function's result, or a `Failure` for an exception, because not every exception can be pickled.

    The system ends the process after the timeout [s] (0 = none), wherever it hangs.
    """
    signal.setitimer(signal.ITIMER_REAL, timeout)
    try:
        return function(item)
    except MemoryError:
        return Failure("needs more memory than a worker may have")
    except Exception as error:
        return Failure(f"{type(error).__name__}: {error}")
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


class ProcessPool:
    """Processes of this machine; the death of one costs only its own task. They start with their first task.

    `memory` is the limit of each process [byte]; 0 is no limit.
    """

    def __init__(self, jobs: int, memory: int = 0) -> None:
        self._context = multiprocessing.get_context("spawn")  # a fork would copy locks that threads hold
        self._memory = memory
        self._before = set(multiprocessing.active_children())
        self._lanes = [self._lane() for _ in range(jobs)]

    def _lane(self) -> ProcessPoolExecutor:
        # One process per lane: an executor of several fails as a whole and does not say which task killed it.
        return ProcessPoolExecutor(1, self._context, _begin, (self._memory,))

    def map(
        self,
        function: Callable[[Item], Result],
        items: Sequence[Item],
        done: Callable[[], None] = lambda: None,
    ) -> list[Result]:
        """Results in the order of the items; with one job the function is called in this process.

        `done` is called after each item. Raises RuntimeError where another process gave no result.
        """
        here = ((number, function(item)) for number, item in enumerate(items))
        found: dict[int, Result] = {}
        for number, outcome in here if len(self._lanes) == 1 else run(self, function, items):
            if isinstance(outcome, Failure):
                raise RuntimeError(outcome.text)
            found[number] = outcome
            done()
        return [found[number] for number in range(len(items))]

    def workers(self) -> Iterable[int]:
        """Numbers of the lanes."""
        return range(len(self._lanes))

    def send(self, worker: int, function: Callable[[Any], Any], item: Any) -> Future[Any]:
        """Give a lane a task."""
        with _one_thread():
            try:
                return self._lanes[worker].submit(function, item)
            except BrokenProcessPool:  # died while it had nothing to do
                self._lanes[worker] = self._lane()
                return self._lanes[worker].submit(function, item)

    def done(self, at_work: Mapping[Future[Any], int], patience: float) -> list[tuple[Future[Any], Any]]:
        """Tasks that have ended, with their outcomes; a lane gets another process if its own died."""
        outcomes: list[tuple[Future[Any], Any]] = []
        for future in wait(at_work, patience, FIRST_COMPLETED).done:
            error = future.exception()
            if isinstance(error, BrokenProcessPool):
                self._lanes[at_work[future]].shutdown(wait=False)
                self._lanes[at_work[future]] = self._lane()
                outcomes.append((future, Failure("killed, out of memory, or crashed", died=True)))
            else:
                outcomes.append((future, future.result() if error is None else Failure(str(error))))
        return outcomes

    def __enter__(self) -> ProcessPool:
        return self

    def __exit__(self, kind: object, *reason: object) -> None:
        for lane in self._lanes:
            lane.shutdown(wait=kind is None, cancel_futures=True)
        if kind is not None:
            for process in set(multiprocessing.active_children()) - self._before:
                process.terminate()


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    """Processes that start in this context compute on one thread: the pool has a process for every core."""
    before = {name: os.environ[name] for name in _THREADS if name in os.environ}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        yield
    finally:
        for name in _THREADS:
            del os.environ[name]
        os.environ.update(before)


def _begin(memory: int) -> None:
    """Set up a process: Ctrl-C is left to the parent, and the process ends when its parent ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    warnings.simplefilter("ignore", RuntimeWarning)  # numpy's warnings of nan
    threading.Thread(target=_follow_parent, daemon=True).start()
    if memory:
        # A Failure reports a task that does not fit; multiprocessing would print a traceback, too.
        sys.stderr = open(os.devnull, "w")  # noqa: SIM115
        resource.setrlimit(resource.RLIMIT_DATA, (memory, resource.getrlimit(resource.RLIMIT_DATA)[1]))


def _follow_parent() -> None:
    if (parent := multiprocessing.parent_process()) is not None:
        parent.join()
        os._exit(1)

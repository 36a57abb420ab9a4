"""Many tasks on several processes, of one thread each; a process that dies or hangs costs only its task."""

from __future__ import annotations

import contextlib
import functools
import multiprocessing
import os
import resource
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

ATTEMPTS = 3
"""How often a task is tried whose worker dies."""

_PATIENCE = 0.2  # between calls of `tick` [s]
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


@dataclass(frozen=True)
class Failure:
    """A task that gave no result, why, and whether its worker died."""

    text: str
    died: bool = False


class Pool(Protocol):
    """Workers, each of which does one task at a time."""

    def idle(self) -> Iterable[Any]:
        """Workers that can take a task."""

    def send(self, worker: Any, number: int, function: Callable[[Any], Any], item: Any) -> None:
        """Give a worker a task, known by its number."""

    def done(self, patience: float) -> list[tuple[int, Any]]:
        """Numbers and outcomes (result or `Failure`) of tasks that have ended; waits at most [s]."""


def run(
    pool: Pool,
    function: Callable[[Item], Result],
    items: Sequence[Item],
    tick: Callable[[], None] = lambda: None,
    timeout: float = 0.0,
) -> Iterator[tuple[int, Result | Failure]]:
    """Call a function with many items, started in their order, and yield index and outcome as each comes.

    The function is of a module that workers can import; what it raises becomes a `Failure`. So does an item
    that takes longer than the timeout [s] (0 = any), for which its worker is killed, and one whose worker
    died in `ATTEMPTS` attempts. `tick` is called several times a second; what it raises ends the run.
    """
    waiting, at_work = deque(range(len(items))), 0
    deaths, started = [0] * len(items), [0.0] * len(items)
    timed = functools.partial(_timed, function, timeout)
    while waiting or at_work:
        tick()
        for worker in pool.idle() if waiting else ():
            if waiting:
                number = waiting.popleft()
                started[number] = time.monotonic()
                pool.send(worker, number, timed, items[number])
                at_work += 1
        for number, outcome in pool.done(_PATIENCE):
            at_work -= 1
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


def _timed(function: Callable[[Any], Any], timeout: float, item: Any) -> Any:
    """The function's result; the system ends the process where it takes longer [s], wherever it hangs."""
    signal.setitimer(signal.ITIMER_REAL, timeout)
    try:
        return function(item)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def guarded(function: Callable[[Any], Any], item: Any) -> Any:
    """The function's result, or a `Failure` for what it raised: not every exception can be pickled."""
    try:
        return function(item)
    except MemoryError:
        return Failure("needs more memory than a worker may have")
    except Exception as error:
        return Failure(f"{type(error).__name__}: {error}")


class ProcessPool:
    """Processes of this machine; the death of one costs only its own task. They start with their first task.

    Each may have so much memory [byte]; 0 is any.
    """

    def __init__(self, jobs: int, memory: int = 0) -> None:
        self._context = multiprocessing.get_context("spawn")  # a fork would copy locks that threads hold
        self._memory = memory
        self._before = set(multiprocessing.active_children())
        self._lanes = [self._lane() for _ in range(jobs)]
        self._at_work: dict[Future[Any], tuple[int, int]] = {}

    def _lane(self) -> ProcessPoolExecutor:
        # One process in each: an executor of several fails as a whole and does not say which task killed it.
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

    def idle(self) -> list[int]:
        """Lanes without a task."""
        taken = {lane for lane, _ in self._at_work.values()}
        return [lane for lane in range(len(self._lanes)) if lane not in taken]

    def send(self, worker: int, number: int, function: Callable[[Any], Any], item: Any) -> None:
        """Give a lane a task."""
        with _one_thread():
            try:
                future = self._lanes[worker].submit(guarded, function, item)
            except BrokenProcessPool:  # died while it had nothing to do
                self._lanes[worker] = self._lane()
                future = self._lanes[worker].submit(guarded, function, item)
        self._at_work[future] = worker, number

    def done(self, patience: float) -> list[tuple[int, Any]]:
        """Numbers and outcomes of tasks that have ended."""
        outcomes: list[tuple[int, Any]] = []
        for future in wait(self._at_work, patience, FIRST_COMPLETED).done:
            lane, number = self._at_work.pop(future)
            error = future.exception()
            if isinstance(error, BrokenProcessPool):
                self._lanes[lane].shutdown(wait=False)
                self._lanes[lane] = self._lane()
                outcomes.append((number, Failure("killed, out of memory, or crashed", died=True)))
            else:
                outcomes.append((number, future.result() if error is None else Failure(str(error))))
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
    """Processes that start in here compute on one thread each: the pool has a process for every core."""
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
    threading.Thread(target=_follow_parent, daemon=True).start()
    if memory:
        resource.setrlimit(resource.RLIMIT_DATA, (memory, resource.getrlimit(resource.RLIMIT_DATA)[1]))


def _follow_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)

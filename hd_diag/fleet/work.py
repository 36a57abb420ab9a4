"""Tasks done by workers that may die: each has one task, and a task whose worker died is done again."""

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
"""Workers that a task may cost."""

_PATIENCE = 0.2  # between looks at the caller's wishes [s]
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


@dataclass(frozen=True)
class Failure:
    """A task that gave no result, and why."""

    text: str


@dataclass(frozen=True)
class Lost:
    """A task whose worker died, and how."""

    text: str


class Crew(Protocol):
    """Workers, each of which does one task at a time."""

    @property
    def busy(self) -> int:
        """Number of tasks that are being done."""

    def idle(self) -> Iterable[Any]:
        """Workers that can take a task."""

    def send(self, worker: Any, number: int, function: Callable[[Any], Any], item: Any) -> None:
        """Have a worker do a task; the number tells which it was when it is done."""

    def done(self, patience: float) -> list[tuple[int, Any]]:
        """Numbers and outcomes (result, `Failure` or `Lost`) of tasks that have ended; waits at most [s]."""


def run(
    crew: Crew,
    function: Callable[[Item], Result],
    items: Sequence[Item],
    tick: Callable[[], None] = lambda: None,
    timeout: float = 0.0,
) -> Iterator[tuple[Item, Result | Failure]]:
    """Outcomes of a function of many items, as they come.

    Parameters
    ----------
    crew : Crew
    function : callable
        Of a module that workers can import; what it raises becomes a `Failure`.
    items : sequence
        Begun in this order.
    tick : callable
        Called several times a second; what it raises ends the run.
    timeout : float
        That an item may take [s]; 0 = any. One that takes longer ends its worker and is a `Failure`.

    Yields
    ------
    tuple
        Item and result. Each item comes exactly once: one whose worker died is tried again, `ATTEMPTS`
        times in all, then it is a `Failure`.
    """
    waiting = deque(enumerate(items))
    died, begun = [0] * len(items), [0.0] * len(items)
    timed = functools.partial(_timed, function, timeout)
    while waiting or crew.busy:
        tick()
        for worker in crew.idle() if waiting else ():
            if waiting:
                number, item = waiting.popleft()
                begun[number] = time.monotonic()
                crew.send(worker, number, timed, item)
        for number, outcome in crew.done(_PATIENCE):
            if isinstance(outcome, Lost):
                died[number] += 1
                if 0.0 < timeout <= time.monotonic() - begun[number]:
                    outcome = Failure(f"took longer than {timeout:g} s")
                elif died[number] == ATTEMPTS:
                    outcome = Failure(f"its worker died in each of {ATTEMPTS} attempts: {outcome.text}")
                else:
                    waiting.appendleft((number, items[number]))
                    continue
            yield items[number], outcome


def _timed(function: Callable[[Any], Any], timeout: float, item: Any) -> Any:
    """The function's result; the system ends the process where it takes longer [s], whatever it hangs in."""
    signal.setitimer(signal.ITIMER_REAL, timeout)
    try:
        return function(item)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def guarded(function: Callable[[Any], Any], item: Any) -> Any:
    """The function's result, or what it raised as a `Failure`: not every exception can be sent."""
    try:
        return function(item)
    except MemoryError:
        return Failure("needs more memory than a worker may have")
    except Exception as error:
        return Failure(f"{type(error).__name__}: {error}")


class LocalCrew:
    """Processes of this machine; the death of one costs only its own task.

    Parameters
    ----------
    jobs : int
        Number of processes.
    memory : int
        That each may have [byte]; 0 = any.
    """

    def __init__(self, jobs: int, memory: int = 0) -> None:
        self._context = multiprocessing.get_context("spawn")  # a fork would copy threads in any state
        self._memory = memory
        self._before = set(multiprocessing.active_children())
        self._lanes = [self._lane() for _ in range(jobs)]
        self._at_work: dict[Future[Any], tuple[int, int]] = {}

    def _lane(self) -> ProcessPoolExecutor:
        # One process in each pool: a pool of several fails as a whole and does not tell which task killed it.
        return ProcessPoolExecutor(1, self._context, _begin, (self._memory,))

    @property
    def busy(self) -> int:
        """Number of tasks that are being done."""
        return len(self._at_work)

    def idle(self) -> list[int]:
        """Lanes without a task."""
        taken = {lane for lane, _ in self._at_work.values()}
        return [lane for lane in range(len(self._lanes)) if lane not in taken]

    def send(self, worker: int, number: int, function: Callable[[Any], Any], item: Any) -> None:
        """Have a lane do a task."""
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
                outcomes.append((number, Lost("killed, out of memory, or crashed")))
            else:
                outcomes.append((number, future.result() if error is None else Failure(str(error))))
        return outcomes

    def __enter__(self) -> LocalCrew:
        return self

    def __exit__(self, kind: object, *reason: object) -> None:
        for lane in self._lanes:
            lane.shutdown(wait=kind is None, cancel_futures=True)
        if kind is not None:
            for process in set(multiprocessing.active_children()) - self._before:
                process.terminate()


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    """Processes that begin in here compute on one thread each: the crew has one for every core."""
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _begin(memory: int) -> None:
    """Set up a process: Ctrl-C is the parent's to handle, and a parent that was killed is followed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_follow, daemon=True).start()
    if memory:
        resource.setrlimit(resource.RLIMIT_DATA, (memory, resource.getrlimit(resource.RLIMIT_DATA)[1]))


def _follow() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)

"""Times of calls: CPU time on one core, or wall time on all cores available to this process."""

# ruff: noqa: D103

from __future__ import annotations

import contextlib
import os
import statistics
import time


@contextlib.contextmanager
def one_core():
    """Keep this thread, and the threads it starts, on one core."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(before)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def cpu_time(function, *arguments) -> tuple[object, float]:
    """Result of a call, and its CPU time on one core [s]."""
    with one_core():
        start = time.process_time()
        result = function(*arguments)
        return result, time.process_time() - start


def median_time(function, *arguments, budget: float = 1.0) -> float:
    """Median CPU time of a call on one core [s]; a first call is not counted."""
    with one_core():
        return median(function, *arguments, budget=budget, clock=time.process_time)


def wall_time(function, *arguments, budget: float = 1.0) -> float:
    """Median wall time of a call that may use all cores [s]; a first call is not counted."""
    return median(function, *arguments, budget=budget, clock=time.perf_counter)


def median(function, *arguments, budget, clock) -> float:
    function(*arguments)
    times: list[float] = []
    while len(times) < 3 or (sum(times) < budget and len(times) < 5000):
        start = clock()
        function(*arguments)
        times.append(clock() - start)
    return statistics.median(times)

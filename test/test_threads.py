"""Batches on several threads: every row is processed once; one thread in a pool's processes."""

import multiprocessing
import os
import subprocess
import sys
import threading
from concurrent.futures import ProcessPoolExecutor

import pytest

from hd_diag.model import threads


def test_as_many_threads_as_cores_work_at_once_and_end(monkeypatch):
    monkeypatch.setattr(threads, "cores", lambda: 3)
    before, met, names = threading.enumerate(), threading.Barrier(3), set()

    def work(first, last):
        met.wait(timeout=60)  # passes only if two others are also at work
        names.add(threading.current_thread().name)

    threads.spread(work, 60, 10)
    assert len(names) == 3
    assert set(threading.enumerate()) <= set(before)  # a thread of another test may have ended meanwhile


@pytest.mark.parametrize("broken", [0, 30])
def test_what_a_thread_raises_is_raised(monkeypatch, broken):
    monkeypatch.setattr(threads, "cores", lambda: 2)

    def work(first, last):
        if first == broken:
            raise ArithmeticError(f"row {first}")

    with pytest.raises(ArithmeticError, match=f"row {broken}"):
        threads.spread(work, 40, 10)


def test_cores_are_those_that_the_process_may_use():
    assert threads.cores() == len(os.sched_getaffinity(0))
    code = "import os; from hd_diag.model import threads;"
    code += "os.sched_setaffinity(0, {min(os.sched_getaffinity(0))}); print(threads.cores())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.stdout.strip() == "1", done.stderr
    # One thread in a pool's process.
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        assert pool.submit(threads.cores).result(timeout=60) == 1

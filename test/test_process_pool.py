"""Tasks on processes of this machine, some of which die."""

import multiprocessing
import os
import signal
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pool_tasks
import pytest

from hd_diag.process_pool import ATTEMPTS, Failure, ProcessPool, run


@pytest.fixture
def noted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "calls"
    folder.mkdir()
    monkeypatch.setenv(pool_tasks.CALLS, str(folder))
    return folder


@pytest.mark.parametrize("jobs", [1, 2])
def test_map_keeps_the_order_and_says_when_an_item_is_done(jobs: int) -> None:
    done: list[bool] = []
    with ProcessPool(jobs) as pool:
        results = pool.map(pool_tasks.slower_first, range(5), lambda: done.append(True))
    assert (results, len(done)) == ([0, 1, 2, 3, 4], 5)


def test_nothing_to_do_starts_no_process() -> None:
    before = set(multiprocessing.active_children())
    with ProcessPool(2) as pool:
        assert list(run(pool, pool_tasks.square, [])) == []
        assert not set(multiprocessing.active_children()) - before


def test_what_kills_its_worker_fails_alone(noted: Path) -> None:
    with ProcessPool(2) as pool:
        results = dict(run(pool, pool_tasks.deadly_seven, range(12)))
    assert {n: r for n, r in results.items() if n != 7} == {n: n * n for n in range(12) if n != 7}
    failure = results[7]
    assert isinstance(failure, Failure)
    assert failure.text.startswith(f"its worker died in each of {ATTEMPTS} attempts")
    begun = Counter(name for name, _ in pool_tasks.calls(noted))
    assert begun == {str(n): ATTEMPTS if n == 7 else 1 for n in range(12)}


def test_a_worker_that_is_killed_loses_nothing(noted: Path) -> None:
    killed: list[int] = []

    def tick() -> None:
        begun = pool_tasks.calls(noted)
        if len(begun) >= 3 and not killed:
            killed.append(begun[-1][1])
            os.kill(killed[0], signal.SIGKILL)

    with ProcessPool(2) as pool:
        results = sorted(run(pool, pool_tasks.slow_square, range(6), tick))
    assert results == [(n, n * n) for n in range(6)]
    assert len(killed) == 1
    assert len(pool_tasks.calls(noted)) == 7


def test_what_hangs_ends_its_worker_once_and_the_others_go_on(noted: Path) -> None:
    """The time is that of each item, not of the worker: the others together take longer."""
    names = ["a", "fifo", "b", "pattern", "c", "d"]
    with ProcessPool(1) as pool:
        results = dict(run(pool, pool_tasks.stuck, names, timeout=1.0))
    late = Failure("took longer than 1 s")
    assert results == {0: "a", 1: late, 2: "b", 3: late, 4: "c", 5: "d"}
    begun = pool_tasks.calls(noted)
    assert [name for name, _ in begun] == names
    assert len({process for _, process in begun}) == 3


def test_what_raises_is_a_failure_even_where_it_cannot_be_sent() -> None:
    with ProcessPool(1) as pool:
        results = dict(run(pool, pool_tasks.faulty, range(5)))
        assert results == {0: 0, 1: 1, 2: 2, 3: Failure("Unsendable: 3: no"), 4: 4}
    with pytest.raises(RuntimeError, match="Unsendable: 3: no"), ProcessPool(2) as two:
        two.map(pool_tasks.faulty, range(5))


def test_a_worker_has_one_thread_and_this_process_what_it_had(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
    with ProcessPool(1) as pool:
        assert dict(run(pool, pool_tasks.setting, names)) == {0: "1", 1: "1"}
    assert [os.environ.get(name) for name in names] == ["7", None]


@pytest.mark.skipif(sys.platform != "linux", reason="limits of data are Linux's")
def test_memory_beyond_the_bound_is_a_failure_and_the_next_task_goes_on() -> None:
    bound = 1 << 30
    with ProcessPool(1, bound) as pool:
        results = dict(run(pool, pool_tasks.greedy, [1 << 20, 2 * bound, 1 << 21]))
    assert results == {0: 1 << 20, 1: Failure("needs more memory than a worker may have"), 2: 1 << 21}


def test_an_interruption_ends_the_processes(noted: Path) -> None:
    before = set(multiprocessing.active_children())

    def tick() -> None:
        if len(pool_tasks.calls(noted)) >= 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), ProcessPool(2) as pool:
        list(run(pool, pool_tasks.slow_square, range(50), tick))
    pool_tasks.wait_for(lambda: set(multiprocessing.active_children()) == before)


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks at processes as Linux shows them")
def test_workers_of_a_killed_parent_end(noted: Path) -> None:
    code = (
        "import pool_tasks; from hd_diag.process_pool import ProcessPool, run\n"
        "with ProcessPool(1) as pool: list(run(pool, pool_tasks.slow_square, range(1000)))"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen([sys.executable, "-c", code], env=environment) as parent:
        pool_tasks.wait_for(lambda: pool_tasks.calls(noted))
        parent.kill()
    worker = pool_tasks.calls(noted)[0][1]
    pool_tasks.wait_for(lambda: not pool_tasks.alive(worker))

"""Tasks on local processes or on workers of a Dask scheduler on loopback, some of which die."""

import json
import multiprocessing
import os
import signal
import subprocess
import sys
from collections import Counter
from contextlib import ExitStack
from pathlib import Path

import fleet_tasks
import numpy as np
import pool_tasks
import pytest
from live import config

from hd_diag.fleet import FleetError, cluster
from hd_diag.fleet.cluster import ClusterPool
from hd_diag.fleet.journal import Journal
from hd_diag.fleet.run import Fleet, diagnose_fleet, find_bags
from hd_diag.process_pool import ATTEMPTS, Failure, ProcessPool, run

LATE = Failure("took longer than 1 s")


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}


class Workers:
    """Processes of this machine; their notes are files in `calls`."""

    def __init__(self, calls: Path) -> None:
        self.calls = calls

    def pool(self, jobs: int = 2) -> ProcessPool | ClusterPool:
        return ProcessPool(jobs)

    def renewed(self) -> None:
        """Replace a worker that has gone: here the pool does it."""

    def begun(self) -> list[tuple[str, int]]:
        return pool_tasks.calls(self.calls)


class Cluster(Workers):
    def __init__(self, stack: ExitStack, calls: Path, workers: int) -> None:
        super().__init__(calls)
        self._stack, self._folder = stack, calls.parent
        self._file = self._folder / "scheduler.json"
        self.scheduler = self._start("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file")
        for _ in range(workers):
            self.renewed()

    def pool(self, jobs: int = 3) -> ClusterPool:
        pool_tasks.wait_for(lambda: self._file.exists() and self._file.read_text().endswith("}"))
        return ClusterPool(str(json.loads(self._file.read_text())["address"]))

    def renewed(self) -> None:
        """Start a worker without a nanny, so that a killed worker stays dead."""
        local = ("--local-directory", str(self._folder), "--host", "127.0.0.1")
        self._start("worker", "--nthreads", "1", "--no-nanny", *local, "--scheduler-file")

    def _start(self, role: str, *arguments: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.dask_{role}", "--no-dashboard", *arguments]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        process = subprocess.Popen([*command, str(self._file)], env=environment(), **quiet)
        self._stack.enter_context(process)
        self._stack.callback(process.kill)
        return process


@pytest.fixture
def noted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "calls"
    folder.mkdir()
    monkeypatch.setenv(pool_tasks.CALLS, str(folder))
    return folder


@pytest.fixture
def dask(noted: Path, request: pytest.FixtureRequest):
    pytest.importorskip("distributed")
    with ExitStack() as stack:
        yield Cluster(stack, noted, getattr(request, "param", 3))


@pytest.fixture(params=["processes", pytest.param("cluster", marks=pytest.mark.slow)])
def workers(request: pytest.FixtureRequest, noted: Path) -> Workers:
    return request.getfixturevalue("dask") if request.param == "cluster" else Workers(noted)


def test_what_kills_its_worker_fails_alone(workers: Workers) -> None:
    renewed: list[None] = []

    def tick() -> None:
        while sum(name == "7" for name, _ in workers.begun()) > len(renewed):
            renewed.append(workers.renewed())

    with workers.pool() as pool:
        results = dict(run(pool, pool_tasks.deadly_seven, range(12), tick))
    assert results.pop(7).text.startswith(f"its worker died in each of {ATTEMPTS} attempts")
    assert results == {n: n * n for n in range(12) if n != 7}
    begun = Counter(name for name, _ in workers.begun())
    assert begun == {str(n): ATTEMPTS if n == 7 else 1 for n in range(12)}


def test_a_worker_that_is_killed_loses_nothing(workers: Workers) -> None:
    killed: list[int] = []

    def tick() -> None:
        begun = workers.begun()
        if len(begun) >= 5 and not killed:
            killed.append(begun[-1][1])
            os.kill(killed[0], signal.SIGKILL)

    with workers.pool() as pool:
        results = sorted(run(pool, pool_tasks.slow_square, range(12), tick))
    assert results == [(n, n * n) for n in range(12)]
    begun = workers.begun()
    ((again, _),) = Counter(name for name, _ in begun).most_common(1)
    assert len(begun) == 13
    first, second = (process for name, process in begun if name == again)
    assert (first, second != first) == (killed[0], True)


def test_what_hangs_ends_its_worker_once_and_the_others_go_on(workers: Workers) -> None:
    """The timeout applies to each item, not to the worker: the other items together take longer."""
    names = ["a", "fifo", "b", "pattern", "c", "d"]
    with workers.pool(jobs=1) as pool:
        results = dict(run(pool, pool_tasks.stuck, names, timeout=1.0))
    assert results == {0: "a", 1: LATE, 2: "b", 3: LATE, 4: "c", 5: "d"}
    begun = workers.begun()
    assert sorted(name for name, _ in begun) == sorted(names)
    if not isinstance(workers, Cluster):  # in sequence, with a new process after each kill
        assert [name for name, _ in begun] == names
        assert len({process for _, process in begun}) == 3


@pytest.mark.parametrize("jobs", [1, 2])
def test_map_keeps_the_order_and_says_when_an_item_is_done(jobs: int) -> None:
    before, done = set(multiprocessing.active_children()), list[bool]()
    with ProcessPool(jobs) as pool:
        assert list(run(pool, pool_tasks.square, [])) == []
        assert not set(multiprocessing.active_children()) - before  # an empty list starts no process
        results = pool.map(pool_tasks.slower_first, range(5), lambda: done.append(True))
    assert (results, len(done)) == ([0, 1, 2, 3, 4], 5)


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


def test_a_bound_that_no_task_fits_in_is_told_without_a_traceback(capfd: pytest.CaptureFixture[str]) -> None:
    with ProcessPool(1, 10 << 20) as pool:
        ((_, outcome),) = run(pool, np.square, [2.0])
    assert isinstance(outcome, Failure)
    assert capfd.readouterr().err == ""


def test_memory_beyond_the_bound_is_a_failure_and_the_next_task_goes_on() -> None:
    with ProcessPool(1, 1 << 30) as pool:
        results = dict(run(pool, pool_tasks.greedy, [1 << 20, 1 << 31, 1 << 21]))
    assert results == {0: 1 << 20, 1: Failure("needs more memory than a worker may have"), 2: 1 << 21}


def test_an_interruption_ends_the_processes(noted: Path) -> None:
    before = set(multiprocessing.active_children())

    def tick() -> None:
        if len(pool_tasks.calls(noted)) >= 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), ProcessPool(2) as pool:
        list(run(pool, pool_tasks.slow_square, range(50), tick))
    pool_tasks.wait_for(lambda: set(multiprocessing.active_children()) == before)


def test_workers_of_a_killed_parent_end(noted: Path) -> None:
    code = "import pool_tasks; from hd_diag.process_pool import ProcessPool, run\n"
    code += "with ProcessPool(1) as pool: list(run(pool, pool_tasks.slow_square, range(1000)))"
    with subprocess.Popen([sys.executable, "-c", code], env=environment()) as parent:
        pool_tasks.wait_for(lambda: pool_tasks.calls(noted))
        parent.kill()
    worker = pool_tasks.calls(noted)[0][1]
    pool_tasks.wait_for(lambda: not pool_tasks.alive(worker))


def test_workers_of_a_scheduler_do_tasks_and_what_raises_is_a_failure() -> None:
    distributed = pytest.importorskip("distributed")
    here = {"processes": False, "protocol": "tcp", "host": "127.0.0.1", "dashboard_address": None}
    local = distributed.LocalCluster(n_workers=1, threads_per_worker=1, **here)
    with local, ClusterPool(local.scheduler_address) as pool:
        assert dict(run(pool, pool_tasks.faulty, [1, 3])) == {0: 1, 1: Failure("Unsendable: 3: no")}


@pytest.mark.slow  # 10 s
@pytest.mark.parametrize("dask", [1], indirect=True)
def test_the_cluster_makes_the_same_rows(dask: Cluster, tmp_path: Path, monkeypatch) -> None:
    """The cluster gets only paths, although it runs in another folder."""
    monkeypatch.setattr("hd_diag.fleet.run.judge", fleet_tasks.quick)
    (tmp_path / "bags").mkdir()
    monkeypatch.chdir(tmp_path)
    for day in range(5):
        fleet_tasks.small_bag(Path("bags") / f"{day}.mcap", day)
    given = config()
    fleet = Fleet(find_bags([Path("bags")]), given, given.joints)
    with pool_tasks.PoolHere() as local, Journal(tmp_path / "local") as journal:
        expected = diagnose_fleet(fleet, local, journal)
    with dask.pool() as pool, Journal(tmp_path / "cluster") as journal:
        assert diagnose_fleet(fleet, pool, journal) == expected
    assert len(expected) == 5
    assert len(dask.begun()) == 10


@pytest.mark.slow
def test_a_scheduler_that_goes_ends_the_run(dask: Cluster) -> None:
    def tick() -> None:
        if len(dask.begun()) >= 2:
            dask.scheduler.kill()

    with pytest.raises(FleetError, match="is gone"), dask.pool() as pool:
        list(run(pool, pool_tasks.slow_square, range(50), tick))


def test_no_scheduler(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr(cluster, "_CONNECT", 1.0)
    with pytest.raises(FleetError, match=r"no Dask scheduler at tcp://127\.0\.0\.1:9"):
        ClusterPool("tcp://127.0.0.1:9")
    for none in ("nonsense://x", "host", "http://x:1", "tls://127.0.0.1:1", "ucx://x:1", "inproc://"):
        with pytest.raises(FleetError, match=rf"no Dask scheduler at {none}: .*like tcp://host:8786"):
            ClusterPool(none)

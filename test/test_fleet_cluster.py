"""Tasks on the workers of a Dask scheduler: real processes on loopback, some of them killed."""

import json
import os
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import fleet_tasks
import pool_tasks
import pytest
from live import config

from hd_diag.fleet import FleetError, cluster
from hd_diag.fleet.cluster import ClusterPool
from hd_diag.fleet.journal import Journal
from hd_diag.fleet.run import Fleet, diagnose_fleet
from hd_diag.fleet.survey import find_bags
from hd_diag.process_pool import ATTEMPTS, Failure, run

pytest.importorskip("distributed")

WORKERS = 3


class Cluster:
    """A scheduler and workers, each a process of its own; what they note goes into `calls`."""

    def __init__(self, stack: ExitStack, folder: Path, workers: int) -> None:
        self.calls = folder / "calls"
        self.calls.mkdir()
        self._stack, self._folder = stack, folder
        self._file = folder / "scheduler.json"
        self.scheduler = self._start("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file")
        for _ in range(workers):
            self.worker()

    def worker(self) -> None:
        """Without a nanny: who is killed stays dead."""
        local = ("--local-directory", str(self._folder), "--host", "127.0.0.1")
        self._start("worker", "--nthreads", "1", "--no-nanny", *local, "--scheduler-file")

    def _start(self, role: str, *arguments: str) -> subprocess.Popen[bytes]:
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
        environment[pool_tasks.CALLS] = str(self.calls)
        command = [sys.executable, "-m", f"distributed.cli.dask_{role}", "--no-dashboard", *arguments]
        process = subprocess.Popen(
            [*command, str(self._file)], env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        self._stack.enter_context(process)
        self._stack.callback(process.kill)
        return process

    @property
    def address(self) -> str:
        pool_tasks.wait_for(lambda: self._file.exists() and self._file.read_text().endswith("}"))
        return str(json.loads(self._file.read_text())["address"])

    def begun(self) -> list[tuple[str, int]]:
        return pool_tasks.calls(self.calls)


@pytest.fixture
def dask(tmp_path: Path) -> Iterator[Cluster]:
    with ExitStack() as stack:
        yield Cluster(stack, tmp_path, WORKERS)


@pytest.fixture
def one_worker(tmp_path: Path) -> Iterator[Cluster]:
    with ExitStack() as stack:
        yield Cluster(stack, tmp_path, 1)


@pytest.mark.slow
def test_a_worker_killed_in_its_work_loses_no_result(dask: Cluster) -> None:
    killed: list[int] = []

    def tick() -> None:
        begun = dask.begun()
        if len(begun) >= WORKERS + 2 and not killed:
            killed.append(begun[-1][1])
            os.kill(killed[0], signal.SIGKILL)

    with ClusterPool(dask.address) as pool:
        results = sorted(run(pool, pool_tasks.slow_square, range(15), tick))
    assert results == [(n, n * n) for n in range(15)]
    begun = dask.begun()
    again = [name for name, times in Counter(name for name, _ in begun).items() if times > 1]
    assert len(again) == 1
    first, second = (process for name, process in begun if name == again[0])
    assert (first, second != first) == (killed[0], True)
    assert len({process for _, process in begun}) > 1


@pytest.mark.slow
def test_what_kills_its_workers_fails_alone(dask: Cluster) -> None:
    """As on one machine, whatever the scheduler is set to; a worker comes for each that goes."""
    alive = WORKERS

    def tick() -> None:
        nonlocal alive
        deaths = sum(name == "7" for name, _ in dask.begun())
        if WORKERS - deaths < alive:
            alive -= 1
            dask.worker()

    with ClusterPool(dask.address) as pool:
        results = dict(run(pool, pool_tasks.deadly_seven, range(12), tick))
    assert {n: r for n, r in results.items() if n != 7} == {n: n * n for n in range(12) if n != 7}
    assert isinstance(results[7], Failure)
    assert Counter(name for name, _ in dask.begun())["7"] == ATTEMPTS


@pytest.mark.slow
def test_what_hangs_ends_its_worker_once_and_the_others_go_on(dask: Cluster) -> None:
    names = ["a", "fifo", "b", "pattern", "c", "d"]
    with ClusterPool(dask.address) as pool:
        results = dict(run(pool, pool_tasks.stuck, names, timeout=1.0))
    late = Failure("took longer than 1 s")
    assert results == {0: "a", 1: late, 2: "b", 3: late, 4: "c", 5: "d"}
    assert sorted(name for name, _ in dask.begun()) == sorted(names)


def test_the_cluster_makes_the_same_rows(
    one_worker: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From paths alone, though it is in another folder; and what raises is a failure of its own."""
    monkeypatch.setattr("hd_diag.fleet.run.judge", fleet_tasks.quick)
    (tmp_path / "bags").mkdir()
    monkeypatch.chdir(tmp_path)
    for day in range(5):
        fleet_tasks.small_bag(Path("bags") / f"{day}.mcap", day)
    given = config()
    fleet = Fleet(find_bags([Path("bags")]), given, given.joints)
    monkeypatch.setenv(pool_tasks.CALLS, str(one_worker.calls))
    with pool_tasks.PoolHere() as local, Journal(tmp_path / "local") as journal:
        expected = diagnose_fleet(fleet, local, journal)
    with ClusterPool(one_worker.address) as pool, Journal(tmp_path / "cluster") as journal:
        assert diagnose_fleet(fleet, pool, journal) == expected
        assert dict(run(pool, pool_tasks.faulty, [1, 3])) == {0: 1, 1: Failure("Unsendable: 3: no")}
    assert len(expected) == 5
    assert len(one_worker.begun()) == 10


@pytest.mark.slow
def test_a_scheduler_that_goes_ends_the_run(dask: Cluster) -> None:
    def tick() -> None:
        if len(dask.begun()) >= 2:
            dask.scheduler.kill()

    with pytest.raises(FleetError, match="is gone"), ClusterPool(dask.address) as pool:
        list(run(pool, pool_tasks.slow_square, range(50), tick))


def test_no_scheduler(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "_CONNECT", 1.0)
    with pytest.raises(FleetError, match=r"no Dask scheduler at tcp://127\.0\.0\.1:9"):
        ClusterPool("tcp://127.0.0.1:9")
    for none in ("nonsense://x", "host", "http://x:1", "tls://127.0.0.1:1", "ucx://x:1", "inproc://"):
        with pytest.raises(FleetError, match=rf"no Dask scheduler at {none}: .*like tcp://host:8786"):
            ClusterPool(none)

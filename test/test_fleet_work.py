"""Tasks on processes of this machine, some of which die."""

import multiprocessing
import os
import signal
import subprocess
import sys
from collections import Counter
from pathlib import Path

import fleet_tasks
import pytest

from hd_diag.fleet.work import ATTEMPTS, Failure, LocalCrew, run


@pytest.fixture
def noted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "calls"
    folder.mkdir()
    monkeypatch.setenv(fleet_tasks.CALLS, str(folder))
    return folder


def test_every_item_comes_once() -> None:
    with LocalCrew(2) as crew:
        results = list(run(crew, fleet_tasks.square, range(20)))
    assert sorted(results) == [(n, n * n) for n in range(20)]


def test_nothing_to_do_starts_no_process() -> None:
    before = multiprocessing.active_children()
    with LocalCrew(2) as crew:
        assert list(run(crew, fleet_tasks.square, [])) == []
        assert multiprocessing.active_children() == before


def test_what_kills_its_worker_fails_alone(noted: Path) -> None:
    with LocalCrew(2) as crew:
        results = dict(run(crew, fleet_tasks.deadly_seven, range(12)))
    assert {n: r for n, r in results.items() if n != 7} == {n: n * n for n in range(12) if n != 7}
    failure = results[7]
    assert isinstance(failure, Failure)
    assert failure.text.startswith(f"its worker died in each of {ATTEMPTS} attempts")
    begun = Counter(name for name, _ in fleet_tasks.calls(noted))
    assert begun == {str(n): ATTEMPTS if n == 7 else 1 for n in range(12)}


def test_a_worker_that_is_killed_loses_nothing(noted: Path) -> None:
    killed: list[int] = []

    def tick() -> None:
        begun = fleet_tasks.calls(noted)
        if len(begun) >= 3 and not killed:
            killed.append(begun[-1][1])
            os.kill(killed[0], signal.SIGKILL)

    with LocalCrew(2) as crew:
        results = sorted(run(crew, fleet_tasks.slow_square, range(6), tick))
    assert results == [(n, n * n) for n in range(6)]
    assert len(killed) == 1
    assert len(fleet_tasks.calls(noted)) == 7


def test_what_hangs_ends_its_worker_once_and_the_others_go_on(noted: Path) -> None:
    names = ["a", "fifo", "b", "pattern", "c", "d"]
    with LocalCrew(1) as crew:
        results = dict(run(crew, fleet_tasks.stuck, names, timeout=1.0))
    late = Failure("took longer than 1 s")
    assert results == {**{name: name for name in names}, "fifo": late, "pattern": late}
    begun = fleet_tasks.calls(noted)
    assert [name for name, _ in begun] == names
    assert len({process for _, process in begun}) == 3


def test_time_is_that_of_each_item(noted: Path) -> None:
    """Not of the worker, and none goes on after its item."""
    with LocalCrew(1) as crew:
        results = list(run(crew, fleet_tasks.slow_square, range(8), timeout=3.0))
    assert results == [(n, n * n) for n in range(8)]
    assert len({process for _, process in fleet_tasks.calls(noted)}) == 1


def test_what_raises_is_a_failure_even_where_it_cannot_be_sent() -> None:
    with LocalCrew(1) as crew:
        results = dict(run(crew, fleet_tasks.faulty, range(5)))
    assert results == {0: 0, 1: 1, 2: 2, 3: Failure("Unsendable: 3: no"), 4: 4}


def test_a_worker_has_one_thread_and_this_process_what_it_had(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
    with LocalCrew(1) as crew:
        assert dict(run(crew, fleet_tasks.setting, names)) == dict.fromkeys(names, "1")
    assert [os.environ.get(name) for name in names] == ["7", None]


@pytest.mark.skipif(sys.platform != "linux", reason="limits of data are Linux's")
def test_memory_beyond_the_bound_is_a_failure_and_the_next_task_goes_on() -> None:
    bound = 1 << 30
    with LocalCrew(1, bound) as crew:
        results = dict(run(crew, fleet_tasks.greedy, [1 << 20, 2 * bound, 1 << 21]))
    assert results[1 << 20] == 1 << 17
    assert results[2 * bound] == Failure("needs more memory than a worker may have")
    assert results[1 << 21] == 1 << 18


def test_an_interruption_ends_the_processes(noted: Path) -> None:
    before = set(multiprocessing.active_children())

    def tick() -> None:
        if len(fleet_tasks.calls(noted)) >= 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), LocalCrew(2) as crew:
        list(run(crew, fleet_tasks.slow_square, range(50), tick))
    fleet_tasks.wait_for(lambda: set(multiprocessing.active_children()) == before)


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks at processes as Linux shows them")
def test_workers_of_a_killed_parent_end(noted: Path) -> None:
    code = (
        "import fleet_tasks; from hd_diag.fleet.work import LocalCrew, run\n"
        "with LocalCrew(1) as crew: list(run(crew, fleet_tasks.slow_square, range(1000)))"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen([sys.executable, "-c", code], env=environment) as parent:
        fleet_tasks.wait_for(lambda: fleet_tasks.calls(noted))
        parent.kill()
    worker = fleet_tasks.calls(noted)[0][1]
    fleet_tasks.wait_for(lambda: not fleet_tasks.alive(worker))

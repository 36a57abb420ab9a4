"""Counting of `make soak`: losses, excuses for a full disk, memory."""

import dataclasses
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).resolve().parent.parent / "bench"))

import soak_result as soak

SECOND = 10**9
SENT = np.column_stack((7 + 10**6 * np.arange(60_000), 10**6 * np.arange(60_000)))  # a minute at 1 kHz


@pytest.mark.parametrize(
    ("gone", "full", "found"),
    [
        ([], [], (0, 0)),
        ([(100, 101)], [], (1, 0)),
        ([(20_000, 31_000)], [(20, 30)], (0, 11_000)),
        ([(20_000, 31_000), (25_000, 25_001), (40_000, 40_002)], [(20, 30)], (2, 11_000)),
        ([(15_000, 31_000)], [(20, 30)], (3000, 13_000)),
        ([(20_000, 24_000), (25_000, 26_000)], [(20, 30)], (1000, 4000)),
        ([(20_000, 24_000), (50_000, 52_000)], [(20, 24), (50, 52)], (0, 6000)),
    ],
)
def test_a_full_disk_excuses_one_run_of_messages_about_its_time(gone, full, found) -> None:
    there = np.ones(len(SENT), bool)
    for first, end in gone:
        there[first:end] = False
    windows = [(begin * SECOND, end * SECOND) for begin, end in full]
    assert soak.missing(SENT, SENT[there, 0], windows) == found


def test_the_second_tenth_is_compared_with_the_last() -> None:
    flat = [(float(at), 100.0 + 50.0 * (at < 10)) for at in range(100)]
    assert soak.medians(flat, 100.0) == (100.0, 100.0)
    assert soak.medians([(at, size + 5.0 * (at > 80)) for at, size in flat], 100.0) == (100.0, 105.0)
    assert np.isnan(soak.medians(flat[:5], 100.0)).all()


def test_the_most_or_least_of_the_halves_is_compared() -> None:
    """For short-lived things, such as the thread that writes a log, or a file that is soon closed."""
    come_and_go = [(float(at), 18.0 + (at % 7 == 0)) for at in range(100)]
    assert soak.halves(come_and_go, 100.0, max) == (19.0, 19.0)
    assert soak.halves([(at, size + (at > 90)) for at, size in come_and_go], 100.0, max) == (19.0, 20.0)
    assert soak.halves([(at, size + (at == 90)) for at, size in come_and_go], 100.0, min) == (18.0, 18.0)
    assert soak.halves([(at, size + (at > 40)) for at, size in come_and_go], 100.0, min) == (18.0, 19.0)
    assert np.isnan(soak.halves([], 100.0, max)).all()


def test_retention_and_diagnoses_are_judged() -> None:
    """Old files are deleted; each diagnosis except for the last ends with a verdict."""
    seen = soak.Observed(max_age=60.0, oldest=70.0, deleted=3)
    seen.counts |= {"diagnosis begun": 3, "verdict": 2}
    for change, holds in (
        ({}, [True, True]),
        ({"counts": seen.counts | {"verdict": 1}}, [True, False]),
        ({"failed_diagnoses": ["failed: was ended by SIGKILL"]}, [True, False]),
        ({"oldest": 90.0}, [False, True]),
        ({"deleted": 0}, [False, True]),
    ):
        changed = dataclasses.replace(seen, **change)
        assert [row[3] for row in soak.of_log(changed, 600.0)] == holds, change


def test_memory_threads_and_open_files_are_those_of_the_process(tmp_path: Path) -> None:
    """An existing log file does not count; a deleted one that is still open does."""
    code = "input(); kept = b'1' * 40_000_000; opened = open('/dev/null'); Thread(target=input).start()"
    code += f"; there, gone = (open('{tmp_path}/' + name, 'w') for name in ('there', 'gone'))"
    code = f"{code}; os.unlink(gone.name)"
    code = f"import os; from threading import Thread; print(flush=True); {code}; print(flush=True)"
    command, seen = [sys.executable, "-c", code], soak.Observed()
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        for at in (0.0, 1.0):
            assert process.stdout.readline() == b"\n"
            seen.take(at, process.pid, tmp_path)
            process.stdin.write(b"\n")
            process.stdin.flush()
    (_, before), (_, after) = seen.memory
    assert 0.9 * 40e6 < (after - before) * 2.0**20 < 1.5 * 40e6
    assert seen.threads[1][1] - seen.threads[0][1] == 1
    assert seen.open_files[1][1] - seen.open_files[0][1] == 2

"""Observations of bench/soak.py, and their table."""

# ruff: noqa: D103

from __future__ import annotations

import argparse
import contextlib
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

STEPS = (
    "snapshot",
    "publisher restarted",
    "clock set ahead",
    "publisher restarted",
    "clock set back",
    "disk full",
)
ASKED = ("parameter changed", "diagnosis begun", "diagnosis refused", "verdict")
RETENTION = 20.0  # delay until an old file is gone: the node looks every 10 s [s]
ANSWER, GROWTH = 1.0, 0.02  # largest time of an answer [s], growth of the memory [1]
AROUND = 2_000_000_000  # margin around a full disk: unwritten messages, detection of free space [ns]


@dataclass
class Observed:
    """Observations of a run; times are the system's [ns]."""

    counts: dict[str, int] = field(default_factory=lambda: dict.fromkeys((*dict.fromkeys(STEPS), *ASKED), 0))
    refused: list[str] = field(default_factory=list)
    answers: list[float] = field(default_factory=list)
    memory: list[tuple[float, float]] = field(default_factory=list)
    threads: list[tuple[float, float]] = field(default_factory=list)
    open_files: list[tuple[float, float]] = field(default_factory=list)
    full: list[list[int]] = field(default_factory=list)
    failures: int = 0
    returns: int = 0
    logged: list[np.ndarray] = field(default_factory=list)
    files: int = 0
    unfinished: int = 0
    deleted: int = 0
    oldest: float = 0.0
    max_age: float = 0.0
    failed_diagnoses: list[str] = field(default_factory=list)
    values: list[dict[str, str]] = field(default_factory=list)
    cpu: float = 0.0
    waited: float = 0.0
    code: int | None = None

    @property
    def used(self) -> int:
        """Samples used or rejected, the lowest number of all joints."""
        return min((int(v["samples"]) + int(v["samples_rejected"]) for v in self.values), default=0)

    def take(self, now: float, process: int, log: Path) -> None:
        """Note resident memory [MB], threads and open files of a process with a log, at a time [s]."""
        status = Path(f"/proc/{process}/status").read_text()
        size, threads = (int(re.findall(rf"{name}:\s+(\d+)", status)[0]) for name in ("VmRSS", "Threads"))
        self.memory.append((now, size / 1024.0))
        self.threads.append((now, threads))
        self.open_files.append((now, open_files(process, log)))


def open_files(process: int, log: Path) -> int:
    """Number of open files of a process, except for existing files of its log: a diagnosis keeps those open.

    A log file that stays open after its deletion by age counts.
    """
    count = 0
    for each in Path(f"/proc/{process}/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # closed meanwhile
            place = os.readlink(each)
            count += not place.startswith(f"{log}/") or place.endswith(" (deleted)")
    return count


def missing(sent: np.ndarray, logged: np.ndarray, full: Sequence[Sequence[int]]) -> tuple[int, int]:
    """Number of messages missing from the log without an excuse, and number lost to a full disk.

    Rows of `sent` are stamp and send time [ns]. For each interval of a full disk [begin, end], one run of
    consecutive messages may be missing, if they were sent around that interval.
    """
    absent = ~np.isin(sent[:, 0], logged)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], absent, [False])).astype(int))).reshape(-1, 2)
    excused = 0
    for begin, end in full:
        about = (sent[:, 1] >= begin - AROUND) & (sent[:, 1] <= end + AROUND)
        excused += max((int(about[first:last].sum()) for first, last in edges), default=0)
    return int(absent.sum()) - excused, excused


def medians(seen: Sequence[tuple[float, float]], seconds: float) -> tuple[float, float]:
    """Medians of the observations in the second and the last tenth of the run; nan if there are none."""
    early = [value for at, value in seen if 0.1 * seconds <= at < 0.2 * seconds]
    late = [value for at, value in seen if at >= 0.9 * seconds]
    return float(np.median(early or np.nan)), float(np.median(late or np.nan))


def halves(
    seen: Sequence[tuple[float, float]], seconds: float, extreme: Callable[..., float]
) -> tuple[float, float]:
    """The extreme observation in each half of the run; nan if there is none."""
    parts = [[value for at, value in seen if (at >= 0.5 * seconds) == late] for late in (False, True)]
    first, second = (extreme(part, default=float("nan")) for part in parts)
    return first, second


Row = tuple[str, str, str, bool]
"""What was checked, the expectation, the observation, whether it holds."""


def result(seen: Observed, sent: np.ndarray, took: float) -> list[Row]:
    logged = np.concatenate([np.empty(0, np.int64), *seen.logged])
    lost, excused = missing(sent, logged, seen.full)
    strange = int((~np.isin(logged, sent[:, 0])).sum())
    twice = logged.size - np.unique(logged).size
    early, late = medians(seen.memory, took)
    grown, sizes = late / early - 1.0, [size for _, size in seen.memory]
    slowest = max(seen.answers, default=float("nan"))
    full = seen.counts["disk full"]
    return [
        (
            "messages that are neither in the log nor sent while the disk was full",
            "0",
            f"{lost:,}",
            lost == 0,
        ),
        ("messages not in the log because the disk was full", "", f"{excused:,}", True),
        ("messages logged twice, or never sent", "0", f"{twice:,}, {strange:,}", not twice and not strange),
        (
            "samples used or rejected, least of all joints",
            f"{len(sent):,}",
            f"{seen.used:,}",
            seen.used == len(sent),
        ),
        (
            "times that the full disk was told, and the log went on",
            f"{full}, {full}",
            f"{seen.failures}, {seen.returns}",
            (seen.failures, seen.returns) == (full, full),
        ),
        (
            "files of the log without an end, of all",
            f"at most {full}",
            f"{seen.unfinished} of {seen.files}",
            seen.unfinished <= full and seen.files > 0,
        ),
        (
            "parameter changes refused, and calls for the log or a snapshot",
            "0",
            f"{len(seen.refused)} of {seen.counts['parameter changed'] + 3 * seen.counts['snapshot']}",
            not seen.refused,
        ),
        *of_log(seen, took),
        ("slowest answer to a request", f"{ANSWER:g} s", f"{slowest:.2g} s", slowest <= ANSWER),
        (
            "memory, last tenth over second tenth",
            f"within {100.0 * GROWTH:g} %",
            f"{100.0 * grown:+.1f} %, {sizes[-1] if sizes else 0.0:.0f} MB",
            grown <= GROWTH,
        ),
        *(
            (f"{name}, first half and second", "no more", f"{a:g}, {b:g}", b <= a)
            for name, (a, b) in (
                ("most threads", halves(seen.threads, took, max)),
                # The minimum: some files are open for 20 ms, such as /proc/self/smaps; a leaked one stays.
                ("least open files beside the log's", halves(seen.open_files, took, min)),
            )
        ),
        ("CPU of the node, of one core", "", f"{100.0 * seen.cpu / took:.0f} %" if took else "", True),
        (
            "time that its first thread could run and had no core",
            "",
            f"{100.0 * seen.waited / took:.0f} %" if took else "",
            True,
        ),
        ("exit code of the node", "0", str(seen.code), seen.code == 0),
    ]


def of_log(seen: Observed, took: float) -> list[Row]:
    """Results for retention and diagnoses."""
    oldest, begun, found = (
        1.1 * seen.max_age + RETENTION,
        seen.counts["diagnosis begun"],
        seen.counts["verdict"],
    )
    failed = seen.failed_diagnoses
    return [
        (
            "age of the oldest file of the log while no diagnosis reads it, and how many were deleted",
            f"at most {oldest:.0f} s, some",
            f"{seen.oldest:.0f} s, {seen.deleted}",
            seen.oldest <= oldest and (seen.deleted > 0 or took < 2.0 * oldest),
        ),
        (
            "verdicts of diagnoses beside it, and how many failed",
            f"at least {max(0, begun - 1)}, 0",  # the last one may end with the node
            f"{found}, {len(failed)}{': ' * bool(failed)}{'; '.join(failed)}",
            found >= begun - 1 and not failed,
        ),
    ]


def machine() -> str:
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    model = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")
    return f"{model}, {len(os.sched_getaffinity(0))} cores, load {os.getloadavg()[1]:.1f}"


def heading(seen: Observed, sent: int, took: float, options: argparse.Namespace, interrupted: bool) -> str:
    done = [f"{name} {count} times" for name, count in seen.counts.items()]
    end = f", interrupted (of {options.seconds:,.0f} s)" if interrupted else ""
    return (
        f"{took:,.0f} s{end}, {options.joints} joints at {options.rate:,.0f} Hz, {sent:,} messages; "
        f"{', '.join(done)}. {machine()}."
    )


HEAD = ("what", "shall be", "seen", "")


def cells(row: Row) -> tuple[str, str, str, str]:
    return (*row[:3], "" if not row[1] else "holds" if row[3] else "DOES NOT HOLD")


def markdown(title: str, rows: Sequence[Row]) -> str:
    lines = [HEAD, ("---", "---:", "---:", "---"), *map(cells, rows)]
    return title + "\n\n" + "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"

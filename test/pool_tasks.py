"""Tasks of pool workers in the tests; a light module, because workers import it."""

import dataclasses
import os
import re
import signal
import time
from collections.abc import Callable, Mapping
from pathlib import Path

CALLS = "HD_DIAG_TEST_CALLS"  # environment: folder in which every call leaves a file


def note(name: object) -> None:
    folder = os.environ.get(CALLS)
    if folder:
        Path(folder, f"{name}~{os.getpid()}~{time.monotonic_ns()}").touch()


def calls(folder: Path) -> list[tuple[str, int]]:
    """Name and process of every call, in order of time."""
    noted = sorted((path.name.split("~") for path in folder.iterdir()), key=lambda parts: int(parts[2]))
    return [(name, int(process)) for name, process, _ in noted]


def square(number: int) -> int:
    return number * number


def slow_square(number: int) -> int:
    note(number)
    time.sleep(0.4)
    return number * number


def slower_first(number: int) -> int:
    time.sleep(0.2 if number == 0 else 0.0)
    return number


def deadly_seven(number: int) -> int:
    note(number)
    if number == 7:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.05)
    return number * number


def faulty(number: int) -> int:
    if number == 3:
        raise Unsendable(number, "no")
    return number


def greedy(size: int) -> int:
    return len(bytes(size))


def stuck(name: str) -> str:
    """Hang for ever: in a system call for ``fifo``, holding the interpreter's lock for ``pattern``."""
    note(name)
    time.sleep(0.4)
    if name == "fifo":
        folder = Path(os.environ[CALLS]).parent
        os.mkfifo(folder / "fifo")
        (folder / "fifo").read_bytes()
    if name == "pattern":
        re.match("(a+)+$", "a" * 60 + "b")
    return name


def setting(name: str) -> str | None:
    return os.environ.get(name)


class Unsendable(Exception):
    """An exception that pickle cannot restore, like many."""

    def __init__(self, number: int, text: str) -> None:
        super().__init__(f"{number}: {text}")


class PoolHere:
    """Replacement for a pool of processes: runs its tasks at once in this process."""

    def workers(self) -> list[int]:
        return [0]

    def send(self, worker: int, function: Callable[[object], object], item: object) -> "Outcome":
        return Outcome(function(item))

    def done(self, at_work: Mapping["Outcome", int], patience: float) -> list[tuple["Outcome", object]]:
        return [(task, task.value) for task in at_work]

    def __enter__(self) -> "PoolHere":
        return self

    def __exit__(self, *reason: object) -> None:
        pass


@dataclasses.dataclass(eq=False)
class Outcome:
    """Value of a task that has run."""

    value: object


def alive(process: int) -> bool:
    """Whether a process runs; a zombie does not."""
    try:
        return "\nState:\tZ" not in Path(f"/proc/{process}/status").read_text()
    except OSError:
        return False


def wait_for(condition: Callable[[], object], patience: float = 60.0) -> None:
    end = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)

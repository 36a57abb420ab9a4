"""The memory of a snapshot: what it keeps, in which order, within a time and size; what it becomes."""

import errno
import itertools
import os
import random
from pathlib import Path

import pytest
from bag_samples import STRING, string_cdr
from live import START
from logs import messages_of
from pool_tasks import wait_for

from hd_diag.bag import BagError, Memory, Received
from hd_diag.config.configuration import LogConfig
from hd_diag.ros.log_writer import LogWriter

SECOND = 1_000_000_000


def held(memory: Memory) -> list[int]:
    found = []
    while memory:
        found += [each.time for each in memory.take()]
    return found


@pytest.mark.parametrize("size", [10, 200_000])
def test_it_keeps_the_last_seconds_in_order_from_the_beginning_of_a_part(size: int) -> None:
    memory = Memory(10.0, 10**9)
    for now in range(START, START + 50 * SECOND, SECOND // 10):
        if memory.is_due(now):
            memory.begin_part(now)
        memory.put(Received("/x", STRING, string_cdr(f"{now:0{size}d}"), now, None))
    length, times = memory.seconds, held(memory)
    assert times == [*range(times[0], START + 50 * SECOND, SECOND // 10)]
    assert 10.0 <= len(times) * 0.1 <= 11.1
    assert length == pytest.approx((times[-1] - times[0]) * 1e-9)
    assert (memory.size, memory.seconds, bool(memory)) == (0, 0.0, False)


@pytest.mark.parametrize(("size", "count", "part"), [(10, 3000, 100), (4000, 3000, 100), (100_000, 300, 10)])
def test_beyond_its_size_the_oldest_give_way_and_are_counted(size: int, count: int, part: int) -> None:
    """Incompressible data, compressed or not yet; of a part that was partly taken, only the rest counts."""
    memory, gone, taken, noise = Memory(1e6, 3_000_000), 0, 0, random.Random(1)
    for number in range(count):
        if number % part == 0:
            memory.begin_part(START + number)
        gone += memory.put(Received("/x", STRING, noise.randbytes(size), START + number, None))
        assert memory.size <= 3_000_000
        if number == count // 2:
            taken += len(memory.take())
    left = held(memory)
    assert (gone + taken + len(left), left[-1]) == (count, START + count - 1)
    assert (taken > 0, gone > 0) == (True, size > 10)


@pytest.mark.parametrize("is_full", [False, True], ids=["slow disk", "full disk"])
def test_what_overflows_while_a_snapshot_is_written_is_counted(is_full, tmp_path, monkeypatch) -> None:
    """Messages come faster than they are written; afterwards the log must start again."""
    writer = log(tmp_path / "log", mode="snapshot", before=30.0, memory=1_000_000)
    clock, noise = itertools.count(START), random.Random(1)

    def come(count: int) -> None:
        for now in itertools.islice(clock, count):
            writer.write("/x", STRING, noise.randbytes(100_000), now)

    def full(fd: int, data: bytes) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    writer.split_if_due(START)
    come(5)
    assert writer.facts["log_lost"] == "0"
    with monkeypatch.context() as disk:
        if is_full:
            disk.setattr(os, "write", full)
        writer.record()
        come(20)
        assert writer.state.startswith("failed: ")
    wait_for(writer.flush_if_due)
    come(5)
    writer.stop()
    writer.close()
    written = len(messages_of(writer.bags[0]))
    assert (written, int(writer.facts["log_lost"])) == (5, 25)


def log(path: Path, **options: object) -> LogWriter:
    return LogWriter(LogConfig(str(path), **options))  # type: ignore[arg-type]


def test_a_snapshot_has_what_was_before_and_after_and_nothing_comes_twice(tmp_path: Path) -> None:
    """The memory is written in steps while more messages come; then it starts again."""
    writer = log(tmp_path / "log", mode="snapshot", before=30.0, after=0.0)
    assert writer.state == "keeping the last 30 s"
    assert not (tmp_path / "log").exists()
    clock = itertools.count(START, SECOND // 10)

    def come(count: int) -> None:
        for now in itertools.islice(clock, count):
            writer.split_if_due(now)
            writer.write("/x", STRING, string_cdr("x" * 20_000), now)

    for _ in range(2):
        come(1000)
        assert not writer.record(0.0)
        while writer.is_recording:
            come(3)
            writer.flush_if_due()
        assert writer.state == "keeping the last 30 s"
    come(10)
    writer.close()
    assert writer.state == "off"
    times = [time for bag in writer.bags for *_, time in messages_of(bag)]
    assert (len(writer.bags), writer.facts["log_lost"]) == (2, "0")
    assert times == sorted(set(times))
    assert len(times) >= 2 * 300


def test_it_is_off_until_asked_and_again_once_it_is_stopped(tmp_path: Path) -> None:
    writer = log(tmp_path / "log", mode="off")
    writer.write("/x", STRING, string_cdr("before"), START)
    assert writer.state == "off"
    for number in (1, 2):
        assert writer.record()
        assert writer.state == f"writing {writer.bags[-1]}"
        writer.write("/x", STRING, string_cdr("in"), START + number)
        writer.stop()
        writer.flush_if_due()
        assert writer.state == "off"
    writer.close()
    assert [len(messages_of(bag)) for bag in writer.bags] == [1, 1]
    with pytest.raises(BagError, match=r"log\.path: is empty"):
        LogWriter(LogConfig("", mode="snapshot")).record()

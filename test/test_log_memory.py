"""The memory of a snapshot: what it keeps, in order, within a time and a size; what comes of it."""

import random
import time
from pathlib import Path

import pytest
from bag_samples import STRING, string_cdr
from live import START

from hd_diag.bag import BagError, BagReader, Memory, Received
from hd_diag.config.configuration import LogConfig
from hd_diag.ros.log_writer import LogWriter

SECOND = 1_000_000_000


def message(time: int, size: int = 10) -> Received:
    return Received("/x", STRING, string_cdr(f"{time:0{size}d}"), time, None)


def held(memory: Memory) -> list[int]:
    found = []
    while memory:
        found += [each.time for each in memory.take()]
    return found


def filled(seconds: float, most_bytes: int, count: int, size: int = 10) -> Memory:
    """A message each tenth of a second, parts as they are due."""
    memory = Memory(seconds, most_bytes)
    for number in range(count):
        now = START + number * SECOND // 10
        if memory.is_due(now):
            memory.begin_part(now)
        memory.put(message(now, size))
    return memory


@pytest.mark.parametrize("size", [10, 200_000])
def test_it_keeps_the_last_seconds_in_order_from_the_beginning_of_a_part(size: int) -> None:
    memory = filled(10.0, 10**9, 500, size)
    length = memory.seconds
    times = held(memory)
    last = START + 499 * SECOND // 10
    assert times == [last - (len(times) - 1 - n) * SECOND // 10 for n in range(len(times))]
    assert 10.0 <= len(times) * 0.1 <= 11.1
    assert length == pytest.approx((times[-1] - times[0]) * 1e-9)
    assert (memory.size, memory.seconds, bool(memory)) == (0, 0.0, False)


def test_it_takes_no_more_than_its_size_whatever_comes() -> None:
    """What does not shrink; the oldest gives way, a part that is too large by itself all."""
    memory = filled(100.0, 400_000, 400)
    assert memory.size <= 400_000
    noise = random.Random(1)
    memory = Memory(10.0, 3_000_000)
    for number in range(300):
        now = START + number * SECOND // 10
        if memory.is_due(now):
            memory.begin_part(now)
        memory.put(Received("/x", STRING, noise.randbytes(100_000), now, None))
        assert memory.size <= 3_000_000
    times = held(memory)
    assert 10 <= len(times) <= 30
    assert times[-1] == START + 299 * SECOND // 10


@pytest.mark.parametrize("size", [10, 4000])
def test_what_gives_way_is_counted(size: int) -> None:
    """Whether it is compressed or not yet; of a part of which some was taken only the rest."""
    memory, count, gone, taken, noise = Memory(1e6, 1_000_000), 3000, 0, 0, random.Random(1)
    for number in range(count):
        if number % 100 == 0:
            memory.begin_part(START + number)
        gone += memory.put(Received("/x", STRING, noise.randbytes(size), START + number, None))
        if number == count // 2:
            taken += len(memory.take())
    left = len(held(memory))
    assert gone + taken + left == count
    assert min(taken, left) > 0
    assert (gone > 0) == (size > 10)


def test_what_overflows_while_a_snapshot_is_written_is_lost_and_counted(tmp_path: Path) -> None:
    """Of messages that come faster than they are written; then the log needs a new beginning."""
    writer = log(tmp_path / "log", mode="snapshot", before=30.0, memory=1_000_000)
    given, noise = 0, random.Random(1)

    def come(count: int, size: int = 100_000) -> None:
        nonlocal given
        for _ in range(count):
            writer.write("/x", STRING, noise.randbytes(size), START + given)
            given += 1

    writer.split_if_due(START)
    come(5)
    assert writer.facts["log_lost"] == "0"
    writer.record()
    come(20)
    assert writer.state.startswith("failed: log.memory")
    deadline = time.monotonic() + 10.0
    while not writer.flush_if_due():
        assert time.monotonic() < deadline
        time.sleep(0.01)
    come(5)
    writer.stop()
    writer.close()
    with BagReader(writer.bags[0]) as reader:
        assert reader.message_count + int(writer.facts["log_lost"]) == given == 30
        assert reader.message_count == 5


def log(path: Path, **options: object) -> LogWriter:
    return LogWriter(LogConfig(str(path), **options))  # type: ignore[arg-type]


def test_a_snapshot_has_what_was_before_and_after_and_nothing_comes_twice(tmp_path: Path) -> None:
    """The memory is written little by little, while more comes; then it begins anew."""
    writer = log(tmp_path / "log", mode="snapshot", before=30.0, after=0.0)
    assert writer.state == "keeping the last 30 s"
    assert not (tmp_path / "log").exists()
    number = 0

    def come(count: int) -> None:
        nonlocal number
        for _ in range(count):
            now = START + number * SECOND // 10
            writer.split_if_due(now)
            writer.write("/x", STRING, string_cdr("x" * 20_000), now)
            number += 1

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
    times = []
    for bag in writer.bags:
        with BagReader(bag) as reader:
            assert not reader.problems
            times += [t for batch in reader.batches() for t in batch.log_time.tolist()]
    assert len(writer.bags) == 2
    assert times == sorted(set(times))
    assert len(times) >= 2 * 300
    assert writer.facts["log_lost"] == "0"


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
    for bag in writer.bags:
        with BagReader(bag) as reader:
            assert reader.message_count == 1


def test_a_log_without_a_place_says_so() -> None:
    with pytest.raises(BagError, match=r"log\.path: is empty"):
        LogWriter(LogConfig("", mode="snapshot")).record()

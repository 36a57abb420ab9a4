"""Reading ahead: the same content in the same order, errors in their turn, bounded, and no thread left."""

import gc
import struct
import threading
import time

import pytest
from bag_samples import JOINT_STATE, MS, rows

from hd_diag.bag import BagError, BagReader, BagWriter, mcap_storage, prefetch
from hd_diag.bag.mcap_scan import scan
from hd_diag.bag.prefetch import Ahead

TOPIC = "/joint_states"


def threads():
    return [thread for thread in threading.enumerate() if thread.name.startswith("bag reader")]


@pytest.fixture(autouse=True)
def _no_thread_stays():
    assert not threads()
    yield
    gc.collect()
    assert not threads()


@pytest.fixture
def bag(tmp_path, monkeypatch):
    """Forty chunks of 100 messages, each a stretch of its own."""
    monkeypatch.setattr(mcap_storage, "_STRETCH", 1)
    monkeypatch.setattr("hd_diag.bag.ordering._TARGET", 1)
    path = tmp_path / "a.mcap"
    data, stamps = rows(4000)
    with BagWriter(path, chunk_size=100 * (data.shape[1] + 31)) as writer:
        writer.write_many(TOPIC, JOINT_STATE, data, stamps)
    return path


def contents(path, **keywords):
    """Log time and content of all messages, batch by batch."""
    with BagReader(path) as reader:
        return [entries(batch) for batch in reader.batches(**keywords)]


def entries(batch):
    return list(zip(batch.log_time.tolist(), map(bytes, batch.messages()), strict=True))


def drain(reader, found, most=1 << 40):
    """Add the batches to what was found; Ctrl-C comes after the most that are wanted."""
    for batch in reader.batches():
        found.append(entries(batch))
        if len(found) == most:
            raise KeyboardInterrupt


def taken(items, **sizes):
    """Contents of the items until the error, and the error."""
    made, found = Ahead(items, read_or_fail, lambda item: sizes.get("size", 1)), []
    try:
        for _ in items:
            found.append(made.take())
    except ZeroDivisionError as error:
        return found, error
    finally:
        made.close()
    return found, None


def read_or_fail(item):
    return 1 / item


def test_contents_come_in_order_and_an_error_in_its_turn():
    items = [*range(1, 50), 0, *range(50, 60)]
    found, error = taken(items)
    assert found == [1 / item for item in range(1, 50)]
    assert isinstance(error, ZeroDivisionError)
    assert taken(items, size=1 << 40)[0] == found  # each read in its turn
    assert taken([4]) == ([0.25], None)


def test_no_more_is_read_ahead_than_the_memory_allows():
    begun, size = [], prefetch._MOST // 3 + 1
    made = Ahead(range(20), lambda item: begun.append(item) or item, lambda item: size)
    assert made.take() == 0
    deadline = time.monotonic() + 10
    while len(begun) < 2 and time.monotonic() < deadline:
        time.sleep(0.001)
    time.sleep(0.05)  # whatever could go too far has time to
    assert sorted(begun) == [0, 1]  # of two allowed at once the first was taken
    assert [made.take() for _ in range(19)] == list(range(1, 20))
    made.close()


def test_what_is_too_large_is_read_by_the_caller_in_its_turn():
    readers = []
    sizes = [1, 1, prefetch._MOST + 1, 1]
    made = Ahead(
        range(4), lambda item: readers.append((item, threading.current_thread())), lambda i: sizes[i]
    )
    for _ in sizes:
        made.take()
    made.close()
    assert [item for item, _ in sorted(readers, key=lambda entry: entry[0])] == [0, 1, 2, 3]
    assert {item for item, thread in readers if thread is threading.main_thread()} == {2}


def test_after_closing_nothing_is_read():
    begun = []
    made = Ahead(range(100), begun.append, lambda item: prefetch._MOST // 2)
    made.take()
    made.close()
    count = len(begun)
    with pytest.raises(ValueError, match="was closed"):
        made.take()
    time.sleep(0.02)
    assert len(begun) == count <= 4


def test_the_same_with_and_without_reading_ahead(bag, monkeypatch):
    found = contents(bag)
    some = [e for batch in found for e in batch if 500 * MS <= e[0] < 3000 * MS]
    assert len(found) > 30
    for most in (0, 20_000, 1 << 40):
        monkeypatch.setattr(prefetch, "_MOST", most)
        assert contents(bag) == found
        assert [e for batch in contents(bag, start=500 * MS, end=3000 * MS) for e in batch] == some


@pytest.mark.parametrize("most", [0, 1 << 40])
def test_what_precedes_a_damaged_chunk_is_delivered(bag, monkeypatch, most):
    monkeypatch.setattr(prefetch, "_MOST", most)
    whole = contents(bag)
    with bag.open("rb") as file:
        section = [s for s in scan(bag, file).sections if s.counts][17]
    content = bytearray(bag.read_bytes())
    content[section.offset + section.size // 2] ^= 0x55
    bag.write_bytes(content)
    found = []
    with BagReader(bag) as reader:
        with pytest.raises(BagError, match=rf"a\.mcap: chunk at byte {section.offset} is damaged: "):
            drain(reader, found)
        assert not threads()
    assert found == whole[: len(found)]
    assert len(found) >= 16  # the one before the damage is held until it is known where the next begins


def test_the_process_can_go_on_after_a_consumer_fails(bag):
    with BagReader(bag) as reader:
        with pytest.raises(KeyboardInterrupt):
            drain(reader, [], most=3)
        gc.collect()
        assert not threads()
        assert sum(len(batch) for batch in reader.batches()) == 4000


def test_an_abandoned_iteration_leaves_no_thread(bag):
    with BagReader(bag) as reader:
        batches = reader.batches()
        next(batches)
        assert threads()
        del batches
        gc.collect()
        assert not threads()
        batches = reader.batches()
        next(batches)
        batches.close()
        assert not threads()


def test_a_closed_reader_leaves_no_thread_and_reads_no_more(bag):
    reader = BagReader(bag)
    batches, others = reader.batches(), reader.batches()
    next(batches)
    next(others)
    reader.close()
    assert not threads()
    for left in (batches, others):
        with pytest.raises(BagError, match="was closed"):
            list(left)


def test_iterations_side_by_side_do_not_disturb_each_other(bag):
    whole = contents(bag)
    with BagReader(bag) as reader:
        found = [(entries(a), entries(b)) for a, b in zip(reader.batches(), reader.batches(), strict=True)]
    assert found == list(zip(whole, whole, strict=True))


def test_a_chunk_that_claims_too_much_is_not_read_ahead(bag):
    """Its claim of a gigabyte fills no memory before its turn, and then it is refused."""
    with bag.open("rb") as file:
        section = [s for s in scan(bag, file).sections if s.counts][30]
    content = bytearray(bag.read_bytes())
    struct.pack_into("<Q", content, section.offset - 8 - 4 - 4 - 4 - 8, 1 << 30)
    bag.write_bytes(content)
    found = []
    with BagReader(bag) as reader, pytest.raises(BagError, match="claims 1073741824 bytes"):
        drain(reader, found)
    assert sum(map(len, found)) >= 2900

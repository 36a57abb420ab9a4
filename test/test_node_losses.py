"""Messages that do not reach a node normally, over DDS between processes: each loss is reported."""

import itertools
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from live import MS, START, parameters, sample
from running import PUBLISHER_DEPTH, Rig, feed, running, values_of

from hd_diag.ros.numbers import Missing
from hd_diag.ros.subscriptions import INPUT_DEPTH

pytestmark = pytest.mark.usefixtures("ros")
LATE = 1.0  # waiting time that causes a warning [s]
QUICK = {"diagnostics_rate": 10.0}


def accounted(values: dict[str, str]) -> int:
    names = ("samples", "samples_rejected", "messages_without_joint", "messages_lost")
    return sum(int(values[name]) for name in names)


def warned(rig: Rig, said: str) -> bool:
    return any(said in values_of(each)["warning"] for array in rig.reports for each in array.status)


@pytest.mark.parametrize(
    ("before", "rate", "least"), [pytest.param(0, 1000.0, 0, marks=pytest.mark.slow), (5, 100.0, 100)]
)
def test_a_message_without_payload_is_counted_and_skipped(before, rate, least, tmp_path: Path) -> None:
    """Fast DDS requests it again while its publisher keeps it, and withholds all later messages.

    Fast messages are over before this is noticed; they are counted as lost.
    """
    stamps, published = itertools.count(START, MS), before + 1 + 600
    with running(tmp_path, parameters(**QUICK)) as rig:
        publisher = rig.publisher()
        feed(publisher, stamps, before)
        publisher.publish(b"")
        feed(publisher, stamps, 600, rate)
        values = rig.values("joint_1", lambda v: accounted(v) >= published)
        assert accounted(values) == published < PUBLISHER_DEPTH
        assert int(values["samples"]) >= before + least
        assert values["samples_rejected"] == "0"
        assert warned(rig, "messages were lost since the last report")
        assert "withholds what follows a message that cannot be read" in rig.process.output()
        lost = values["messages_lost"]
        feed(publisher, stamps, 100)
        values = rig.values("joint_1", lambda v: accounted(v) >= published + 100)
        assert (accounted(values), values["messages_lost"]) == (published + 100, lost)


def test_one_of_two_publishers_is_held_up(tmp_path: Path) -> None:
    """The topic is never silent, but the joint is."""
    stamps = itertools.count(START, MS)
    with running(tmp_path, parameters("elbow", "wrist", **QUICK)) as rig:
        held, other = rig.publisher(), rig.publisher()
        counts = {"elbow": 0, "wrist": 0}

        def both(count: int) -> None:
            for _ in range(count):
                for publisher, joint in ((held, "elbow"), (other, "wrist")):
                    publisher.publish(sample(next(stamps), 0.0, 0.0, 0.0, joint))
                    counts[joint] += 1
                time.sleep(0.01)

        both(20)
        held.publish(b"")
        rig.values("elbow", lambda v: int(v["samples"]) > 60, lambda: both(2))
        both(20)

        def all_told(wrist: dict[str, str]) -> bool:
            elbow = int(rig.values("elbow")["samples"])
            return elbow + int(wrist["samples"]) + int(wrist["messages_lost"]) == sum(counts.values()) + 1

        told = rig.values("wrist", all_told)
        assert told["samples_rejected"] == "0"
        assert int(told["samples"]) > 0.9 * counts["wrist"]


def test_all_of_a_flood_is_accounted_for_and_said(tmp_path: Path) -> None:
    """Messages that DDS drops silently are counted; the stopped node causes a warning.

    The next message to arrive shows how many were dropped before it, so one more comes after the flood.
    """
    count, stop, go_on = 14_000, 2000, 11_000
    with running(tmp_path, parameters(**QUICK)) as rig:
        publisher = rig.publisher()
        rig.acknowledged(publisher)
        begin = time.monotonic()
        for number in range(count):
            if number in (stop, go_on):
                rig.process.popen.send_signal(signal.SIGSTOP if number == stop else signal.SIGCONT)
            publisher.publish(sample(START + number * MS // 5, 0.0, 0.0, 0.0))
            pause = 1.0 if number == count - 2 else 0.0
            time.sleep(max(pause, begin + number / 5000.0 - time.monotonic()))
        values = rig.values("joint_1", lambda v: accounted(v) >= count)
        assert accounted(values) == count
        waiting = INPUT_DEPTH + PUBLISHER_DEPTH  # at most, on either side
        assert int(values["messages_lost"]) >= go_on - stop - waiting
        assert warned(rig, "messages were lost since the last report")
        assert warned(rig, "the node stood still for")
        rig.values("joint_1", lambda v: v["warning"] == "")


def test_what_waits_for_a_node_without_a_core_is_said(tmp_path: Path) -> None:
    """Its first thread gets what another process spares of a core, while DDS threads take messages."""
    count = 1000
    with running(tmp_path, parameters(**QUICK)) as rig:
        publisher, core = rig.publisher(), min(os.sched_getaffinity(0))
        rig.values("joint_1", lambda values: values["prediction"] == "map")
        with subprocess.Popen([sys.executable, "-c", "while True: pass"]) as busy:
            os.sched_setaffinity(busy.pid, {core})
            os.sched_setaffinity(rig.process.popen.pid, {core})
            os.sched_setscheduler(rig.process.popen.pid, os.SCHED_IDLE, os.sched_param(0))
            feed(publisher, itertools.count(START, MS), count)
            time.sleep(2.0 * LATE)
            busy.kill()
        rig.values("joint_1", lambda v: accounted(v) >= count)
        rig.until(lambda: warned(rig, "the node cannot keep up: messages waited up to"), "warning")


STEPS = st.lists(st.tuples(st.integers(0, 2), st.integers(1, 5)), max_size=60)


@given(STEPS, st.integers(1, 2**40), st.sampled_from((1, 3)))
def test_what_is_missing_is_counted_by_numbers(steps: list[tuple[int, int]], first: int, count: int) -> None:
    """The count is exact for one publisher from any first number, and for several with distant numbers."""
    missing, last, true = Missing(), [first + 10**6 * which for which in range(count)], 0
    missing.publishers(count)
    for number in last:
        missing.take(number)
    missing._found -= 10.0  # as if found long ago
    for which, step in steps:
        last[which % count] += step
        true += step - 1
        missing.take(last[which % count])
    assert missing.count == true


def missing_after(*numbers: int) -> Missing:
    missing = Missing()
    missing.publishers(1)
    for number in numbers:
        missing.take(number)
    return missing


def test_a_publisher_that_begins_is_no_loss() -> None:
    missing = missing_after(7, 8, 9)
    missing.publishers(2)
    for number in (300, 10, 301, 1, 2):  # the last two are from a successor
        missing.take(number)
    assert missing.count == 0


@pytest.mark.parametrize(
    ("own", "first", "true"), [("", 5000, 21), ("", 2, 21), ("", 40, 59), ("78", 20, 31)]
)
def test_what_was_withheld_is_missing(own: str, first: int, true: int) -> None:
    """An unreadable message before the first known one, or all messages of a new publisher."""
    missing = missing_after(*map(int, own))
    for number in (first, first + 3):
        missing.withheld(number)
    missing.take(first + 20)
    assert missing.count == true

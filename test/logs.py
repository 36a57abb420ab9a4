"""Logs of a session without ROS, and the contents of a log."""

import itertools
import tempfile
from collections import defaultdict
from pathlib import Path
from typing import Any

from live import START, Recording

from hd_diag.bag import BagReader, BagWriter
from hd_diag.messages.publications import JOINT_STATE, TEMPERATURE, Encoded, resolved
from hd_diag.replay.recorded_monitor import Session
from hd_diag.replay.replay import replay


class Log(Recording):
    """A recording that is also written to a file, like the node's log."""

    def __init__(self, path: Path, **options: Any) -> None:
        super().__init__()
        self.writer = BagWriter(path, **options)
        self.clock = itertools.count(START)

    def __call__(self, encoded: Encoded) -> None:
        super().__call__(encoded)
        topic = resolved(encoded.topic)
        for row, received in zip(encoded.rows, encoded.received.tolist(), strict=True):
            self.writer.write(topic, encoded.type_name, bytes(row), received)

    def receive(self, session: Session, data: bytes) -> None:
        """Receive a JointState in CDR."""
        now = next(self.clock)
        self.writer.write("/joint_states", JOINT_STATE, data, now)
        session.joint_state(now, data)

    def warm(self, session: Session, joint: str, data: bytes) -> None:
        """Receive a Temperature in CDR."""
        self.writer.write(f"/{joint}/temperature", TEMPERATURE, data, next(self.clock))
        session.temperature(joint, data)


def messages_of(bag: Path, *topics: str, grouped: bool = False) -> list[tuple[str, str, bytes, int]]:
    """Topic, type, CDR and log time [ns] of a bag's messages in order; `grouped`: topic by topic."""
    with BagReader(bag) as reader:
        return [
            (batch.topic.name, batch.topic.type_name, bytes(data), time)
            for batch in reader.batches(topics or None, grouped=grouped)
            for time, data in zip(batch.log_time.tolist(), batch.messages(), strict=True)
        ]


def content(bag: Path) -> dict[str, list[tuple[int, bytes]]]:
    """Log time [ns] and CDR of every message of a bag, by topic, in order."""
    found: dict[str, list[tuple[int, bytes]]] = defaultdict(list)
    for topic, _, data, time in messages_of(bag, grouped=True):
        found[topic].append((time, data))
    return dict(found)


def whole(bag: Path) -> int:
    """Number of messages of a bag without problems."""
    with BagReader(bag) as reader:
        assert not reader.problems
        return reader.message_count


def replayed(log: Path) -> dict[str, list[tuple[int, bytes]]]:
    """Content of a log, after checking that its replay is the same bit for bit."""
    with tempfile.TemporaryDirectory() as folder:
        again = Path(folder) / "again.mcap"
        replay(log, again)
        found = content(log)
        assert content(again) == found
    return found

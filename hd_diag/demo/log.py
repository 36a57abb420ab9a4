"""What a log holds, read back with types by two readers: rosbags, and the one of this package."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader

from hd_diag.bag import BagReader

Counts = Counter[tuple[str, str]]


@dataclass(frozen=True)
class LogSummary:
    """Messages by (topic, type), size of the log [byte], and what is wrong with it, one line each."""

    counts: Counts
    size: int
    problems: list[str]

    @property
    def topics(self) -> list[dict[str, Any]]:
        """One entry a topic, by name."""
        return [{"topic": t, "type": kind, "count": n} for (t, kind), n in sorted(self.counts.items())]

    def count(self, topic: str) -> int:
        """Messages of a topic."""
        return sum(number for (name, _), number in self.counts.items() if name == topic)


def summarize(folder: Path) -> LogSummary:
    """Decode every message of a log with both readers.

    Parameters
    ----------
    folder : Path
        A rosbag2 folder.

    Returns
    -------
    LogSummary
        With the counts of rosbags. Where the readers differ or cannot decode a message, that is a problem.
    """
    problems: list[str] = []
    counts: list[Counts] = []
    for name, decode in (("rosbags", _with_rosbags), ("hd_diag", _with_own_reader)):
        try:
            counts.append(decode(folder, problems))
        except Exception as error:  # whatever a reader raises, it is the finding
            problems.append(f"{name} cannot read the log: {' '.join(str(error).split())}")
    if len(counts) == 2 and counts[0] != counts[1]:
        problems.append("rosbags and hd_diag count different messages in the log")
    size = sum(path.stat().st_size for path in folder.glob("*.mcap"))
    return LogSummary(counts[0] if counts else Counter(), size, problems)


def _with_rosbags(folder: Path, problems: list[str]) -> Counts:
    counts: Counts = Counter()
    with AnyReader([folder]) as reader:
        for connection, _, data in reader.messages():
            reader.deserialize(data, connection.msgtype)
            counts[connection.topic, connection.msgtype] += 1
    return counts


def _with_own_reader(folder: Path, problems: list[str]) -> Counts:
    counts: Counts = Counter()
    with BagReader(folder) as reader:
        problems += reader.problems
        for batch in reader.batches(grouped=True):
            messages, rejected = reader.deserialize(batch)
            problems += [f"{batch.topic.name}: {rejection.reason}" for rejection in rejected[:1]]
            counts[batch.topic.name, batch.topic.type_name] += len(messages)
    return counts

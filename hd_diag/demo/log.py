"""What the demo's log holds, read back with types by rosbags and counted by this package's own reader."""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader

from hd_diag.bag import BagReader


@dataclass
class Log:
    """Content of a log.

    Attributes
    ----------
    counts : Counter
        Messages by (topic, type).
    published : mapping of str to list of bytes
        What the node published, by topic.
    size : int
        [byte]
    problems : list of str
        What is wrong with it, one line each.
    """

    counts: Counter[tuple[str, str]] = field(default_factory=Counter)
    published: defaultdict[str, list[bytes]] = field(default_factory=lambda: defaultdict(list))
    size: int = 0
    problems: list[str] = field(default_factory=list)

    @property
    def topics(self) -> list[dict[str, Any]]:
        """One entry a topic, by name."""
        return [{"topic": t, "type": kind, "count": n} for (t, kind), n in sorted(self.counts.items())]

    def count(self, topic: str) -> int:
        """Messages of a topic."""
        return sum(number for (name, _), number in self.counts.items() if name == topic)


def read_log(folder: Path) -> Log:
    """Decode every message of a log.

    Parameters
    ----------
    folder : Path
        A rosbag2 folder.
    """
    log = Log(size=sum(path.stat().st_size for path in folder.glob("*.mcap")))
    try:
        with AnyReader([folder]) as reader:
            for connection, _, data in reader.messages():
                topic = connection.topic
                reader.deserialize(data, connection.msgtype)
                log.counts[topic, connection.msgtype] += 1
                if topic == "/diagnostics" or topic.startswith("/hd_diag/"):
                    log.published[topic].append(bytes(data))
        with BagReader(folder) as own:
            log.problems += own.problems
            if own.message_count != log.counts.total():
                log.problems.append(f"rosbags and hd_diag count different messages in {folder.name}")
    except Exception as error:  # whatever a reader raises, it is the finding
        log.problems.append(f"{folder.name} cannot be read: {' '.join(str(error).split())}")
    return log

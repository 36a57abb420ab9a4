"""The demo's log, read back with types by rosbags and counted by this package's own reader."""

from __future__ import annotations

from collections import Counter, defaultdict
from pathlib import Path
from typing import NamedTuple

from rosbags.highlevel import AnyReader

from hd_diag.bag import BagReader


class Log(NamedTuple):
    """Types and numbers of messages by topic, messages that the node published by topic, and problems."""

    types: dict[str, str]
    counts: Counter[str]
    published: dict[str, list[bytes]]
    problems: list[str]


def read_log(folder: Path) -> Log:
    """Decode every message of a rosbag2 folder."""
    log = Log({}, Counter(), defaultdict(list), [])
    try:
        with AnyReader([folder]) as reader:
            for connection, _, data in reader.messages():
                topic = connection.topic
                reader.deserialize(data, connection.msgtype)
                log.types[topic] = connection.msgtype
                log.counts[topic] += 1
                if topic == "/diagnostics" or topic.startswith("/hd_diag/"):
                    log.published[topic].append(bytes(data))
        with BagReader(folder) as own:
            log.problems.extend(own.problems)
            if own.message_count != log.counts.total():
                log.problems.append(f"rosbags and hd_diag count different messages in {folder.name}")
    except Exception as error:  # any exception of a reader is the finding
        log.problems.append(f"{folder.name} cannot be read: {' '.join(str(error).split())}")
    return log

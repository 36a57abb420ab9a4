"""What a bag holds, before anything is fitted: content, time, joints; and which bags there are."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from hd_diag.bag import BagError, BagReader
from hd_diag.records.joint_topics import joint_state_topics, joints_in
from hd_diag.replay.versions import Versions, running
from hd_diag.report.facts import sha256

SUFFIXES = (".mcap", ".db3")


@dataclass(frozen=True)
class Survey:
    """What was seen of one bag; where it has an `error`, nothing else is known but its problems.

    The digest of its contents; first log time [ns since 1970], None for an empty bag; how many messages and
    which names its joint states have, where it has any; what is unfinished about its files; versions of the
    worker that looked; topics; time from the first to the last message [s].
    """

    path: str
    digest: str = ""
    start: int | None = None
    messages: int = 0
    names: frozenset[str] = frozenset()
    problems: tuple[str, ...] = ()
    error: str = ""
    versions: Versions = field(default_factory=running)
    topics: frozenset[str] = frozenset()
    duration: float = 0.0


def find_bags(given: Iterable[Path]) -> list[Path]:
    """Bags among files and folders, each once, in the order of their names within each folder.

    A folder with a ``metadata.yaml`` is one bag; in other folders, at any depth, every ``.mcap`` and ``.db3``
    file is one. A folder that cannot be listed is among the results, so that its error is reported.
    """
    unique: dict[str, Path] = {}
    for path in given:
        for bag in _within(path) if path.is_dir() else [path]:
            unique.setdefault(os.path.realpath(bag), bag)
    return list(unique.values())


def _within(folder: Path) -> Iterator[Path]:
    unreadable: list[Path] = []
    for place, folders, files in os.walk(folder, onerror=lambda e: unreadable.append(Path(str(e.filename)))):
        folders.sort()
        if "metadata.yaml" in files:
            folders.clear()
            yield Path(place)
            continue
        yield from (Path(place, name) for name in sorted(files) if name.endswith(SUFFIXES))
    yield from unreadable


def survey(path: str) -> Survey:
    """Look at a bag: every byte is read twice, nothing is kept."""
    try:
        with BagReader(path) as reader:
            if not reader.topics:
                error = str(BagError(path, "holds no topic that can be read"))
                return Survey(path, error=error, problems=tuple(reader.problems))
            measured = joint_state_topics(reader)
            return Survey(
                path,
                hashlib.sha256(b"".join(map(sha256, reader.paths))).hexdigest(),
                reader.start if reader.message_count else None,
                sum(topic.count for topic in reader.topics if topic.name in measured or not measured),
                joints_in(reader),
                tuple(reader.problems),  # last, with what reading showed
                topics=frozenset(topic.name for topic in reader.topics),
                duration=reader.duration,
            )
    except (BagError, OSError) as error:
        return Survey(path, error=str(error if isinstance(error, BagError) else BagError(path, error)))

"""A run over many bags: find and survey them, diagnose joints without a result, collect the rows."""

from __future__ import annotations

import functools
import hashlib
import json
import os
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from hd_diag.bag import BagError, BagReader
from hd_diag.config.configuration import Config, JointConfig
from hd_diag.config.parameters import JOINT_PARAMETERS, shown
from hd_diag.fleet import FleetError
from hd_diag.fleet.journal import BagPages, Journal
from hd_diag.fleet.rows import PAGE, Row, Task, judge
from hd_diag.formatting import listed
from hd_diag.process_pool import Failure, Pool, run
from hd_diag.records.joint_topics import joint_state_topics, joints_in
from hd_diag.replay.versions import Versions, running
from hd_diag.report.facts import sha256

Progress = Callable[[str, int, int, int], None]
"""Called with the stage, the work done in it, its total work, and the number of tasks done."""

_Outcomes = Callable[[Callable[[Any], Any], Sequence[Any]], Iterator[tuple[int, Any]]]
"""`hd_diag.process_pool.run`, called with a function and items."""

_NAMES_SHOWN = 8
_SUFFIXES = (".mcap", ".db3")
# Parameters that a diagnosis uses: neither limits nor the model file.
_USED = [p.name for p in JOINT_PARAMETERS if not p.name.startswith("limits.") and p.name != "model_file"]


@dataclass(frozen=True)
class Survey:
    """What was seen of one bag; with an `error` only its problems are known as well.

    `digest` is that of the contents; `start` the first log time [ns since 1970], None for an empty bag;
    `messages` the number of joint states, or of all messages if there are none; `names` those in the joint
    states; `problems` say which files are unfinished; `versions` are those of the worker that looked;
    `duration` is the time from the first to the last message [s].
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


@dataclass(frozen=True)
class Fleet:
    """Which bags, which of the configuration's joints, and how robots are distinguished.

    The first group of `robot` (or its whole match) in a bag's path names the robot; None means one robot.
    """

    bags: Sequence[Path]
    config: Config
    joints: tuple[JointConfig, ...]
    robot: re.Pattern[str] | None = None

    def robot_of(self, bag: Path) -> str | None:
        """Name of a bag's robot; FleetError if the pattern finds none."""
        if self.robot is None:
            return None
        match = self.robot.search(str(bag))
        if match is None:
            raise FleetError(f"{shown(str(bag))}: --robot {self.robot.pattern} matches nothing in its path")
        return "".join(c for c in (match[1] if self.robot.groups else match[0]) or "" if c.isprintable())


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
        yield from (Path(place, name) for name in sorted(files) if name.endswith(_SUFFIXES))
    yield from unreadable


def survey(path: str) -> Survey:
    """Survey a bag: every byte is read twice, nothing is kept."""
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
                tuple(reader.problems),  # last: reading adds problems
                topics=frozenset(topic.name for topic in reader.topics),
                duration=reader.duration,
            )
    except (BagError, OSError) as error:
        return Survey(path, error=str(error if isinstance(error, BagError) else BagError(path, error)))


def tasks(seen: Survey, config: Config, joints: tuple[JointConfig, ...]) -> list[Task]:
    """Tasks for the configured joints that have an angle or a mapped topic in a bag."""
    found = []
    for joint in joints:
        mapped = tuple(f"/{signal.topic.lstrip('/')}" for signal in joint.mapped.values() if signal.topic)
        named = seen.names & {joint.input_joint, joint.output_joint}
        if named or any(topic.endswith(mapped) for topic in seen.topics):
            flat = {name: value for name, value in config.flat.items() if name.startswith(f"{joint.name}.")}
            used = {name: flat[f"{joint.name}.{name}"] for name in _USED}
            digest = hashlib.sha256(json.dumps(used, sort_keys=True).encode()).hexdigest()
            found.append(Task(seen.path, joint, flat, seen.digest, digest, seen.messages))
    return found


def diagnose_fleet(
    fleet: Fleet,
    pool: Pool,
    journal: Journal,
    progress: Progress = lambda stage, done, total, tasks: None,
    tick: Callable[[], None] = lambda: None,
    timeout: float = 0.0,
    pages: BagPages | None = None,
) -> list[Row]:
    """Rows of every joint of every bag, in the order of bags and joints, with ``error`` if none is judged.

    Results in the journal are not computed again; each new result is added at once. `timeout` [s] limits the
    survey of a bag, and the judging of each of its joints; for `tick` see :func:`hd_diag.process_pool.run`.
    With `pages`, a page is drawn for each joint's last recording if it does not exist yet.
    Raises FleetError if workers are gone, have another version, or the journal cannot be written.
    """
    robots = [fleet.robot_of(bag) for bag in fleet.bags]
    outcomes = functools.partial(run, pool, tick=tick, timeout=timeout)
    seen = _surveys(fleet, outcomes, progress)
    wanted = [tasks(one, fleet.config, fleet.joints) for one in seen]
    last: dict[tuple[str | None, str], tuple[int, Task]] = {}  # last recording of each joint
    for robot, one, own in zip(robots, seen, wanted, strict=True):
        for task in own if pages else ():
            name, start = (robot, task.joint.name), one.start or 0
            if name not in last or start >= last[name][0]:
                last[name] = start, task
    shown_keys = {task.key for _, task in last.values()}
    missing = {task.key for _, task in last.values() if pages and not pages.place(task).exists()}
    todo = {
        task.key: replace(task, drawn=task.key in missing)
        for own in wanted
        for task in own
        if task.key not in journal.results or task.key in missing
    }
    failed = _judge(list(todo.values()), outcomes, journal, progress, pages)
    rows = []
    for bag, robot, one, own in zip(fleet.bags, robots, seen, wanted, strict=True):
        fixed: Row = {"bag": str(bag), "robot": robot, "start": one.start, "problems": list(one.problems)}
        fixed |= {"bag_sha256": one.digest or None, "bag_duration_s": one.duration or None}
        for task in own:
            linked = {PAGE: pages.link(task)} if pages and task.key in shown_keys else {}
            rows.append(fixed | (journal.results.get(task.key) or failed[task.key]) | linked)
        if not own:
            rows.append(fixed | _unusable(one, fleet.joints))
    return rows


def _surveys(fleet: Fleet, outcomes: _Outcomes, progress: Progress) -> list[Survey]:
    paths = [os.path.abspath(bag) for bag in fleet.bags]  # a worker may be in another folder
    found: dict[int, Survey] = {}
    progress("reading", 0, len(paths), 0)
    here = running()["hd_diag"]
    for number, outcome in outcomes(survey, paths):
        one = Survey(paths[number], error=outcome.text) if isinstance(outcome, Failure) else outcome
        if (there := one.versions["hd_diag"]) != here:
            raise FleetError(f"a worker has hd_diag {there}, this is {here}: install the same everywhere")
        found[number] = one
        progress("reading", len(found), len(paths), len(found))
    return [found[number] for number in range(len(paths))]


def _judge(
    todo: list[Task], outcomes: _Outcomes, journal: Journal, progress: Progress, pages: BagPages | None
) -> dict[str, Row]:
    """Fill the journal; return rows of the failed tasks, which the next run tries again."""
    failed: dict[str, Row] = {}
    todo.sort(key=lambda task: -task.messages)  # the long ones first: a long last one would keep all waiting
    total, samples = sum(task.messages for task in todo), 0
    progress("diagnosing", 0, total, 0)
    for done, (number, outcome) in enumerate(outcomes(judge, todo), start=1):
        task = todo[number]
        if isinstance(outcome, Failure):
            own = {"joint": task.joint.name, "config_sha256": task.config_digest}
            failed[task.key] = {**own, "error": outcome.text}
        else:
            drawn = outcome.pop(PAGE, None)
            if pages and drawn:
                pages.write(task, drawn)
            journal.add(task.key, outcome)
        samples += task.messages
        progress("diagnosing", samples, total, done)
    return failed


def _unusable(seen: Survey, joints: tuple[JointConfig, ...]) -> Row:
    if seen.error:
        return {"error": seen.error.partition(": ")[2] or seen.error}
    wanted = ", ".join(shown(joint.output_joint) for joint in joints[:_NAMES_SHOWN])
    names, topics = (listed(sorted(map(shown, each)), _NAMES_SHOWN) for each in (seen.names, seen.topics))
    held = f"joint states there hold {names or 'no joint'}; its topics are {topics}; see hd-diag topics"
    return {"error": f"no {wanted}; {held}"}

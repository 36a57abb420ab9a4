"""Topics of a bag that a replay reads: those of the node's log, or those with joint states."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from hd_diag.bag import BagError, BagReader
from hd_diag.config.configuration import Config, ConfigError, JointConfig, ModelText, recorded_signals
from hd_diag.messages.publications import INPUT, JOINT_STATE, STRING, temperature_topic
from hd_diag.records.joint_topics import JointTopics, held
from hd_diag.replay.events import Event, read_event
from hd_diag.replay.recorded_monitor import EVENTS

NODE = "/hd_diag"
"""Default full name of a node."""


@dataclass(frozen=True)
class Sources:
    """Topics for a replay by their names in the bag.

    `node` is the full name of the node that wrote the bag, or that the replay plays. `events` is the topic of
    the events, empty if a configuration is given. `topics` are the topics to read. `names` maps the names of
    the node's topics in `messages` to their full names.
    """

    node: str
    events: str
    topics: JointTopics
    names: Mapping[str, str]

    @cached_property
    def every(self) -> set[str]:
        """All topics to read."""
        return {*self.topics.types, *([self.events] if self.events else [])}


def sources_of(reader: BagReader, config: Config | None, topics: tuple[str, ...]) -> Sources:
    """Topics for a replay with a configuration, or with that of the log if it is None.

    Empty `topics` mean the node's input of a log, or with a configuration all joint states except for a
    node's outputs. Raises BagError if there is no log and no configuration, or no joint state; ConfigError if
    the log's joints are invalid.
    """
    if missing := set(topics) - {t.name for t in reader.topics if t.type_name == JOINT_STATE}:
        raise BagError(reader.path, f"has no topic {min(missing)} with {JOINT_STATE}; {held(reader)}")
    if config is None:
        return _of_log(reader, topics)
    signals = {joint.name: joint.signals for joint in config.joints}
    return Sources(NODE, "", JointTopics(reader, signals, topics or None), {})


def event_of(path: Path, data: bytes) -> Event:
    """Event of a log, as `read_event`; BagError if it cannot be used."""
    try:
        return read_event(data)
    except ValueError as error:
        raise BagError(path, f"has an event that cannot be read: {error}") from error


def models_of(event: Event, known: Iterable[JointConfig]) -> ModelText:
    """Function that returns the model files in the log, not those at their paths now."""
    texts: dict[str, str] = {joint.name: joint.model_text for joint in known if joint.model} | event["models"]

    def recorded(joint: str, path: str) -> str:
        if joint not in texts:
            raise ConfigError("the log does not hold this model")
        return texts[joint]

    return recorded


def _of_log(reader: BagReader, topics: tuple[str, ...]) -> Sources:
    events, begin = _log(reader)
    node = events[: -len(EVENTS[1:])]
    namespace = node.rpartition("/")[0]
    try:
        signals = recorded_signals(begin["parameters"])
    except ConfigError as error:
        raise ConfigError(f"{reader.path}: {error}") from error
    own = {s.topic for each in signals.values() for s in each if s is not None and s.topic}
    names = {t: f"{namespace}/{t}" for t in [*map(temperature_topic, signals), INPUT, *own] if t[0] != "/"}
    names |= begin["topics"]
    return Sources(
        node, events, JointTopics(reader, signals, topics or (names[INPUT],), names), begin["topics"]
    )


def _log(reader: BagReader) -> tuple[str, Event]:
    """Topic of the events of the node that wrote the bag, and the first event."""
    suffix = EVENTS[1:]
    names = [t.name for t in reader.topics if t.type_name == STRING and t.name.endswith(suffix)]
    reason = "is no log of the node, so a configuration is needed (--config), such as hd-diag gear writes"
    for name in names:
        batch = next(iter(reader.batches([name])), None)
        event = {} if batch is None else event_of(reader.path, bytes(next(batch.messages())))
        if event.get("new"):
            return name, event
        reason = f"is a log without its beginning: {name} does not begin with a configuration"
    raise BagError(reader.path, reason)

"""Topics of a bag with signals of joints: joint states, and topics that signals are mapped to."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from hd_diag.bag.block import Topic
from hd_diag.bag.errors import BagError
from hd_diag.bag.reader import BagReader, Mixed
from hd_diag.config.configuration import JointConfig
from hd_diag.formatting import listed, visible
from hd_diag.messages.fields import FieldReader
from hd_diag.messages.joint_states import JOINT_STATE, JointStateReader
from hd_diag.messages.publications import INPUT, OWN_OUTPUTS, TEMPERATURE, temperature_topic
from hd_diag.streams.columns import JointStates
from hd_diag.streams.signals import ROLES, JointSignals, Signal, key

_SHOWN = 12  # most topics that an error names
_LONGEST = 60  # characters of a name


class JointTopics:
    """Topics to read from a bag for some joints, given the signals of each.

    Signals without their own topic are read from the topics `usual`, by default all with joint states except
    for a node's outputs and topics that signals are mapped to. `names` maps topics of signals and
    temperatures to their full names, if the bag's names differ.

    Attributes: `readers` by topic; `types` of these topics and of temperature topics; `temperatures`, the
    joint of each topic with Temperature messages.

    Raises BagError if a topic or field is missing, and names those that exist. A log, which gives `names`,
    may lack topics without messages.
    """

    def __init__(
        self,
        reader: BagReader,
        signals: Mapping[str, JointSignals],
        usual: Iterable[str] | None = None,
        names: Mapping[str, str] | None = None,
    ) -> None:
        self._bag, self._names = reader, names or {}
        topics: dict[str, dict[str, Signal]] = {}
        anywhere: dict[str, Signal] = {}
        self.types: dict[str, str] = {}
        for joint, own in signals.items():
            for role, signal in zip(ROLES, own, strict=True):
                if signal is not None and not signal.topic:
                    anywhere[key(joint, role)] = signal
                elif signal is not None and (topic := self._find(joint, signal)):
                    topics.setdefault(topic, {})[key(joint, role)] = signal
                    self.types[topic] = signal.type_name
        usual = self._usual(topics, signals) if usual is None else usual
        for topic in usual:
            topics[topic] = topics.get(topic, {}) | anywhere
            self.types[topic] = JOINT_STATE
        self.readers = {topic: self._reader(topic, own) for topic, own in topics.items()}
        self.temperatures = {
            topic: joint
            for joint, own in signals.items()
            if own.temperature is None
            for topic in self._temperatures(joint)
        }
        self.types |= dict.fromkeys(self.temperatures, TEMPERATURE)

    def is_read(self, topic: Topic) -> bool:
        """Whether a topic has signals for the alignment."""
        return topic.name in self.readers and topic.type_name == self.types[topic.name]

    def columns(self, mixed: Mixed) -> tuple[list[JointStates], list[tuple[int, str]]]:
        """Signals of consecutive messages; positions of unreadable messages and reasons, topic by topic."""
        shapes: list[JointStates] = []
        refused: list[tuple[int, str]] = []
        for rows, batch in mixed.batches:
            columns, rejected = self.readers[batch.topic.name].columns(batch.payload, batch.log_time)
            shapes += [states._replace(row=rows[states.row]) for states in columns]
            refused += [(int(rows[each.row]), each.reason) for each in rejected]
        return shapes, refused

    def _find(self, joint: str, signal: Signal) -> str:
        """The bag's name of a signal's topic; empty if a node's log has no such topic."""
        wanted = self._names.get(signal.topic, signal.topic)
        end = "/" + wanted.lstrip("/")
        known = [t for t in self._bag.topics if t.name == wanted] or [
            t for t in self._bag.topics if t.name.endswith(end)
        ]
        if not known and self._names:
            return ""
        if not known:
            foreign = [t for t in self._bag.foreign if t.name == wanted or t.name.endswith(end)]
            what = (
                f"{wanted} for {joint} is {foreign[0].content}"
                if foreign
                else f"has no topic {wanted} for {joint}"
            )
            raise BagError(self._bag.path, f"{what}; {held(self._bag)}")
        right = [t.name for t in known if t.type_name == signal.type_name]
        if not right:
            text = (
                f"{known[0].name} has type {known[0].type_name}, not {signal.type_name} as mapped for {joint}"
            )
            raise BagError(self._bag.path, text)
        return right[0]

    def _usual(self, mapped: Iterable[str], signals: Mapping[str, JointSignals]) -> list[str]:
        """Topics with joint states, except for mapped ones that are not named like a node's input."""
        every = [t for t in joint_state_topics(self._bag) if t not in mapped or t.endswith(f"/{INPUT}")]
        if not every and not any(signal for own in signals.values() for signal in own):
            raise BagError(self._bag.path, f"has no topic with {JOINT_STATE}; {held(self._bag)}")
        return every

    def _temperatures(self, joint: str) -> list[str]:
        usual = temperature_topic(joint)
        named = self._names.get(usual)
        return [
            t.name
            for t in self._bag.topics
            if t.type_name == TEMPERATURE
            and (t.name == named if named is not None else t.name.endswith(f"/{usual}"))
        ]

    def _reader(self, topic: str, signals: Mapping[str, Signal]) -> JointStateReader | FieldReader:
        type_name = self.types[topic]
        try:
            if type_name == JOINT_STATE:
                return JointStateReader(signals)
            (known,) = (t for t in self._bag.topics if (t.name, t.type_name) == (topic, type_name))
            return FieldReader(self._bag.types(known), type_name, signals)
        except ValueError as error:
            cause = error.cause if isinstance(error, BagError) else f"{topic}: {error}"
            raise BagError(self._bag.path, cause) from error


def joint_state_topics(reader: BagReader) -> list[str]:
    """Topics of a bag with joint states, without a node's own outputs."""
    found = [topic.name for topic in reader.topics if topic.type_name == JOINT_STATE]
    return [name for name in found if not name.endswith(OWN_OUTPUTS)]


def joints_in(reader: BagReader) -> frozenset[str]:
    """Joint names in a bag's joint states."""
    names: set[str] = set()
    for batch in reader.batches(joint_state_topics(reader)):
        for states in reader.joint_states(batch)[0]:
            names.update(states.names)
    return frozenset(names)


def held(reader: BagReader) -> str:
    """Text for an error: topics of a bag with their types, its problems, and where to look further."""
    every = [*reader.topics, *reader.foreign]
    topics = [f"{visible(t.name, _LONGEST)} ({visible(t.content, _LONGEST)})" for t in every]
    content = f"it has {listed(topics, _SHOWN)}; see hd-diag topics" if topics else "it has no topics"
    return "; ".join([content, *reader.problems])


def offered(path: str | Path) -> str:
    """Text for an error about a missing joint: joints and topics of the bag, and where to look further."""
    with BagReader(path) as reader:
        names = [visible(name, _LONGEST) for name in sorted(joints_in(reader))]
        topics = [visible(topic.name, _LONGEST) for topic in reader.topics]
    joints = f"joint states there hold {listed(names, _SHOWN) or 'no joint'}"
    more = f"what could serve, and the mapping to paste: hd-diag topics {path}"
    return f"{joints}; its topics are {listed(topics, _SHOWN) or 'none'}; {more}"


def no_input(path: str | Path, joint: JointConfig) -> str:
    """Text that a bag has no input angle of a joint, and what it has instead."""
    return f"no input angle ({place(joint.signals.input, joint.input_joint)}) in {path}; {offered(path)}"


def place(signal: Signal | None, name: str) -> str:
    """Text for an error: where a signal is looked for, by default under a name in joint states."""
    if signal is None:
        return repr(name)
    return f"{signal.field} of {signal.topic or 'joint states'}, {signal.name!r}"

"""Numbers in a bag's messages that a joint could use, and pairs of angles at the two ends of a gear."""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from hd_diag.arrays import Floats, Times
from hd_diag.bag.block import Topic
from hd_diag.bag.errors import BagError
from hd_diag.bag.reader import BagReader, Batch
from hd_diag.messages.field_path import DTYPES, TEXT, holds_texts, is_array
from hd_diag.messages.fields import FieldReader
from hd_diag.messages.joint_states import Rejection
from hd_diag.messages.publications import OWN_OUTPUTS
from hd_diag.messages.schemas import deserialize
from hd_diag.streams.rules import CLOCK_JUMP, PAIRING_GAP
from hd_diag.streams.signals import Signal, Unit, unit

_MOST_MESSAGES = 50_000  # messages examined per topic: its first minute at 1 kHz
_MOST_ALONE = 64  # most topics read one by one after a common pass failed
_MOST_ELEMENTS, _MOST_NUMBERS = 64, 500  # most elements of an array, most numbers of a message
_SKIPPED = ("std_msgs/msg/Header", "builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_PLAIN = re.compile(r"[^\[\]{}\x00-\x1f\x7f]+")
# Kind of a number by words in the names of its fields; the first match counts.
_KINDS = {
    "temperature": r"temp",
    "current": r"(?<!by.)(?<!from.)current(?!.?torque)|ampere|(?<![a-z])amps?(?![a-z])",
    "torque": r"torque|effort|(by|from).current|(?<![a-z])d?tau",
    "velocity": r"veloc|speed|(?<![a-z])d(q|theta)(?![a-z])|(?<![a-z])qd(?![a-z])",
    "angle": r"posit|angle|(?<![a-z])theta|(?<![a-z])q(?![a-z])",
}
_COMMANDED = re.compile(r"command|desired|target|set_?point|reference|goal|error|(?<![a-z])ipo|_d(?![a-z])")
_COMPUTED = re.compile(r"model|predict|simulat|expected|feed_?forward", re.IGNORECASE)
_USUAL = {"temperature": "degC", "current": "A", "torque": "N m", "velocity": "rad/s", "angle": "rad"}
_RATIOS = 28.0, 400.0  # range for a harmonic drive
_SAME_SIDE = 0.02  # allowed difference from slope 1 of two angles at the same side
_FIT = 0.02  # largest residual of one angle fitted to another, relative to its deviation
_POINTS = 2000
_MOST_TRIED = 4000  # most messages examined for names
_ALIKE, _EVERY = 3, 50  # messages of one size examined in a batch: the first, then each n-th
_INTERFACE = re.compile(r"/(position|velocity|effort|torque|current|acceleration|temperature)$")
_PLACE = re.compile(r"\.[xyzw]$")  # component of a point or a quaternion, not a joint's angle
_DEGREES, _TURN = 360.0, 2.0 * np.pi
_Part = tuple[Times, Times, Floats]  # stamps, times of reception [ns], values
_COUNTS, _MANY_COUNTS = "counts/?", 1000.0  # whole numbers over a larger range are not in rad or deg


@dataclasses.dataclass(frozen=True, eq=False)
class NumericField:
    """A number in the messages of a topic: kind (one of `_KINDS` or empty), guessed unit, time [s], values.

    `tag` is the number's index or name in an array, the same for all numbers of a joint. If all stamps are
    the same, `time` is that of reception.
    """

    topic: Topic
    field: str
    tag: str
    kind: str
    unit: str
    time: Floats = dataclasses.field(repr=False)
    values: Floats = dataclasses.field(repr=False)
    by_reception: bool = False

    @property
    def moves(self) -> bool:
        """Whether the value changes."""
        return bool(np.ptp(self.values) > 0.0)

    @property
    def is_called_so(self) -> bool:
        """Whether the name states the kind; a table column's name need not."""
        return re.search(_KINDS.get(self.kind, ""), self.field.lower()) is not None

    @property
    def known(self) -> bool:
        """Whether any value is finite."""
        return bool(np.isfinite(self.values).any())


class AnglePair(NamedTuple):
    """Angles of one joint: input, output, and the slope of input over output, each in rad or counts."""

    input: NumericField
    output: NumericField
    slope: float

    @property
    def divided(self) -> bool:
        """Whether the input is reported at the output's side."""
        return not self.counted and abs(abs(self.slope) - 1.0) < _SAME_SIDE

    @property
    def counted(self) -> bool:
        """Whether the input is in encoder counts; its slope then gives no ratio."""
        return self.input.unit == _COUNTS


class Contents(NamedTuple):
    """Contents of a topic: numbers; text on problems; stamps [s] of its messages by the joints in them."""

    numbers: list[NumericField]
    problem: str
    stamps: dict[tuple[str, ...], Floats]


def contents(reader: BagReader, topics: Sequence[Topic]) -> list[Contents]:
    """Contents of each topic that may belong to a joint, from all its publishers, in two passes over the bag.

    An unknown type is noted as the topic's problem. If a pass fails because part of the bag is damaged or
    cannot be sorted, at most `_MOST_ALONE` topics are read one by one, as some may be whole.
    """
    found = [_Found(reader, topic) for topic in topics]
    try:
        for step in (_Found.learn, _Found.add):
            _pass(reader, found, step)
    except Exception as error:  # rosbags raises several kinds on hostile definitions and data
        if 1 < len(topics) <= _MOST_ALONE:
            return [each for topic in topics for each in contents(reader, [topic])]
        return [Contents([], each.problem or str(error), {}) for each in found]
    return [each.contents() for each in found]


def _pass(reader: BagReader, found: Sequence[_Found], step: Callable[[_Found, Batch], None]) -> None:
    """Pass each topic its batches until it has at least :data:`_MOST_MESSAGES` messages."""
    wanted, seen = {id(each.topic): each for each in found if each.is_read}, Counter[int]()
    for batch in (
        reader.batches({each.topic.name for each in wanted.values()}, grouped=True) if wanted else ()
    ):
        each = wanted.get(id(batch.topic))
        if each is not None and seen[id(batch.topic)] < _MOST_MESSAGES:
            seen[id(batch.topic)] += len(batch)
            each.take(step, batch)


class _Found:
    """Collects the contents of a topic: first the paths of its numbers, then the numbers as columns.

    `problem` is the error that ended the collection.
    """

    def __init__(self, reader: BagReader, topic: Topic) -> None:
        self.topic, self.problem = topic, ""
        self._reader, self._fields, self._tried = reader, dict[str, str](), 0
        self._why = "there is none"
        self._source: FieldReader | None = None
        self._parts: dict[str, list[_Part]] = {}
        self._stamps: dict[tuple[str, ...], list[Floats]] = {}
        self._seen, self._unstamped, self._refused = 0, 0, list[Rejection]()
        self._is_own = topic.name.endswith(OWN_OUTPUTS)
        if self.is_read:
            try:
                self._store = reader.given_types(topic)
            except BagError as error:
                self.problem = str(error)

    @property
    def is_read(self) -> bool:
        """Whether the topic's messages are read."""
        return not self._is_own and self.topic.count > 0 and not self.problem

    def take(self, step: Callable[[_Found, Batch], None], batch: Batch) -> None:
        """Run a step on a batch; an error ends only this topic."""
        try:
            if not self.problem:
                step(self, batch)
        except Exception as error:  # rosbags raises several kinds on hostile definitions and data
            self.problem = str(error)

    def learn(self, batch: Batch) -> None:
        """Add paths and types of the numbers in messages that may hold new names."""
        for data in (
            _unlike(batch) if self._tried < _MOST_TRIED and len(self._fields) <= _MOST_NUMBERS else ()
        ):
            try:
                message = deserialize(self._store, data, self.topic.type_name)
                self._fields |= _leaves(self._store, self.topic.type_name, message)
                self._tried += 1
            except ValueError as error:
                self._why = str(error)
            if len(self._fields) > _MOST_NUMBERS:
                break

    def add(self, batch: Batch) -> None:
        """Add the numbers of a batch."""
        if not 0 < len(self._fields) <= _MOST_NUMBERS:
            return
        if self._source is None:
            name, kind = self.topic.name, self.topic.type_name
            signals = {f: Signal(name, kind, f, "", Unit(1.0)) for f in self._fields}
            self._source, self._parts = FieldReader(self._store, kind, signals), {f: [] for f in signals}
        rows = slice(0, _MOST_MESSAGES - self._seen)
        self._seen += len(batch)
        shapes, rejected = self._source.columns(batch.payload[rows], batch.log_time[rows])
        self._refused += rejected
        for states in shapes:
            self._unstamped += states.stamp.size * states.unstamped
            joints = tuple(dict.fromkeys(filter(None, map(_tag, states.keys))))
            self._stamps.setdefault(joints, []).append((states.stamp - self._reader.start) * 1e-9)
            logged = batch.log_time[rows][states.row]
            for i, key in enumerate(states.keys):
                assert states.signals is not None
                self._parts[key].append((states.stamp, logged, states.signals[:, i]))

    def contents(self) -> Contents:
        """Numbers, problem and stamps."""
        if self.is_read and not self._tried:
            what = f"{self.topic.name}: no message can be read; the last {self._why}"
            self.problem = str(BagError(self._reader.path, what))
        if self.problem:
            return Contents([], self.problem, {})
        topic, start = self.topic, self._reader.start
        every = [
            _number(topic, f, self._fields[f], parts, start) for f, parts in self._parts.items() if parts
        ]
        problem = _problem(self._seen, self._unstamped, self._refused, every)
        stamps = {joints: np.concatenate(parts) for joints, parts in self._stamps.items()}
        return Contents(every, problem, stamps)


def _problem(seen: int, unstamped: int, refused: list[Rejection], every: list[NumericField]) -> str:
    """Text on messages, of `seen`, that cannot be read, and on bad stamps; empty if there are none."""
    said = []
    if refused:
        said.append(f"{len(refused)} of {seen} messages cannot be read; the last {refused[-1].reason}")
    if unstamped:
        said.append(f"the stamps of {unstamped} of {seen} messages are zero: the time of reception is taken")
    if any(number.by_reception for number in every):
        said.append("all stamps are the same: `stamp: reception` takes the time of reception")
    return "; ".join(said)


def pairs(angles: list[NumericField]) -> list[AnglePair]:
    """Best input for each output: they turn in proportion, by a gear's ratio or as two encoders of a side."""
    usable = [
        n
        for n in angles
        if n.kind == "angle" and n.values.size > 2 and n.moves and not _COMMANDED.search(n.field)
    ]
    found: dict[int, list[AnglePair]] = {}
    for one, other in itertools.permutations(usable, 2):
        if not _pairable(one, other) or (slope := _slope(one, other)) is None:
            continue
        pair = AnglePair(one, other, slope)
        is_gear = not pair.counted and _RATIOS[0] <= abs(slope) <= _RATIOS[1]
        at_motor = _at_motor(one) and not _at_motor(other)
        is_counter = pair.counted and (at_motor or other.unit != _COUNTS)
        if is_gear or is_counter or (pair.divided and at_motor):
            found.setdefault(id(other), []).append(pair)
    return [max(own, key=_nearness) for own in found.values()]


def beside(every: list[NumericField], output: NumericField, *kinds: str) -> NumericField | None:
    """The best number of the output's joint with one of the kinds; None if there is none.

    The order of preference: changing values, not computed by a model, the same topic, an earlier kind.
    """
    own = [n for n in every if n.tag == output.tag and n.kind in kinds and not _COMMANDED.search(n.field)]
    own = [n for n in own if n.known and (n.topic is output.topic or not n.tag.isdecimal())]
    return min(own, key=lambda n: _distance(n, output, kinds), default=None)


def _distance(number: NumericField, output: NumericField, kinds: Sequence[str]) -> tuple[object, ...]:
    is_computed = _COMPUTED.search(number.field) is not None
    return not number.moves, is_computed, number.topic is not output.topic, kinds.index(number.kind)


def _unlike(batch: Any) -> Iterator[bytes]:
    """Messages of a batch that may hold new names: of each size the first few, then each `_EVERY`-th."""
    sizes: Counter[int] = Counter()
    for data in batch.messages():
        sizes[len(data)] += 1
        if sizes[len(data)] <= _ALIKE or sizes[len(data)] % _EVERY == 0:
            yield data


def _leaves(store: Typestore, type_name: str, message: Any, prefix: str = "") -> Iterator[tuple[str, str]]:
    fields = dict(store.fielddefs[type_name][1])
    texts = [getattr(message, name) for name, description in fields.items() if holds_texts(description)]
    for name, description in fields.items():
        value, path = getattr(message, name), prefix + name
        places = [(path, value)]
        what: Any = description
        if is_array(description[0]):
            what = description[1][0]
            labels = _labels(store, what, value, texts) if len(value) <= _MOST_ELEMENTS else []
            places = [(f"{path}[{label}]", each) for label, each in zip(labels, value, strict=False)]
        for place, each in places:
            if what[0] == Nodetype.NAME and what[1] not in _SKIPPED:
                yield from _leaves(store, what[1], each, f"{place}.")
            elif what[0] == Nodetype.BASE and what[1][0] in DTYPES:
                yield place, DTYPES[what[1][0]]


def _labels(store: Typestore, element: Any, value: Any, texts: list[list[str]]) -> list[str]:
    """Labels of an array's elements: from the texts beside the array, their own names, or their indices."""
    own = dict(store.fielddefs[element[1]][1]) if element[0] == Nodetype.NAME else {}
    candidates = [names for names in texts if len(names) == len(value)]
    if own.get("name") == TEXT:
        candidates.append([each.name for each in value])
    for names in candidates:
        if len(set(names)) == len(names) and all(map(_PLAIN.fullmatch, names)):
            return list(names)
    return [str(i) for i in range(len(value))]


def _number(topic: Topic, path: str, dtype: str, parts: list[_Part], start: int) -> NumericField:
    stamp, logged, values = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    stamp = _rising(logged if (by_reception := stamp.size > 1 and not np.ptp(stamp)) else stamp)
    order = np.argsort(stamp, kind="stable")
    time = np.asarray((stamp[order] - start) * 1e-9, np.float64)
    words = re.sub(r"\[[^\]]+\]", "", path, count=1)
    found = field_of(topic, path, _tag(path), words, dtype, time, values[order])
    return dataclasses.replace(found, by_reception=by_reception)


def field_of(
    topic: Topic,
    path: str,
    tag: str,
    words: str,
    dtype: str,
    time: Floats,
    values: Floats,
    unit_name: str = "",
) -> NumericField:
    """A number whose kind follows from `words`, in a given or guessed unit; nan if no value is finite."""
    kind = next((kind for kind, known in _KINDS.items() if re.search(known, words.lower())), "")
    if kind == "angle" and _PLACE.search(words):
        kind = ""
    good = np.isfinite(values)
    if not good.any():
        return NumericField(
            topic, path, tag, kind, unit_name or _USUAL.get(kind, ""), np.zeros(1), np.full(1, np.nan)
        )
    time, values = time[good], values[good]
    return NumericField(topic, path, tag, kind, unit_name or _unit(kind, dtype, values), time, values)


def _tag(path: str) -> str:
    """Index or name of a number, without the interface that some drivers append."""
    found = re.search(r"\[([^\]]+)\]", path)
    return _INTERFACE.sub("", found[1]) if found else ""


def _rising(stamp: Times) -> Times:
    """Stamps [ns] that continue where a clock was set back."""
    step = np.diff(stamp, prepend=stamp[:1])
    back: Times = np.cumsum(np.where(step < -CLOCK_JUMP, step, 0))
    return stamp - back


def _unit(kind: str, dtype: str, values: Floats) -> str:
    """Unit guessed from the kind and the values."""
    jumps = np.abs(np.diff(values))
    if (
        kind == "angle"
        and np.any(np.abs(jumps - _DEGREES) < 0.05 * _DEGREES)
        and np.median(jumps) < 0.1 * _DEGREES
    ):
        return "deg"
    if kind == "angle" and (
        dtype[0] in "iu" or (np.ptp(values) > _MANY_COUNTS and not np.any(np.mod(values, 1.0)))
    ):
        return _COUNTS
    if kind == "temperature" and np.median(values) > 200.0:
        return "K"
    return _USUAL.get(kind, "")


def _at_motor(number: NumericField) -> bool:
    return bool(re.search(r"motor|theta|rotor", f"{number.topic.name} {number.field}".lower()))


def _nearness(pair: AnglePair) -> tuple[bool, bool, bool, bool]:
    """Ranking of a pair: its slope gives a ratio, same tag, input named like a motor's, same topic."""
    one, other = pair.input, pair.output
    alike = one.tag == other.tag or other.tag in one.tag
    return not pair.counted, alike, _at_motor(one) and not _at_motor(other), one.topic is other.topic


def _pairable(one: NumericField, other: NumericField) -> bool:
    """Whether most output samples have an input sample at their stamp, or two close together around it."""
    after = np.minimum(one.time.searchsorted(other.time), one.time.size - 1)
    before = np.maximum(after - 1, 0)
    near = one.time[after] - np.minimum(one.time[before], other.time) <= PAIRING_GAP * 1e-9
    near &= one.time[after] >= other.time
    return float(np.mean(near | (one.time[after] == other.time))) > 0.5


def _slope(one: NumericField, other: NumericField) -> float | None:
    """Slope of `one` over `other` in rad or counts; None if they do not turn in proportion."""
    begin, end = max(one.time[0], other.time[0]), min(one.time[-1], other.time[-1])
    if end <= begin:
        return None
    at = np.linspace(begin, end, _POINTS)
    x, y = (np.interp(at, n.time, _continuous(n)) for n in (other, one))
    x, y = x - x.mean(), y - y.mean()
    if not x.any() or not y.any() or np.array_equal(x, y):
        return None
    slope = float(x @ y / (x @ x))
    return slope if float(np.std(y - slope * x)) < _FIT * float(np.std(y)) else None


def _continuous(number: NumericField) -> Floats:
    """An angle [rad, or counts] without the jumps of an encoder that wraps or a counter that overflows."""
    if number.unit == _COUNTS:
        return np.unwrap(number.values, period=2.0 ** np.ceil(np.log2(max(np.ptp(number.values), 2.0))))
    values = number.values * unit("input", number.unit or "rad").factor
    return np.unwrap(values) if float(np.ptp(values)) <= _TURN + 1e-6 else values

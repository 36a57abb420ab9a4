"""Input and output angles in separate messages: batches must give the same result as single messages."""

import random
from pathlib import Path

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st
from live import MS, OTHER_TWO, RATIO, START, TWO, Recording, config, map_of_two
from logs import content
from models import write_model

from hd_diag.bag import BagWriter
from hd_diag.messages.encoding import encode_joint_states
from hd_diag.messages.joint_states import decode_joint_states
from hd_diag.messages.publications import JOINT_STATE, encode
from hd_diag.monitor.all_joints import Monitor
from hd_diag.monitor.publications import Publication
from hd_diag.replay.replay import replay
from hd_diag.streams.alignment import Alignment, Names
from hd_diag.streams.columns import JointStates
from hd_diag.streams.rules import REMEMBERED

# Names, and which of position, velocity and effort are present.
Shape = tuple[tuple[str, ...], str]
INPUTS: Shape = (("a_motor", "b_motor"), "p")
OUTPUTS: Shape = (("a", "b"), "pe")
SHAPES: dict[str, list[Shape]] = {
    "motors and links": [INPUTS, OUTPUTS],
    "motors with speed": [(("a_motor", "b_motor"), "pv"), OUTPUTS],
    "links without effort": [INPUTS, (("a", "b"), "p")],
    "effort alone": [INPUTS, (("a", "b"), "p"), (("a", "b"), "e")],
    "every angle alone": [(("a_motor",), "p"), (("b_motor",), "p"), (("a",), "pe"), (("b",), "p")],
    "links at times apart": [INPUTS, OUTPUTS, (("a",), "p"), (("b", "stranger"), "pe")],
    "one joint together": [(("a_motor", "b_motor", "b"), "pe"), (("a",), "pe")],
    "at times together": [INPUTS, OUTPUTS, INPUTS, OUTPUTS, (("a_motor", "a", "b_motor", "b"), "pe")],
    "strangers": [INPUTS, (("x", "y"), "pe"), OUTPUTS, ((), "p"), (("a_motor",), "v")],
}


class Message:
    """One message: names, stamp and the values of its columns, None for missing columns."""

    def __init__(self, shape: Shape, stamp: int, chance: random.Random, spoiled: float) -> None:
        self.names, self.stamp = shape[0], stamp
        seconds = (stamp - START) * 1e-9
        angles = [20.0 * np.sin(3.0 * seconds + len(name)) for name in self.names]
        angles = [x if n.endswith("motor") else x / RATIO for x, n in zip(angles, self.names, strict=True)]
        self.columns: list = []
        for what in "pve":
            values = angles[:] if what == "p" else [chance.uniform(-60.0, 60.0) for _ in self.names]
            if values and chance.random() < spoiled:
                values[chance.randrange(len(values))] = chance.choice([np.nan, np.inf])
            self.columns.append(values if what in shape[1] else None)


LAGS = (0, 0, -MS // 3, 2 * MS)  # offsets of the links' stamps [ns]


def drawn(kind, chance, count, disorder=0.0, spoiled=0.0, lags=(0,)) -> list[Message]:
    """Messages in turn; some are late, early, repeated, or from a clock that was set back."""
    shapes, stamp, made = SHAPES[kind], START, []
    for number in range(count):
        stamp += chance.choice([MS // 2, MS, 3 * MS])
        if chance.random() < disorder:
            stamp += chance.choice([0, -MS, -5 * MS, 70 * MS, -400 * MS, -3000 * MS])
        shape = shapes[number % len(shapes)] if chance.random() < 0.9 else chance.choice(shapes)
        lag = chance.choice(lags) if shape[0] and not shape[0][0].endswith("motor") else 0
        made.append(Message(shape, stamp + lag, chance, spoiled))
    return made


def cdr(message: Message) -> bytes:
    columns = (None if column is None else [column] for column in message.columns)
    return encode_joint_states(message.names, [message.stamp], *columns)[0].tobytes()


def play(monitor: Monitor, messages: list[Message], sizes, events=(), reports=()) -> tuple:
    """Publications by topic and the diagnostics, for messages taken in batches of the given sizes.

    Events and reports come before the messages with their numbers.
    """
    recording, begin, turn, events = Recording(), 0, 0, dict(events)
    while begin < len(messages):
        if begin in events:
            EVENTS[events[begin]](monitor)
        cuts = [at for at in {*events, *reports} if at > begin]
        end = min([begin + sizes[turn % len(sizes)], len(messages), *cuts])
        received = START + np.arange(begin, end) // 2  # some arrive at the same time
        published: list[Publication] = []
        if begin in reports:
            published.append(monitor.tick(START + begin, 7 * begin, {}))
        shapes, _ = decode_joint_states([cdr(each) for each in messages[begin:end]])
        published += monitor.mixed_states(received, shapes)
        for each in map(encode, published):
            recording(each)
        begin, turn = end, turn + 1
    return recording.topics(), monitor.tick(START + len(messages), START, {})


EVENTS = {
    "configure": lambda monitor: monitor.configure(OTHER_TWO),
    "back": lambda monitor: monitor.configure(TWO),
    "maps": lambda monitor: [monitor.use_map(name, map_of_two()) for name in monitor.joints],
    "temperature": lambda monitor: monitor.temperature("a", 31.5),
    "window": Monitor.begin_window,
}


@hypothesis.settings(max_examples=100, suppress_health_check=[hypothesis.HealthCheck.too_slow])
@hypothesis.given(
    kind=st.sampled_from(sorted(SHAPES)),
    seed=st.integers(0, 2**32),
    count=st.integers(2, 90),
    disorder=st.sampled_from([0.0, 0.0, 0.03, 0.3]),
    spoiled=st.sampled_from([0.0, 0.0, 0.02, 0.3]),
    sizes=st.lists(st.integers(1, 60), min_size=1, max_size=4),
    events=st.dictionaries(st.integers(0, 60), st.sampled_from(sorted(EVENTS)), max_size=4),
    reports=st.frozensets(st.integers(0, 89), max_size=5),
)
def test_many_at_once_is_one_at_a_time(kind, seed, count, disorder, spoiled, sizes, **calls) -> None:
    messages = drawn(kind, random.Random(seed), count, disorder, spoiled, LAGS)
    once = play(Monitor(TWO), messages, sizes, **calls)
    assert once == play(Monitor(TWO), messages, [1], **calls)


def test_an_extended_model_runs_along_both_streams(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_model(tmp_path / "model.json", "viscous_windup", "hysteresis")
    given = config(joint_1__model_file=str(path))
    monkeypatch.setitem(SHAPES, "x", [(("joint_1_motor",), "pv"), (("joint_1",), "pe")])
    messages = drawn("x", random.Random(8), 400)
    once = play(Monitor(given), messages, [133])
    assert len(once[0]["~/residual"]) > 150
    assert once == play(Monitor(given), messages, [1])


JUMP, GAP, HOLD = 1000 * MS, 50 * MS, 200 * MS


class Walk:
    """The rules in their simplest form: lists of everything, searched from the start."""

    def __init__(self) -> None:
        self.samples: list[tuple] = []
        self.rejected = self.unpaired = self.stretch = 0
        self.reported: dict[str, list[float]] = {"input": [], "output": []}
        self.begin()

    def begin(self) -> None:
        self.inputs: list[tuple[int, float]] = []
        self.waiting: list[tuple[int, float, float]] = []
        self.output, self.torque = -(2**62), (-(2**62), np.nan)
        self.since = {name: len(angles) for name, angles in self.reported.items()}

    def take(self, stamp: int, given: dict[str, float]) -> None:
        last = self.inputs[-1][0] if self.inputs else -(2**62)
        if stamp < max(last, self.output) - JUMP:
            self.begin()
            self.stretch, last = self.stretch + 1, -(2**62)
        before = last if "input" in given else self.output if "output" in given else -(2**62)
        if stamp <= before:
            self.rejected += 1
            return
        given = given | {name: self.turned(name, given[name]) for name in self.reported if name in given}
        if "torque" in given:
            self.torque = stamp, given["torque"]
        if "input" in given:
            self.inputs.append((stamp, given["input"]))
            output = given.get("output", np.nan)
            self.samples.append((stamp, self.stretch, given["input"], output, self.load(stamp)))
        if "output" in given:
            self.output = max(self.output, stamp)
            if "input" not in given:
                self.unpaired += len(self.waiting) == REMEMBERED
                self.waiting = [*self.waiting[-REMEMBERED + 1 :], (stamp, given["output"], self.load(stamp))]
        while self.waiting and self.inputs and self.waiting[0][0] <= self.inputs[-1][0]:
            at, output, torque = self.waiting.pop(0)
            angle = self.angle(at)
            self.unpaired += angle is None
            if angle is not None:
                self.samples.append((at, self.stretch, angle, output, torque))

    def turned(self, name: str, angle: float) -> float:
        """The unwrapped angle, for an encoder that has stayed within one turn so far."""
        self.reported[name].append(angle)
        angles = np.array(self.reported[name])
        steps = np.diff(angles[self.since[name] :])
        if steps.size and np.ptp(angles) > 2.0 * np.pi:
            return angle
        return angle - 2.0 * np.pi * np.sum(np.sign(steps) * (np.abs(steps) > np.pi))

    def load(self, stamp: int) -> float:
        return self.torque[1] if abs(stamp - self.torque[0]) <= HOLD else np.nan

    def angle(self, stamp: int) -> float | None:
        known = self.inputs[-REMEMBERED:]
        later = next(k for k, (at, _) in enumerate(known) if at >= stamp)
        if known[later][0] == stamp:
            return known[later][1]
        if not later or known[later][0] - known[later - 1][0] > GAP:
            return None
        (begin, start), (end, stop) = known[later - 1 : later + 1]
        return start + (stop - start) * (float(stamp - begin) / float(end - begin))


@hypothesis.settings(max_examples=60)
@hypothesis.given(
    seed=st.integers(0, 2**32),
    count=st.integers(0, 900),
    apart=st.sampled_from([0.0, 0.3, 1.0]),
    disorder=st.sampled_from([0.0, 0.02, 0.2]),
    size=st.sampled_from([1, 7, 1000]),
)
def test_samples_are_those_of_the_walk(seed, count, apart, disorder, size) -> None:
    chance, walk, streams = random.Random(seed), Walk(), Alignment([Names("m", "l")])
    kinds = [("input",), ("output",), ("output", "torque"), ("torque",)]
    reach = chance.choice([3.0, 50.0])
    rows, stamp, samples = [], START, []
    for _ in range(count):
        stamp += chance.choice([1, MS, MS, 30 * MS])
        if chance.random() < disorder:
            stamp += chance.choice([0, -MS, -90 * MS, 400 * MS, -3000 * MS])
        kind = chance.choice(kinds) if chance.random() < apart else ("input", "output", "torque")
        late = chance.choice([0, 0, -5 * MS]) if "input" not in kind else 0
        rows.append((stamp + late, {name: chance.uniform(-reach, reach) for name in kind}))
    for begin in range(0, count, size):
        part = rows[begin : begin + size]
        shapes = [shape_of(row, *entry) for row, entry in enumerate(part)]
        found = streams.take(START + np.arange(len(part)), shapes)
        samples += zip(found.stamp, found.stretch - 1, *found[6:9], strict=True)
    for entry in rows:
        walk.take(*entry)
    np.testing.assert_equal(samples, walk.samples)
    joint = streams.joints[0]
    assert (joint["rejected"], joint["unpaired"]) == (walk.rejected, walk.unpaired)


def shape_of(row: int, stamp: int, given: dict[str, float]) -> JointStates:
    """A message of motor m and link l."""
    names = tuple(name for name, what in (("m", "input"), ("l", "output")) if what in given) or ("l",)
    angles = [given[what] for what in ("input", "output") if what in given]
    efforts = np.array([[given.get("torque", 0.0) if name == "l" else np.nan for name in names]])
    columns = (np.array([angles]) if angles else None), None, efforts if "torque" in given else None
    return JointStates(np.array([row]), np.array([stamp]), names, "", *columns)


def test_an_input_that_is_divided_and_wraps() -> None:
    """The input is reported on the output's side and wraps there; the factor of 100 comes afterwards."""
    streams, turns = Alignment([Names("m", "l", input_factor=100.0)]), np.linspace(0.0, 9.0, 40)
    wrapped = np.mod(turns + np.pi, 2.0 * np.pi) - np.pi
    given = [{"input": angle, "output": turn % 6.0} for angle, turn in zip(wrapped, turns, strict=True)]
    states = [shape_of(row, START + row * MS, each) for row, each in enumerate(given)]
    found = streams.take(np.zeros(40, np.int64), states)
    np.testing.assert_allclose(found.input_angle, 100.0 * turns, rtol=0, atol=1e-9)


def test_a_name_that_stands_twice_moves_no_other_column() -> None:
    """The last of two columns with the same name counts, and the link keeps its effort."""
    position, effort = np.array([[1.0, 2.0, 3.0]]), np.array([[4.0, 5.0, 6.0]])
    states = JointStates(np.array([0]), np.array([START]), ("m", "m", "l"), "", position, None, effort)
    found = Alignment([Names("m", "l")]).take(np.zeros(1, np.int64), [states])
    assert (found.input_angle[0], found.output_angle[0], found.torque[0]) == (2.0, 3.0, 6.0)


def test_topics_that_alternate_are_as_one(tmp_path: Path) -> None:
    """Motors and links on separate topics; pairs of messages share a log time."""
    outputs = []
    for name, topics in (("one", ("/joint_states", "/joint_states")), ("two", ("/motors", "/links"))):
        bag, out = tmp_path / f"{name}.mcap", tmp_path / f"{name}_out.mcap"
        with BagWriter(bag) as writer:
            for number, entry in enumerate(drawn("motors and links", random.Random(2), 600)):
                topic = topics[entry.names[0] == "a"]
                writer.write(topic, JOINT_STATE, cdr(entry), START + number // 2 * MS)
        replay(bag, out, TWO)
        found = content(out)
        outputs.append({topic: messages for topic, messages in found.items() if "hd_diag/" in topic})
        assert {topic: messages for topic, messages in found.items() if topic in topics} == content(bag)
    assert outputs[0] == outputs[1]
    assert len(outputs[0]["/hd_diag/residual"]) > 250

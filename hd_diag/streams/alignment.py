"""Messages of joints to aligned samples, live and offline: the rules for clocks, pairs and torques.

* **A stamp of zero counts as missing.** The time of reception takes its place, and such messages are counted;
  a mapping may ask for this everywhere (``stamp: reception``). A step from such a stamp back to one of a
  header does not count as a clock set back.
* **Stamps rise.** A stamp that repeats the last, or is at most `CLOCK_JUMP` before it, is late: refused. One
  further back is of a clock that was set back: the joint's stream starts again (a new `stretch`), and nothing
  of before is used with what comes after.
* **Pairs.** Input and output angle of one message belong together. An output angle that comes apart waits for
  the input angle at its own stamp: interpolated between two inputs that are at most `PAIRING_GAP` apart.
* **Torque.** A sample has the last torque reported up to its stamp, if that is at most `LONGEST_HOLD` old;
  otherwise its torque is unknown, and live the configured torque is taken. Offline the next torque is known
  too: `torque_between` interpolates between reported torques at most that far apart.
* **A velocity is integrated** from the output's angle on: see `kernel._integrate`.
* **Turns are counted.** An angle within one turn that jumps by over half of one wraps, as does a counter of
  16 or 32 bits: it goes the short way.
* **A nan** mostly means that nothing was measured: the value counts as not reported until a number comes. So
  does an output angle beside a torque that comes apart from the input. Other values that are no numbers, and
  those beyond `LARGEST_ANGLE` and `LARGEST_TORQUE`, refuse the sample.

What comes out depends on the sequence of rows alone, to the last bit, however many come at once.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from hd_diag.arrays import Bytes, Floats, Integers, Times
from hd_diag.streams.columns import BLOCKS, LARGEST_ANGLE, LARGEST_TORQUE, JointStates
from hd_diag.streams.rules import INPUT, JOINT, LONGEST_HOLD, NEVER, OUTPUT, REMEMBERED, Given, Reason, unseen

# Of JOINT, as in Names.
_CONFIGURED = ["assumed_torque", "input_factor", "velocity_ratio", "input_counter", "output_counter"]
_LAYOUTS = 64  # of messages, whose columns are remembered

Arrived = dict[tuple[tuple[str, ...], tuple[str, ...]], None]
"""Names and keys of messages, each pair once, in the order in which they came."""

ELSEWHERE = "-"
"""Key of a signal that no message gives."""


class Names(NamedTuple):
    """What a joint is called in messages.

    Names of input and output in joint states, and the torque where none is known [N m]; keys of input,
    output, torque and speed where they are signals of their own; by what reported inputs are multiplied; the
    ratio where the input is known by its velocity, else 0; 16 bits of counts [rad] where angles are counted.
    """

    input_joint: str
    output_joint: str
    torque: float = math.nan
    keys: tuple[str, str, str, str] = ("", "", "", "")
    input_factor: float = 1.0
    velocity_ratio: float = 0.0
    input_counter: float = 0.0
    output_counter: float = 0.0


class Aligned(NamedTuple):
    """Samples of joints, in the order of the messages that gave them, each column (m,).

    Position of the message that made the sample complete, among those taken together; number of the joint;
    stamp of the sample and of the reported torque [ns]; number of the joint's stream, another one after its
    clock was set back; 1 in `paired` where the output angle came apart from the input, which had a sample at
    its own stamp. Angles [rad], output nan where none is reported; torque on the link, reported or assumed
    [N m]; speed of the input [rad/s], nan where it is not reported.
    """

    row: Times
    joint: Integers
    stamp: Times
    torque_stamp: Times
    stretch: Integers
    paired: Integers
    input_angle: Floats
    output_angle: Floats
    torque: Floats
    speed: Floats

    def part(self, rows: Any) -> Aligned:
        """Some of the samples."""
        return Aligned(*(column[rows] for column in self))


class _Columns(NamedTuple):
    """Where values of k joints are in messages of one layout, (4 k,), what is given (1, k), if anything.

    `problem` says why the messages are refused for joints whose positions they do not tell.
    """

    place: Integers
    given: Bytes
    is_foreign: bool
    problem: str = ""


class Alignment:
    """Streams of k joints by their names.

    Of each joint so many inputs are `remembered` for outputs, and so many outputs may wait. `joints` (k,) are
    records of `JOINT`, `encoders` (k, 2) of `ENCODER`, of input and output; `texts` reasons that were given
    to `reject`; `foreign` counts messages that name none of the joints. `arrived` are names and keys of
    messages since `turn`; `before` those of the time before, and of the last two times with any.
    """

    def __init__(self, names: Sequence[Names], remembered: int = REMEMBERED) -> None:
        self._names = list(names)
        self.joints = np.zeros(len(names), JOINT)
        self.joints["heard"] = -1
        self.joints["least_torque"], self.joints["most_torque"] = math.inf, -math.inf
        self.texts = [""] * len(names)
        self._inputs = np.zeros((len(names), remembered), INPUT)
        self._waiting = np.zeros((len(names), remembered), OUTPUT)
        self.encoders = unseen(2 * len(names)).reshape(-1, 2)
        self._columns: dict[Any, _Columns] = {}
        self.foreign = 0
        self.arrived: Arrived = {}
        self.before: list[Arrived] = []
        self._last: _Columns | None = None
        self.joints[_CONFIGURED][:] = [(each.torque, *each[4:]) for each in names]
        kernel().begin_after(self.joints, NEVER - 1)

    @property
    def state(self) -> tuple[Any, Any, Any, Any]:
        """All that is remembered: joints, encoders (k, 2), rings (k, remembered) of inputs and of outputs."""
        return self.joints, self.encoders, self._inputs, self._waiting

    def configure(self, number: int, names: Names) -> None:
        """Give a joint other names, which restarts its stream, or another assumed torque."""
        before, self._names[number] = self._names[number], names
        self.joints[_CONFIGURED][number] = names.torque, *names[4:]
        if names._replace(torque=before.torque) != before:
            self._columns.clear()
            kernel().begin_after(self.joints[number : number + 1], NEVER - 1)

    def take(
        self, heard: Times, shapes: Sequence[JointStates], refused: Sequence[tuple[int, str]] = ()
    ) -> Aligned:
        """Samples that messages complete, which arrived at times `heard` (n,) [ns].

        The rows of the messages of each layout are positions in `heard`, as are those of messages that cannot
        be read (row, reason): they count as rejected for every joint.
        """
        stamp, values, given, problems = self._rows(heard.size, shapes)
        if refused:
            given[[row for row, _ in refused]] = Given.REFUSED
            problems |= dict(refused)
        whole, found = kernel().align(stamp, heard, values, given, *self.state)
        if problems:
            for number in np.flatnonzero(self.joints["reason"] == Reason.UNREADABLE):
                self.texts[number] = f"a message {problems[int(self.joints['reason_late'][number])]}"
                self.joints["reason"][number] = Reason.OTHER
        return Aligned(*whole, *found)

    def turn(self) -> None:
        """Let `arrived` start again."""
        self.before = [*[each for each in self.before if each][-2:], self.arrived]
        self.arrived, self._last = {}, None

    def clock_set_back(self, stamp: int) -> None:
        """Restart the streams of joints with a last stamp after `stamp` [ns]: the clock was set back."""
        before = self.joints["stretch"].copy()
        kernel().begin_after(self.joints, stamp)
        self.joints["clock_jumps"] += self.joints["stretch"] - before

    def reject(self, number: int, reason: str) -> None:
        """Count a sample of a joint that cannot be used."""
        self.joints["rejected"][number] += 1
        self.joints["reason"][number] = Reason.OTHER
        self.texts[number] = reason

    def last_rejection(self, number: int) -> str:
        """Why the last sample of a joint that was refused could not be used; empty if there was none."""
        joint, names = self.joints[number], self._names[number]
        value, late = joint["reason_value"], int(joint["reason_late"])
        match Reason(joint["reason"]):
            case Reason.NAMELESS:
                return "the message names the joint and gives no position of it"
            case Reason.INPUT:
                return _bad_value(f"input angle of {names.input_joint}", value, LARGEST_ANGLE, "rad")
            case Reason.OUTPUT:
                return _bad_value(f"output angle of {names.output_joint}", value, LARGEST_ANGLE, "rad")
            case Reason.TORQUE:
                return _bad_value(f"effort of {names.output_joint}", value, LARGEST_TORQUE, "N m")
            case Reason.LATE_INPUT:
                return _late(names.input_joint, late)
            case Reason.LATE_OUTPUT:
                return _late(names.output_joint, late)
        return self.texts[number]

    def _rows(self, count: int, shapes: Sequence[JointStates]) -> tuple[Times, Floats, Bytes, dict[int, str]]:
        """Stamps (n,), values (n, k, 4), what is given (n, k), and what is wrong with rows."""
        problems: dict[int, str] = {}
        if len(shapes) == 1 and shapes[0].stamp.size == count:
            states = shapes[0]
            columns = self._columns_of(states)
            given = columns.given if count == 1 else np.repeat(columns.given, count, axis=0)
            problems = dict.fromkeys(range(count), columns.problem) if columns.problem else {}
            return states.stamp, self._values(states, columns), given, problems
        stamp, given = np.zeros(count, np.int64), np.zeros((count, self.joints.size), np.uint8)
        values = np.zeros((count, self.joints.size, 4))
        for states in shapes:
            columns = self._columns_of(states)
            stamp[states.row], given[states.row] = states.stamp, columns.given
            values[states.row] = self._values(states, columns)
            if columns.problem:
                problems |= dict.fromkeys(states.row.tolist(), columns.problem)
        return stamp, values, given, problems

    def _values(self, states: JointStates, columns: _Columns) -> Floats:
        blocks = [block for block in states.blocks if block is not None]
        joined = np.concatenate([np.zeros((states.stamp.size, 1)), *blocks], axis=1)
        return joined.take(columns.place, axis=1).reshape(-1, self.joints.size, 4)

    def _columns_of(self, states: JointStates) -> _Columns:
        widths = (None if block is None else block.shape[1] for block in states.blocks)
        key = states.names, states.keys, states.unstamped, *widths
        found = self._columns.get(key)
        if found is None:
            if len(self._columns) >= _LAYOUTS:
                self._columns.clear()
            found = self._columns[key] = self._find(states)
        if found is not self._last and len(self.arrived) < _LAYOUTS:
            self._last = found
            self.arrived[states.names, states.keys] = None
        if found.is_foreign:
            self.foreign += states.stamp.size
        return found

    def _find(self, states: JointStates) -> _Columns:
        columns = {name: column for column, name in enumerate(states.names)}
        signals = {name: column for column, name in enumerate(states.keys)}
        begins, width = [], 1
        for number, block in enumerate(states.blocks):
            is_told = block is not None and (number == len(BLOCKS) or not states.misfit(number))
            begins.append(width if is_told else None)
            width += 0 if block is None else block.shape[1]
        problem = states.misfit(0)
        position, velocity, effort, mapped = begins
        place = np.zeros((len(self._names), 4), np.int64)
        given = np.zeros((1, len(self._names)), np.uint8)
        for number, names in enumerate(self._names):
            own, out = columns.get(names.input_joint), columns.get(names.output_joint)
            usual = (own, position), (out, position), (out, effort), (own, velocity)
            for kind, (key, place_of) in enumerate(zip(names.keys, usual, strict=True)):
                column, begin = (signals.get(key), mapped) if key else place_of
                if column is not None:
                    given[0, number] |= Given.NAMED
                if column is not None and begin is not None:
                    place[number, kind] = begin + column
                    given[0, number] |= 1 << kind
                elif column is not None and kind < 2 and not key and problem:
                    given[0, number] |= Given.REFUSED
        if states.keys and not given.any():
            given[:] = Given.OTHER
        is_foreign = not given.any()
        given[given > 0] |= Given.UNSTAMPED * states.unstamped
        return _Columns(place.reshape(-1), given, is_foreign, problem)


def torque_between(stamp: Times, stretch: Integers, torque: Floats, torque_stamp: Times) -> Floats:
    """Torque (m,) [N m] of one joint's samples where the next reported one is known as well: interpolated.

    Of columns (m,) as in `Aligned`, by stamps in each stretch; by the rules above. It is nan where none is
    reported nearby, infinite beside an infinite one.
    """
    found = torque.copy()
    for number in np.unique(stretch[torque_stamp != stamp]):
        rows = np.flatnonzero(stretch == number)
        held = rows[~np.isnan(torque[rows])]
        if not held.size:
            continue
        known, first = np.unique(torque_stamp[held], return_index=True)
        at = stamp[rows]
        after = np.minimum(known.searchsorted(at), known.size - 1)
        before = np.maximum(after - 1, 0)
        gap = known[after] - np.minimum(known[before], at)
        near = (at < known[after]) & (gap <= LONGEST_HOLD)
        between = np.interp((at - known[0]) * 1e-9, (known - known[0]) * 1e-9, torque[held[first]])
        found[rows[near]] = between[near]
    return found


@functools.cache
def kernel() -> ModuleType:
    """What is compiled, imported when first needed."""
    from hd_diag.streams import kernel as compiled

    return compiled


def _bad_value(what: str, value: float, largest: float, unit: str) -> str:
    return f"{what} is {value:g}" + (f" {unit}, beyond {largest:g}" if math.isfinite(value) else "")


def _late(name: str, late: int) -> str:
    same = "repeats the last; where stamps stay the same, `stamp: reception` takes the time of reception"
    what = f"is {late / 1e9:.6f} s before the last" if late else same
    return f"stamp of {name} {what}"

"""Aligns messages of joints to samples, live and offline: the rules for clocks, pairs and torques.

* **A stamp of zero counts as missing.** The time of reception takes its place, and such messages are counted.
  A mapping may ask for this everywhere (``stamp: reception``). A step back between a time of reception and a
  header's stamp restarts the stream, but does not count as a clock set back.
* **Stamps rise.** A stamp that repeats the last, or is at most `CLOCK_JUMP` before it, is late and refused.
  An earlier one means that the clock was set back: the joint's stream starts again (a new `stretch`), and no
  earlier data are used with later data.
* **Pairs.** Input and output angle of one message belong together. A separate output angle waits for the
  input angle at its stamp, interpolated between two inputs that are at most `PAIRING_GAP` apart.
* **Torque.** A sample has the last torque reported up to its stamp, if that is at most `LONGEST_HOLD` old.
  Otherwise its torque is unknown; live, the configured torque replaces it. Offline the next torque is known
  too: `torque_between` interpolates between reported torques at most that far apart.
* **A velocity is integrated**, beginning at the output's angle: see `kernel._integrate`.
* **Turns are counted.** An angle within one turn wraps if it jumps by over half a turn. A counter of 16 or 32
  bits wraps likewise. The shorter way is taken.
* **A nan** mostly means that nothing was measured: the value counts as not reported until a number comes. In
  messages with a torque and no input, a nan output angle always counts as not reported. Any other value that
  is not a number, or is beyond `LARGEST_ANGLE` or `LARGEST_TORQUE`, makes the sample refused.

The output depends on the sequence of rows alone, to the last bit, and not on the number of rows per call.
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

# Fields of JOINT that Names configures, in its order.
_CONFIGURED = ["assumed_torque", "input_factor", "velocity_ratio", "input_counter", "output_counter"]
_LAYOUTS = 64  # message layouts whose columns are cached

Arrived = dict[tuple[tuple[str, ...], tuple[str, ...]], None]
"""Names and keys of messages, each pair once, in the order in which they came."""

ELSEWHERE = "-"
"""Key of a signal that no message gives."""


class Names(NamedTuple):
    """How a joint appears in messages.

    `input_joint` and `output_joint` are its names in joint states, `torque` is assumed where none is known
    [N m]. `keys` are those of input, output, torque and speed that are mapped signals. Reported inputs are
    multiplied by `input_factor`. `velocity_ratio` is the ratio if the input is known by its velocity, else 0.
    `input_counter`, `output_counter` are the angle of 16 bits of counts [rad], 0 if angles are not counted.
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
    """Samples of joints, in the order of the messages that completed them, each column (m,).

    `row` is the position of the completing message in its batch, `joint` the joint's number. `stamp` is that
    of the sample, `torque_stamp` that of the reported torque [ns]. `stretch` numbers the joint's streams: a
    clock set back begins another one. `paired` is 1 if the output angle came separately from the input, which
    has a sample at its own stamp. Angles are in [rad], the output is nan if none is reported. `torque` is on
    the link, reported or assumed [N m]. `speed` is the input's [rad/s], nan if it is not reported.
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
        """Selected samples."""
        return Aligned(*(column[rows] for column in self))


class _Columns(NamedTuple):
    """Columns of the values of k joints in messages of one layout (4 k,), and flags of given values (1, k).

    `is_foreign` if the messages give nothing of any joint. `problem` is the reason why they are refused for
    joints whose positions they do not tell.
    """

    place: Integers
    given: Bytes
    is_foreign: bool
    problem: str = ""


class Alignment:
    """Streams of k joints by their names.

    `remembered` inputs of each joint are kept for outputs, and as many outputs may wait. `joints` (k,) are
    records of `JOINT`, `encoders` (k, 2) records of `ENCODER` for input and output. `texts` are reasons given
    to `reject`; `foreign` counts messages that name none of the joints. `arrived` are names and keys of
    messages since the last `turn`; `before` those of the interval before it and of two earlier ones with any.
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
        """State between calls: joints, encoders (k, 2), rings (k, remembered) of inputs and of outputs."""
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
        """Samples completed by messages that arrived at times `heard` (n,) [ns].

        `shapes` are the messages of each layout, with rows that are positions in `heard`. `refused` are (row,
        reason) of messages that cannot be read; they count as rejected for every joint.
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
        """Begin another interval: move `arrived` to `before`."""
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
        """Why the last refused sample of a joint could not be used; empty if none was refused."""
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
        """Stamps (n,), values (n, k, 4), flags of given values (n, k), and problems by row."""
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
    """Torque (m,) [N m] of one joint's samples, interpolated between reported torques by the rules above.

    The arguments are columns (m,) as in `Aligned`. Interpolation is by stamps in each stretch. The torque is
    nan where none is reported nearby, and infinite next to an infinite one.
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
    """The compiled kernels, imported when first needed."""
    from hd_diag.streams import kernel as compiled

    return compiled


def _bad_value(what: str, value: float, largest: float, unit: str) -> str:
    return f"{what} is {value:g}" + (f" {unit}, beyond {largest:g}" if math.isfinite(value) else "")


def _late(name: str, late: int) -> str:
    same = "repeats the last; where stamps stay the same, `stamp: reception` takes the time of reception"
    what = f"is {late / 1e9:.6f} s before the last" if late else same
    return f"stamp of {name} {what}"

"""Messages of joints to aligned samples, live and offline: the rules for clocks, pairs and torques.

* **Stamps rise.** A stamp that repeats the last, or is at most `CLOCK_JUMP` before it, is late: refused. One
  further back is of a clock that was set back: the joint's stream begins anew (a new `stretch`), and nothing
  of before is used with what comes after.
* **Pairs.** Input and output angle of one message belong together. An output angle that comes apart waits for
  the input angle at its own stamp: interpolated between two inputs that are at most `PAIRING_GAP` apart.
* **Torque.** Of a sample it is the last one reported up to there, and only if that one's stamp is at most
  `LONGEST_HOLD` away; else it is not known. Live the configured torque then stands for it. Offline, where the
  next one is known too, `torque_between` interpolates between reported torques at most as far apart.
* **A velocity is integrated** from the output's angle on: see `kernel_integration`.
* **Turns are counted.** An angle within one turn that jumps by over half of one wraps, as does a counter of
  16 or 32 bits: it goes the short way.
* **What is not measured** is often reported as nan: then it counts as not reported, until a number comes; an
  output angle also beside a torque that comes apart from the input. Other values that are none, and those
  beyond `LARGEST_ANGLE` and `LARGEST_TORQUE`, refuse the sample.

What comes out depends on the sequence of rows alone, to the last bit, however many come at once.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from hd_diag.arrays import Bytes, Floats, Integers, Times
from hd_diag.streams.columns import LARGEST_ANGLE, LARGEST_TORQUE, JointStates
from hd_diag.streams.rules import INPUT, JOINT, NEVER, OUTPUT, REMEMBERED, Given, Reason, unseen

# Of JOINT, as in Names.
_CONFIGURED = ["assumed_torque", "input_factor", "velocity_ratio", "input_counter", "output_counter"]
_LAYOUTS = 64  # of messages, whose columns are remembered
_NOTHING = np.zeros((1, 1))
_NO_MOMENTS = np.empty((3, 0), np.int64)

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

    Attributes
    ----------
    row : ndarray of int64
        Position of the message that made the sample complete, among those taken together.
    joint : ndarray of int64
        Number of the joint.
    stamp, torque_stamp : ndarray of int64
        Of the sample; of the reported torque [ns].
    stretch : ndarray of int64
        Number of the joint's stream: another one after its clock was set back.
    paired : ndarray of int64
        1 where the output angle came apart from the input, which had a sample at its own stamp; else 0.
    input_angle, output_angle : ndarray
        [rad]; output nan where none is reported.
    torque : ndarray
        On the link, reported or assumed [N m].
    speed : ndarray
        Of the input [rad/s]; nan where it is not reported.
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


class Seen(NamedTuple):
    """What is known of k joints at l moments between messages.

    Attributes
    ----------
    joints : ndarray of JOINT, shape (l, k)
    last_rejections : list of l lists of k str
        Why the last sample of a joint that was refused could not be used; empty if there was none.
    foreign : ndarray of int64, shape (l,)
        Messages that name none of the joints.
    samples : ndarray of int64, shape (l,)
        Of the samples taken together, how many came before.
    """

    joints: Any
    last_rejections: list[list[str]]
    foreign: Integers
    samples: Integers


class _Columns(NamedTuple):
    """Where values of k joints are in messages of one layout, (4 k,), what is given (1, k), if anything."""

    place: Integers
    given: Bytes
    is_foreign: bool


class Alignment:
    """Streams of joints.

    Parameters
    ----------
    names : sequence of k Names
    remembered : int, optional
        Inputs that are kept for outputs, and outputs that may wait, of each joint.

    Attributes
    ----------
    joints : ndarray of JOINT, shape (k,)
        What is known of each.
    encoders : ndarray of ENCODER, shape (k, 2)
        Of input and output.
    texts : list of str
        Reasons that were given to `reject`.
    foreign : int
        Messages that name none of the joints.
    """

    def __init__(self, names: Sequence[Names], remembered: int = REMEMBERED) -> None:
        self._names = list(names)
        self.joints = np.zeros(len(names), JOINT)
        self.joints["heard"] = -1
        self.texts = [""] * len(names)
        self._inputs = np.zeros((len(names), remembered), INPUT)
        self._waiting = np.zeros((len(names), remembered), OUTPUT)
        self.encoders = unseen(2 * len(names)).reshape(-1, 2)
        self._unseen = np.empty((0, len(names)), JOINT)
        self._columns: dict[Any, _Columns] = {}
        self.foreign = 0
        self.joints[_CONFIGURED][:] = [(each.torque, *each[4:]) for each in names]
        kernel().begin_after(self.joints, NEVER - 1)

    @property
    def state(self) -> tuple[Any, Any, Any, Any]:
        """All that is remembered: joints, encoders (k, 2), rings (k, remembered) of inputs and of outputs."""
        return self.joints, self.encoders, self._inputs, self._waiting

    def configure(self, number: int, names: Names) -> None:
        """Let a joint have other names, with which its stream begins anew, or another assumed torque."""
        before, self._names[number] = self._names[number], names
        self.joints[_CONFIGURED][number] = names.torque, *names[4:]
        if names._replace(torque=before.torque) != before:
            self._columns.clear()
            kernel().begin_after(self.joints[number : number + 1], NEVER - 1)

    def take(
        self, heard: Times, shapes: Sequence[JointStates], refused: Sequence[tuple[int, str]] = ()
    ) -> Aligned:
        """Aligned samples that messages complete.

        Parameters
        ----------
        heard : ndarray of int64, shape (n,)
            When each arrived [ns].
        shapes : sequence of JointStates
            The messages of each layout; their `row` are positions in `heard`.
        refused : sequence of (int, str), optional
            Messages that cannot be read, which may have been of every joint: position, and what they are.

        Returns
        -------
        Aligned
        """
        return self._take(heard, shapes, refused, _NO_MOMENTS, self._unseen)[0]

    def take_and_look(
        self,
        heard: Times,
        shapes: Sequence[JointStates],
        refused: Sequence[tuple[int, str]],
        rows: Sequence[int],
        times: Sequence[int],
    ) -> tuple[Aligned, Seen]:
        """As `take`, and what is known before messages with rising numbers, at rising `times` [ns]."""
        before, texts, seen = self.foreign, [*self.texts], np.empty((len(rows), self.joints.size), JOINT)
        moments = np.array([rows, times, rows], np.int64)
        samples, given = self._take(heard, shapes, refused, moments, seen)
        foreign = before + np.searchsorted(np.flatnonzero(~given.any(axis=1)), moments[0])
        unreadable = dict(refused)
        reasons = [
            [self._reason(number, joint, texts, unreadable) for number, joint in enumerate(joints)]
            for joints in seen
        ]
        return samples, Seen(seen, reasons, foreign, moments[2])

    def _take(
        self,
        heard: Times,
        shapes: Sequence[JointStates],
        refused: Sequence[tuple[int, str]],
        moments: Times,
        seen: Any,
    ) -> tuple[Aligned, Bytes]:
        """Aligned samples, and what the messages gave."""
        stamp, values, given = self._rows(heard.size, shapes)
        if refused:
            given[[row for row, _ in refused]] = Given.REFUSED
        whole, found = kernel().align(stamp, heard, values, given, *self.state, moments, seen)
        unreadable = self.joints["reason"] == Reason.UNREADABLE if refused else ()
        for number in np.flatnonzero(unreadable).tolist():
            self.texts[number] = self._reason(number, self.joints[number], self.texts, dict(refused))
            self.joints["reason"][number] = Reason.OTHER
        return Aligned(*whole, *found), given

    def clock_set_back(self, stamp: int) -> None:
        """Let joints whose last stamp is later than one [ns] begin anew: the clock was set back."""
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
        return self._reason(number, self.joints[number], self.texts, {})

    def _reason(self, number: int, joint: Any, texts: Sequence[str], unreadable: Mapping[int, str]) -> str:
        value, late, names = joint["reason_value"], int(joint["reason_late"]), self._names[number]
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
            case Reason.UNREADABLE:
                return f"a message {unreadable[late]}"
        return texts[number]

    def _rows(self, count: int, shapes: Sequence[JointStates]) -> tuple[Times, Floats, Bytes]:
        """Stamps (n,), values (n, k, 4) and what is given (n, k)."""
        if len(shapes) == 1 and shapes[0].stamp.size == count:
            states = shapes[0]
            columns = self._columns_of(states)
            given = columns.given if count == 1 else np.repeat(columns.given, count, axis=0)
            return states.stamp, self._values(states, columns), given
        stamp, given = np.zeros(count, np.int64), np.zeros((count, self.joints.size), np.uint8)
        values = np.zeros((count, self.joints.size, 4))
        for states in shapes:
            columns = self._columns_of(states)
            stamp[states.row], given[states.row] = states.stamp, columns.given
            values[states.row] = self._values(states, columns)
        return stamp, values, given

    def _values(self, states: JointStates, columns: _Columns) -> Floats:
        nothing = _NOTHING if states.stamp.size == 1 else np.zeros((states.stamp.size, 1))
        blocks = [block for block in states.blocks if block is not None]
        joined = np.concatenate([nothing, *blocks], axis=1)
        return joined.take(columns.place, axis=1).reshape(-1, self.joints.size, 4)

    def _columns_of(self, states: JointStates) -> _Columns:
        key = states.names, states.keys, *(block is None for block in states.blocks)
        found = self._columns.get(key)
        if found is None:
            if len(self._columns) >= _LAYOUTS:
                self._columns.clear()
            found = self._columns[key] = self._find(states)
        if found.is_foreign:
            self.foreign += states.stamp.size
        return found

    def _find(self, states: JointStates) -> _Columns:
        columns = {name: column for column, name in enumerate(states.names)}
        signals = {name: column for column, name in enumerate(states.keys)}
        begins, width = [], 1
        for block in states.blocks:
            begins.append(None if block is None else width)
            width += 0 if block is None else block.shape[1]
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
        if states.keys and not given.any():
            given[:] = Given.OTHER
        return _Columns(place.reshape(-1), given, not given.any())


@functools.cache
def kernel() -> ModuleType:
    """What is compiled, imported when first needed."""
    from hd_diag.streams import kernel as compiled

    return compiled


def _bad_value(what: str, value: float, largest: float, unit: str) -> str:
    return f"{what} is {value:g}" + (f" {unit}, beyond {largest:g}" if math.isfinite(value) else "")


def _late(name: str, late: int) -> str:
    what = f"is {late / 1e9:.6f} s before the last" if late else "repeats the last"
    return f"stamp of {name} {what}"

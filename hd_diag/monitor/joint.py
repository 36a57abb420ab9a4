"""One joint while it runs: samples checked, paired and predicted, what is known since the last report."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from hd_diag.arrays import Floats, Times
from hd_diag.drive import transmission_error
from hd_diag.extended_model import ExtendedModel
from hd_diag.model.torsion_map import TorsionMap
from hd_diag.monitor.residual_orders import ResidualOrders
from hd_diag.monitor.settings import JointConfig
from hd_diag.streams.alignment import REMEMBERED, Inputs, Outputs, Pairs, interpolated, pairs
from hd_diag.streams.columns import LARGEST_ANGLE, LARGEST_TORQUE

CLOCK_JUMP = 1_000_000_000
"""A stamp this far behind the last one is a clock set back, not a late sample [ns]."""

_NO_ROWS, _NO_VALUES = np.empty(0, np.int64), np.empty(0)


class Samples(NamedTuple):
    """Rows of a joint that belong together, all (n,): stamp [ns], input and output angle [rad], torque [N m].

    `speed` is that of the input as reported [rad/s].
    """

    stamp: Times
    input_angle: Floats | None
    output_angle: Floats | None
    torque: Floats | None
    speed: Floats | None = None


class Row(NamedTuple):
    """What one message tells of a joint: stamp [ns], angles [rad], torque [N m], speed of input [rad/s]."""

    stamp: int
    input_angle: float | None
    output_angle: float | None
    torque: float | None
    speed: float | None = None


class Asked(NamedTuple):
    """A moment at which a joint's error is to be predicted: stamp [ns], angles [rad], torque [N m].

    `paired` where the output angle arrived apart from the input, which had its prediction at its own stamp.
    """

    stamp: int
    input_angle: float
    torque: float
    output_angle: float | None
    speed: float | None = None
    paired: bool = False


class Prediction(NamedTuple):
    """Transmission error: stamp [ns], input angle [rad], torque [N m], predicted [rad], each (n,).

    `row` are the positions of the messages that gave it, among those taken together. Where an output angle is
    reported, also the measured error and its residual to the predicted [rad]. `paired` where the output angle
    arrived apart from the input, which had its prediction at its own stamp.
    """

    row: Times
    stamp: Times
    input_angle: Floats
    torque: Floats
    predicted: Floats
    measured: Floats | None = None
    residual: Floats | None = None
    paired: bool = False

    def part(self, rows: Times | slice) -> Prediction:
        """Some of the rows."""
        columns = [None if column is None else column[rows] for column in self[:-1]]
        return Prediction._make([*columns, self.paired])


class Part(NamedTuple):
    """Rows of a joint from messages of one shape: positions among all taken together (n,), and samples."""

    row: Times
    samples: Samples


class Plan(NamedTuple):
    """Rows of a joint that can be taken together.

    Attributes
    ----------
    inputs : Part or None
        Those with an input angle.
    torque_row, torque : ndarray
        Positions and values of all reported torques [N m].
    pairs : Pairs or None
        What becomes of output angles that came, or come, apart.
    output_stamp : int or None
        Stamp of the last that comes apart [ns].
    """

    inputs: Part | None
    torque_row: Times
    torque: Floats
    pairs: Pairs | None = None
    output_stamp: int | None = None


@dataclass
class Window:
    """What happened since the last report."""

    stamps: list[Times] = field(default_factory=list)
    residuals: list[Floats] = field(default_factory=list)
    torques: list[Floats] = field(default_factory=list)
    speeds: list[Floats] = field(default_factory=list)
    accepted: int = 0
    rejected: int = 0


class ModelRun:
    """An extended model along one stream of stamps.

    Parameters
    ----------
    model : ExtendedModel
    """

    def __init__(self, model: ExtendedModel) -> None:
        self._model = model
        self._state = model.start()
        self._first: int | None = None

    def __call__(
        self, rows: Samples, torque: Floats, temperature: float, table: TorsionMap | None
    ) -> tuple[Floats, Floats]:
        """Transmission error [rad] and speed of the input [rad/s] of the next rows, shape (n,) each.

        Row by row: array arithmetic may round differently with other lengths, and a replay has them.
        """
        assert rows.input_angle is not None
        self._first = int(rows.stamp[0]) if self._first is None else self._first
        time = (rows.stamp - self._first).astype(np.float64) * 1e-9
        heat = np.array([temperature])
        error, speed = np.empty(time.shape), np.empty(time.shape)
        for row in range(time.size):
            at = slice(row, row + 1)
            reported = None if rows.speed is None else rows.speed[at]
            error[at], self._state = self._model.step(
                self._state, time[at], rows.input_angle[at], reported, torque[at], heat, table
            )
            speed[row] = self._state.speed
        return error, speed


class JointMonitor:
    """State of one joint.

    Parameters
    ----------
    config : JointConfig
    """

    def __init__(self, config: JointConfig) -> None:
        self.config = config
        self.table: TorsionMap | None = None
        self.samples = 0
        self.rejected = 0
        self.last_rejection = ""
        self.missed = self.missed_lately = 0
        self.unjudged: list[Times] = []
        self.usual_step = 0.0
        self.unpaired = 0
        self.clock_jumps = 0
        self.last_received = -1
        self.last: tuple[float, float] | None = None
        self.temperature = float("nan")
        self.window = Window()
        self.orders = ResidualOrders()
        self._restart()

    def _restart(self) -> None:
        """Forget the stream: it begins anew."""
        self._input_stamp = -(2**62)
        self._output_stamp = -(2**62)
        self._inputs: deque[tuple[int, float]] = deque(maxlen=REMEMBERED)
        self._pending: deque[tuple[int, float, float]] = deque(maxlen=REMEMBERED)
        self._torque: float | None = None
        self._output_seen = False
        self._run_model()

    def _run_model(self) -> None:
        """Let the extended model begin anew; what is paired later has a stream of its own."""
        model = self.config.model
        self._runs = None if model is None else (ModelRun(model), ModelRun(model))

    def configure(self, config: JointConfig) -> None:
        """Use another configuration from the next sample on; its map follows through `table`."""
        if config.drive.mesh != self.config.drive.mesh:
            self.table = None
        before, self.config = self.config, config
        if (config.drive, config.model) != (before.drive, before.model):
            self.orders = ResidualOrders()
        if (config.input_joint, config.output_joint) != (before.input_joint, before.output_joint):
            self._restart()
        elif config.model != before.model:
            self._run_model()

    def select(self, names: tuple[str, ...]) -> tuple[int, int]:
        """Columns of input and output in a message with these names; -1 where it has none."""
        find = {name: column for column, name in enumerate(names)}
        return find.get(self.config.input_joint, -1), find.get(self.config.output_joint, -1)

    def clock_set_back(self, stamp: int) -> None:
        """Begin anew where the last stamp is later than one [ns]: the clock was set back."""
        if max(self._input_stamp, self._output_stamp) > stamp:
            self.clock_jumps += 1
            self._restart()

    def reject(self, reason: str, count: int = 1) -> None:
        """Count samples that cannot be used."""
        self.rejected += count
        self.window.rejected += count
        self.last_rejection = reason

    def _refuse(self, what: str, value: float, largest: float, unit: str) -> None:
        """Count a sample with a value that cannot be used."""
        self.reject(f"{what} is {value:g}" + (f" {unit}, beyond {largest:g}" if math.isfinite(value) else ""))

    def plan(self, parts: Sequence[Part]) -> Plan | None:
        """How rows of messages can be taken together.

        Parameters
        ----------
        parts : sequence of Part
            The joint's rows, a part for each shape of message.

        Returns
        -------
        Plan or None
            None where something has to be looked at message by message.
        """
        measured = self._measured(parts)
        if measured is None or not self._keeps_the_clock(measured):
            return None
        inputs = [part for part in measured if part.samples.input_angle is not None]
        apart = [p for p in measured if p.samples.input_angle is None and p.samples.output_angle is not None]
        together = any(part.samples.output_angle is not None for part in inputs)
        if not _alike(inputs) or (together and (apart or self._pending)):
            return None
        given, after = _joined(inputs), max(self._input_stamp, self._output_stamp if together else -(2**62))
        outputs = _joined([Part(row, rows._replace(speed=None)) for row, rows in apart])
        if not _rises(given, after) or not _rises(outputs, self._output_stamp):
            return None
        plan = Plan(given, *_torques(measured))
        return plan if outputs is None and not self._pending else self._pair_all(plan, outputs)

    def run(self, received: Times, plan: Plan) -> list[Prediction]:
        """Predictions that messages received at times [ns] make possible, as `accept` one by one."""
        found: list[Prediction] = []
        if plan.inputs is not None:
            row, rows = plan.inputs
            self.last_received = int(received[row[-1]])
            found.append(self._predict(row, rows, self._held(plan, row)))
            self._note_rows(rows)
        if plan.torque.size:
            self._torque = float(plan.torque[-1])
        if plan.output_stamp is not None:
            self._output_stamp = plan.output_stamp
        return found if plan.pairs is None else found + self._take_pairs(plan.pairs)

    def accept(self, received: int, row: Row) -> list[Asked]:
        """Moments that one more message lets be predicted; `note`, `note_residual` take what comes of each.

        Parameters
        ----------
        received : int
            When it arrived [ns].
        row : Row

        Returns
        -------
        list of Asked
            At the input's stamp; for output angles that arrive apart from the input, at theirs.
        """
        checked = self._check(row)
        if checked is None:
            return []
        stamp, angle, output, torque, speed = checked
        if torque is not None:
            self._torque = torque
        asked: list[Asked] = []
        if angle is not None:
            self.last_received = received
            self.last = angle, self._current_torque()
            asked.append(Asked(stamp, *self.last, output, speed))
            self._note_inputs(((stamp, angle),), 1, output is not None)
        elif output is not None:
            self._output_stamp = stamp
            self.unpaired += len(self._pending) == REMEMBERED
            self._pending.append((stamp, output, self._current_torque()))
        if self._pending:
            asked += self._pair()
        return asked

    def predict(self, rows: Samples, torque: Floats, paired: bool) -> Floats:
        """Transmission error of the joint's next rows [rad], shape (n,)."""
        assert rows.input_angle is not None
        if self._runs is None:
            return transmission_error(self.config.drive, rows.input_angle, torque, self.table)
        predicted, speed = self._runs[paired](rows, torque, self.temperature, self.table)
        self.window.torques.append(torque)
        self.window.speeds.append(speed)
        return predicted

    def note(self, stamp: Times, paired: bool) -> None:
        """Keep the stamps [ns] of rows that were predicted, for the next report."""
        if not paired:
            self.window.stamps.append(stamp)

    def note_residual(self, stamp: Times, angle: Floats, output: Floats, residual: Floats) -> None:
        """Keep what the output angles of rows said of their prediction [rad], shape (n,) each."""
        self.window.residuals.append(residual)
        self.orders.add(stamp, angle, output, residual)

    def _measured(self, parts: Sequence[Part]) -> list[Part] | None:
        """The parts less what the robot does not measure; None where some numbers are none.

        Broadcasters fill with nan what a robot does not measure: then it is not reported at all.
        """
        angles = [part.samples.input_angle for part in parts if part.samples.input_angle is not None]
        if not _within(angles, LARGEST_ANGLE):
            return None
        known = {
            "torque": (LARGEST_TORQUE, self._torque is not None),
            "output_angle": (LARGEST_ANGLE, self._output_seen or bool(self._pending)),
        }
        found = list(parts)
        for name, (largest, is_known) in known.items():
            values = [v for v in (getattr(part.samples, name) for part in found) if v is not None]
            if _within(values, largest):
                continue
            if is_known or not all(np.isnan(value).all() for value in values):
                return None
            absent: dict[str, Any] = {name: None}
            found = [Part(row, rows._replace(**absent)) for row, rows in found]
        return found

    def _keeps_the_clock(self, parts: Sequence[Part]) -> bool:
        """Whether no stamp is that of a clock set back."""
        _, stamp = _sorted([(part.row, part.samples.stamp) for part in parts])
        last = max(self._input_stamp, self._output_stamp)
        return bool((stamp >= np.maximum.accumulate(np.concatenate(([last], stamp)))[:-1] - CLOCK_JUMP).all())

    def _pair_all(self, plan: Plan, outputs: Part | None) -> Plan | None:
        """The plan with its pairs of input and output angles; None where too many would have to wait."""
        inputs, apart, last = _NO_INPUTS, _NO_OUTPUTS, None
        if plan.inputs is not None:
            row, rows = plan.inputs
            assert rows.input_angle is not None
            inputs = Inputs(row, rows.stamp, rows.input_angle)
        if outputs is not None:
            row, rows = outputs
            assert rows.output_angle is not None
            apart, last = (
                Outputs(row, rows.stamp, rows.output_angle, self._held(plan, row)),
                int(rows.stamp[-1]),
            )
        found = pairs(self._inputs, inputs, self._pending, apart)
        return None if found is None else plan._replace(pairs=found, output_stamp=last)

    def _take_pairs(self, found: Pairs) -> list[Prediction]:
        self.unpaired += found.unpaired
        self._output_seen = self._output_seen or bool(found.unpaired or found.input_angle.size)
        waiting = (column.tolist() for column in found.waiting[1:])
        self._pending = deque(zip(*waiting, strict=True), maxlen=REMEMBERED)
        if not found.input_angle.size:
            return []
        row, stamp, output, torque = found.found
        return [self._predict(row, Samples(stamp, found.input_angle, output, None), torque, paired=True)]

    def _check(self, row: Row) -> Row | None:
        """A message less what cannot be used; None if nothing is left. Counts what it refuses."""
        stamp, angle, output, torque, speed = row
        if stamp < max(self._input_stamp, self._output_stamp) - CLOCK_JUMP:
            self.clock_set_back(stamp)
        if angle is not None:
            if not abs(angle) <= LARGEST_ANGLE:
                self._refuse(f"input angle of {self.config.input_joint}", angle, LARGEST_ANGLE, "rad")
                return None
            if stamp <= self._input_stamp:
                self.reject(_stamp_reason(self.config.input_joint, stamp, self._input_stamp))
                return None
        elif output is not None and stamp <= self._output_stamp:
            self.reject(_stamp_reason(self.config.output_joint, stamp, self._output_stamp))
            return None
        if torque is not None and not abs(torque) <= LARGEST_TORQUE:
            # Broadcasters fill efforts that a robot does not measure with nan: then none is reported at all.
            if not math.isnan(torque) or self._torque is not None:
                self._refuse(f"effort of {self.config.output_joint}", torque, LARGEST_TORQUE, "N m")
                return None
            torque = None
        if output is not None and not abs(output) <= LARGEST_ANGLE:
            if not math.isnan(output) or self._output_seen:
                self._refuse(f"output angle of {self.config.output_joint}", output, LARGEST_ANGLE, "rad")
                return None
            output = None
        if angle is None and output is None and torque is None:
            return None
        return Row(stamp, angle, output, torque, speed)

    def _current_torque(self) -> float:
        return self.config.torque if self._torque is None else self._torque

    def _held(self, plan: Plan, row: Times) -> Floats:
        """Torque at messages: the last one reported up to there, else what holds before [N m]."""
        last = np.searchsorted(plan.torque_row, row, side="right") - 1
        return np.concatenate(([self._current_torque()], plan.torque))[last + 1]

    def _note_rows(self, rows: Samples) -> None:
        assert rows.input_angle is not None
        last = rows.stamp[-REMEMBERED:].tolist(), rows.input_angle[-REMEMBERED:].tolist()
        self._note_inputs(list(zip(*last, strict=True)), rows.stamp.size, rows.output_angle is not None)

    def _note_inputs(self, last: Sequence[tuple[int, float]], count: int, with_output: bool) -> None:
        """Keep the last of some inputs for outputs that come apart from them."""
        stamp = last[-1][0]
        if with_output:
            self._inputs.clear()
            self._inputs.append(last[-1])
            self._output_seen = True
            self._output_stamp = max(self._output_stamp, stamp)
        else:
            self._inputs.extend(last)
        self._input_stamp = stamp
        self.samples += count
        self.window.accepted += count

    def _predict(self, row: Times, rows: Samples, torque: Floats, paired: bool = False) -> Prediction:
        angle, output = rows.input_angle, rows.output_angle
        assert angle is not None
        predicted = self.predict(rows, torque, paired)
        measured = None if output is None else self.config.drive.frame.measured_error(angle, output)
        residual = None if measured is None else measured - predicted
        found = Prediction(row, rows.stamp, angle, torque, predicted, measured, residual, paired)
        if not paired:
            self.last = float(angle[-1]), float(torque[-1])
        self.note(rows.stamp, paired)
        if residual is not None:
            assert output is not None
            self.note_residual(rows.stamp, angle, output, residual)
        return found

    def _pair(self) -> Iterator[Asked]:
        """Output angles that waited, with the input angle interpolated to their stamps."""
        while self._pending and self._inputs and self._pending[0][0] <= self._inputs[-1][0]:
            stamp, output, torque = self._pending.popleft()
            self._output_seen = True
            angle = interpolated(self._inputs, stamp)
            if angle is None:
                self.unpaired += 1
            else:
                yield Asked(stamp, angle, torque, output, paired=True)


_NO_INPUTS = Inputs(_NO_ROWS, _NO_ROWS, _NO_VALUES)
_NO_OUTPUTS = Outputs(_NO_ROWS, _NO_ROWS, _NO_VALUES, _NO_VALUES)


def _within(columns: Sequence[Floats], largest: float) -> bool:
    """Whether all values are numbers of at most this magnitude."""
    return all((np.abs(values) <= largest).all() for values in columns)


def _alike(parts: Sequence[Part]) -> bool:
    """Whether all parts have the same columns, beside the torque."""
    return len({(p.samples.output_angle is None, p.samples.speed is None) for p in parts}) < 2


def _joined(parts: Sequence[Part]) -> Part | None:
    """Parts that are alike as one, in the order of the messages, without the torque; None of none."""
    if not parts:
        return None
    if len(parts) == 1:
        return Part(parts[0].row, parts[0].samples._replace(torque=None))
    row = np.concatenate([part.row for part in parts])
    order = np.argsort(row)
    columns = zip(*(part.samples._replace(torque=None) for part in parts), strict=True)
    joined: list[Any] = [None if column[0] is None else np.concatenate(column)[order] for column in columns]
    return Part(row[order], Samples(*joined))


def _torques(parts: Sequence[Part]) -> tuple[Times, Floats]:
    """Positions and values of all reported torques, in the order of the messages."""
    return _sorted([(row, rows.torque) for row, rows in parts if rows.torque is not None])


def _sorted(columns: list[tuple[Times, Any]]) -> tuple[Times, Any]:
    """Positions and values of several columns in the order of the positions."""
    if len(columns) < 2:
        return columns[0] if columns else (_NO_ROWS, _NO_VALUES)
    row, values = (np.concatenate(column) for column in zip(*columns, strict=True))
    order = np.argsort(row)
    return row[order], values[order]


def _rises(part: Part | None, after: int) -> bool:
    """Whether the stamps rise from one after the given on."""
    if part is None:
        return True
    stamp = part.samples.stamp
    return bool(stamp[0] > after and (np.diff(stamp) > 0).all())


def _stamp_reason(name: str, stamp: int, last: int) -> str:
    what = "repeats the last" if stamp == last else f"is {(last - stamp) / 1e9:.6f} s before the last"
    return f"stamp of {name} {what}"

"""One joint while it runs: samples checked, paired and predicted, what is known since the last report."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from hd_diag.config import JointConfig
from hd_diag.drive import transmission_error
from hd_diag.extended import ExtendedModel
from hd_diag.model.torsion_map import TorsionMap
from hd_diag.residual_orders import ResidualOrders
from hd_diag.samples import Floats, Times

CLOCK_JUMP = 1_000_000_000
"""A stamp this far behind the last one is a clock set back, not a late sample [ns]."""

# An output angle is compared with an input angle interpolated over at most this time [ns].
_PAIRING_GAP = 50_000_000
_REMEMBERED = 256  # input samples kept for output angles that arrive later


class Samples(NamedTuple):
    """Rows of a joint that belong together, all (n,): stamp [ns], input and output angle [rad], torque [N m].

    `speed` is that of the input as reported [rad/s].
    """

    stamp: Times
    input_angle: Floats | None
    output_angle: Floats | None
    torque: Floats | None
    speed: Floats | None = None


class Prediction(NamedTuple):
    """Transmission error: stamp [ns], input angle [rad], torque [N m], predicted [rad], each (n,).

    Where an output angle is reported, also the measured error and its residual to the predicted [rad].
    `paired` where the output angle arrived apart from the input, which had its prediction at its own stamp.
    """

    stamp: Times
    input_angle: Floats
    torque: Floats
    predicted: Floats
    measured: Floats | None = None
    residual: Floats | None = None
    paired: bool = False


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
        self.missed = 0
        self.unjudged: list[Times] = []
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
        self._inputs: deque[tuple[int, float]] = deque(maxlen=_REMEMBERED)
        self._pending: deque[tuple[int, float, float]] = deque(maxlen=_REMEMBERED)
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

    def reject(self, reason: str, count: int = 1) -> None:
        """Count samples that cannot be used."""
        self.rejected += count
        self.window.rejected += count
        self.last_rejection = reason

    def is_clean(self, rows: Samples) -> bool:
        """Whether several rows hold nothing that must be looked at one by one."""
        stamp = rows.stamp
        return bool(
            rows.input_angle is not None
            and not self._pending
            and stamp[0] > max(self._input_stamp, self._output_stamp)
            and (np.diff(stamp) > 0).all()
            and all(np.isfinite(values).all() for values in rows[1:4] if values is not None)
        )

    def accept(self, received: int, rows: Samples) -> list[Prediction]:
        """Predictions that new rows make possible.

        Parameters
        ----------
        received : int
            When the last of them arrived [ns].
        rows : Samples
            One row, or several for which `is_clean` holds.

        Returns
        -------
        list of Prediction
            At the input's stamps; for output angles that arrive apart from the input, at theirs.
        """
        if rows.stamp.size == 1:
            checked = self._check(rows)
            if checked is None:
                return []
            rows = checked
        both = rows.input_angle is not None and rows.output_angle is not None
        found: list[Prediction] = []
        if rows.input_angle is not None:
            self.last_received = received
            torque = self._hold(rows)
            found.append(self._predict(rows, torque))
            self._note_inputs(rows)
        elif rows.torque is not None:
            self._torque = float(rows.torque[-1])
        if rows.output_angle is not None and not both:
            self._output_stamp = rows.stamp.item()
            self.unpaired += len(self._pending) == _REMEMBERED
            self._pending.append((self._output_stamp, rows.output_angle.item(), self._current_torque()))
        return found + self._pair()

    def _check(self, rows: Samples) -> Samples | None:
        """A single row less what cannot be used; None if nothing is left. Counts what it refuses."""
        stamp = rows.stamp.item()
        if stamp < max(self._input_stamp, self._output_stamp) - CLOCK_JUMP:
            self.clock_jumps += 1
            self._restart()
        angle, output, torque = rows.input_angle, rows.output_angle, rows.torque
        if angle is not None:
            if not math.isfinite(angle.item()):
                self.reject(f"input angle of {self.config.input_joint} is {angle.item()}")
                return None
            if stamp <= self._input_stamp:
                self.reject(_stamp_reason(self.config.input_joint, stamp, self._input_stamp))
                return None
        elif output is not None and stamp <= self._output_stamp:
            self.reject(_stamp_reason(self.config.output_joint, stamp, self._output_stamp))
            return None
        if torque is not None and not math.isfinite(torque.item()):
            # Broadcasters fill efforts that a robot does not measure with nan: then none is reported at all.
            if math.isinf(torque.item()) or self._torque is not None:
                self.reject(f"effort of {self.config.output_joint} is {torque.item()}")
                return None
            torque = None
        if output is not None and not math.isfinite(output.item()):
            if math.isinf(output.item()) or self._output_seen:
                self.reject(f"output angle of {self.config.output_joint} is {output.item()}")
                return None
            output = None
        if angle is None and output is None and torque is None:
            return None
        return Samples(rows.stamp, angle, output, torque, rows.speed)

    def _current_torque(self) -> float:
        return self.config.torque if self._torque is None else self._torque

    def _hold(self, rows: Samples) -> Floats:
        """Torque of each row: as reported with it, else the last reported, else as configured [N m]."""
        if rows.torque is None:
            return np.full(rows.stamp.shape, self._current_torque())
        self._torque = float(rows.torque[-1])
        return rows.torque

    def _note_inputs(self, rows: Samples) -> None:
        assert rows.input_angle is not None
        stamp, angle = rows.stamp[-_REMEMBERED:], rows.input_angle[-_REMEMBERED:]
        if rows.output_angle is None:
            self._inputs.extend(zip(stamp.tolist(), angle.tolist(), strict=True))
        else:
            self._inputs.clear()
            self._inputs.append((int(stamp[-1]), float(angle[-1])))
            self._output_seen = True
            self._output_stamp = int(stamp[-1])
        self._input_stamp = int(stamp[-1])
        self.samples += rows.stamp.size
        self.window.accepted += rows.stamp.size
        self.window.stamps.append(rows.stamp)

    def _predict(self, rows: Samples, torque: Floats, paired: bool = False) -> Prediction:
        angle = rows.input_angle
        assert angle is not None
        if self._runs is None:
            predicted = transmission_error(self.config.drive, angle, torque, self.table)
        else:
            predicted, speed = self._runs[paired](rows, torque, self.temperature, self.table)
            self.window.torques.append(torque)
            self.window.speeds.append(speed)
        prediction = Prediction(rows.stamp, angle, torque, predicted, paired=paired)
        if not paired:
            self.last = float(angle[-1]), float(torque[-1])
        return prediction if rows.output_angle is None else self._compared(prediction, rows.output_angle)

    def _compared(self, prediction: Prediction, output: Floats) -> Prediction:
        """The prediction with what the output angle says of it."""
        measured = output - prediction.input_angle / self.config.drive.kinematics.ratio
        residual = measured - prediction.predicted
        self.window.residuals.append(residual)
        self.orders.add(prediction.stamp, prediction.input_angle, output, residual)
        return prediction._replace(measured=measured, residual=residual)

    def _pair(self) -> list[Prediction]:
        """Compare waiting output angles with the input angle interpolated to their stamps."""
        found = []
        while self._pending and self._inputs and self._pending[0][0] <= self._inputs[-1][0]:
            stamp, output, torque = self._pending.popleft()
            self._output_seen = True
            angle = _interpolated(self._inputs, stamp)
            if angle is None:
                self.unpaired += 1
                continue
            rows = Samples(np.array([stamp]), np.array([angle]), np.array([output]), None)
            found.append(self._predict(rows, np.array([torque]), paired=True))
        return found


def _interpolated(inputs: deque[tuple[int, float]], stamp: int) -> float | None:
    """Input angle at a stamp between two samples not too far apart; None outside."""
    later: tuple[int, float] | None = None
    for time, angle in reversed(inputs):
        if time == stamp:
            return angle
        if time < stamp:
            if later is None or later[0] - time > _PAIRING_GAP:
                return None
            return angle + (later[1] - angle) * ((stamp - time) / (later[0] - time))
        later = time, angle
    return None


def _stamp_reason(name: str, stamp: int, last: int) -> str:
    what = "repeats the last" if stamp == last else f"is {(last - stamp) / 1e9:.6f} s before the last"
    return f"stamp of {name} {what}"

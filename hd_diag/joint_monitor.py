"""One joint while it runs: samples checked, paired and predicted, what is known since the last report."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from hd_diag.config import JointConfig
from hd_diag.drive import transmission_error
from hd_diag.model.torsion_map import TorsionMap
from hd_diag.samples import Floats, Times

CLOCK_JUMP = 1_000_000_000
"""A stamp this far behind the last one is a clock set back, not a late sample [ns]."""

# An output angle is compared with an input angle interpolated over at most this time [ns].
_PAIRING_GAP = 50_000_000
_REMEMBERED = 256  # input samples kept for output angles that arrive later


class Samples(NamedTuple):
    """Rows of a joint that belong together: stamp [ns], input, output angle [rad], torque [N m], all (n,)."""

    stamp: Times
    input_angle: Floats | None
    output_angle: Floats | None
    torque: Floats | None


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
    accepted: int = 0
    rejected: int = 0


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
        self._restart()

    def _restart(self) -> None:
        """Forget the stream: it begins anew."""
        self._input_stamp = -(2**62)
        self._output_stamp = -(2**62)
        self._inputs: deque[tuple[int, float]] = deque(maxlen=_REMEMBERED)
        self._pending: deque[tuple[int, float, float]] = deque(maxlen=_REMEMBERED)
        self._torque: float | None = None
        self._output_seen = False

    def configure(self, config: JointConfig) -> None:
        """Use another configuration from the next sample on; its map follows through `table`."""
        if config.drive.mesh != self.config.drive.mesh:
            self.table = None
        if (config.input_joint, config.output_joint) != (self.config.input_joint, self.config.output_joint):
            self._restart()
        self.config = config

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
            and all(np.isfinite(values).all() for values in rows[1:] if values is not None)
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
            found.append(self._predict(rows.stamp, rows.input_angle, torque, rows.output_angle))
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
        return Samples(rows.stamp, angle, output, torque)

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

    def _predict(self, stamp: Times, angle: Floats, torque: Floats, output: Floats | None) -> Prediction:
        predicted = transmission_error(self.config.drive, angle, torque, self.table)
        self.last = float(angle[-1]), float(torque[-1])
        if output is None:
            return Prediction(stamp, angle, torque, predicted)
        return self._compared(Prediction(stamp, angle, torque, predicted), output)

    def _compared(self, prediction: Prediction, output: Floats, paired: bool = False) -> Prediction:
        """The prediction with what the output angle says of it."""
        measured = output - prediction.input_angle / self.config.drive.kinematics.ratio
        residual = measured - prediction.predicted
        self.window.residuals.append(residual)
        return Prediction(*prediction[:4], measured, residual, paired)

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
            angles, load = np.array([angle]), np.array([torque])
            predicted = transmission_error(self.config.drive, angles, load, self.table)
            prediction = Prediction(np.array([stamp]), angles, load, predicted)
            found.append(self._compared(prediction, np.array([output]), paired=True))
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

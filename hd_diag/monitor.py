"""All joints while they run: joint states in, transmission errors, per-tooth arrays and diagnostics out.

Nothing here reads a clock. What happens depends on the sequence of calls and their times alone, so a
recording of them gives the same results again: replay is this same code.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from hd_diag.config import Config
from hd_diag.drive import mesh_state
from hd_diag.health import report
from hd_diag.joint_monitor import JointMonitor, Prediction, Samples
from hd_diag.model.torsion_map import TorsionMap
from hd_diag.samples import Angles, Floats, JointStates, Publication, Report, Teeth, Times


class Monitor:
    """Monitor of all joints of a configuration.

    Parameters
    ----------
    config : Config
    """

    def __init__(self, config: Config) -> None:
        self.config = config
        self.joints = {joint.name: JointMonitor(joint) for joint in config.joints}
        self.foreign = 0
        self._slot = dict.fromkeys(self.joints, -(2**62))
        self._columns: dict[tuple[str, ...], list[tuple[str, int, int]]] = {}

    def configure(self, config: Config) -> None:
        """Use another configuration of the same joints from the next message on."""
        for joint in config.joints:
            self.joints[joint.name].configure(joint)
        self.config = config
        self._columns.clear()

    def use_map(self, joint: str, table: TorsionMap) -> bool:
        """Predict a joint by its map from the next message on; False if the map is of another mesh."""
        monitor = self.joints[joint]
        if table.mesh != monitor.config.drive.mesh:
            return False
        monitor.table = table
        return True

    def reject(self, reason: str) -> None:
        """Count a message that cannot be read."""
        for monitor in self.joints.values():
            monitor.reject(reason)

    def joint_states(self, received: Times, states: JointStates) -> list[Publication]:
        """What messages of one shape give.

        Parameters
        ----------
        received : ndarray of int64, shape (n,)
            When each arrived [ns].
        states : JointStates
            n >= 1 messages; one at a time or many at once gives the same, to the last bit.

        Returns
        -------
        list of Publication
        """
        selected = self._selected(states)
        if not selected:
            self.foreign += received.size
            return []
        rows = []
        for joint, *columns in selected:
            part = _samples(states, *columns)
            if part is None:
                self.joints[joint].reject(
                    "the message names the joint and gives no position of it", received.size
                )
            else:
                rows.append((joint, part))
        if received.size > 1 and not all(self.joints[joint].is_clean(part) for joint, part in rows):
            return self._one_by_one(received, states)
        results = {joint: self.joints[joint].accept(int(received[-1]), part) for joint, part in rows}
        return self._angles(received, results) + self._teeth(received, results)

    def temperature(self, joint: str, value: float) -> None:
        """Note a joint's temperature [degree Celsius]."""
        if np.isfinite(value):
            self.joints[joint].temperature = value
        else:
            self.joints[joint].reject(f"temperature is {value}")

    def tick(self, now: int, stamp: int, facts: Mapping[str, str]) -> Report:
        """Diagnostics of all joints.

        Parameters
        ----------
        now : int
            On the clock by which messages were received [ns].
        stamp : int
            For the message's header [ns].
        facts : mapping
            What the surroundings know: ``log_state``, ``latency_p99_us``.

        Returns
        -------
        Report
        """
        statuses = tuple(report(joint, now, facts, self.foreign) for joint in self.joints.values())
        return Report("/diagnostics", now, stamp, statuses)

    def _selected(self, states: JointStates) -> list[tuple[str, int, int]]:
        """Joints that these messages tell of, with the columns of their input and output."""
        found = self._columns.get(states.names)
        if found is None:
            every = [(name, *joint.select(states.names)) for name, joint in self.joints.items()]
            found = [entry for entry in every if entry[1] >= 0 or entry[2] >= 0]
            self._columns = {**self._columns, states.names: found} if len(self._columns) < 64 else {}
        return found

    def _one_by_one(self, received: Times, states: JointStates) -> list[Publication]:
        found: list[Publication] = []
        for row in range(received.size):
            at = slice(row, row + 1)
            found += self.joint_states(received[at], _rows(states, at))
        return found

    def _angles(self, received: Times, results: Mapping[str, list[Prediction]]) -> list[Publication]:
        """Messages of predictions; joints predicted at the same stamps share one."""
        shared: dict[tuple[bool, bytes], dict[str, Prediction]] = {}
        for joint, predictions in results.items():
            for prediction in predictions:
                shared.setdefault((prediction.paired, prediction.stamp.tobytes()), {})[joint] = prediction
        found: list[Publication] = []
        for joints in shared.values():
            found += _messages(received[-next(iter(joints.values())).stamp.size :], joints)
        return found

    def _teeth(self, received: Times, results: Mapping[str, list[Prediction]]) -> list[Publication]:
        """Per-tooth arrays where the array rate's next period has begun."""
        if self.config.array_rate <= 0.0:
            return []
        period = round(1e9 / self.config.array_rate)
        found: list[Publication] = []
        for joint, predictions in results.items():
            for prediction in [p for p in predictions if not p.paired]:
                slots = prediction.stamp // period
                due = slots != np.concatenate(([self._slot[joint]], slots[:-1]))
                self._slot[joint] = int(slots[-1])
                if due.any():
                    found += self._arrays(joint, received[-slots.size :][due], prediction, due)
        return found

    def _arrays(
        self, joint: str, received: Times, prediction: Prediction, due: npt.NDArray[np.bool_]
    ) -> list[Publication]:
        drive = self.joints[joint].config.drive
        torque = drive.kinematics.cup_torque(prediction.torque[due])
        state = mesh_state(drive, prediction.input_angle[due], torque)
        return [
            Teeth(f"~/{joint}/backlash", received, state.backlash),
            Teeth(f"~/{joint}/load", received, state.load),
        ]


def _samples(states: JointStates, input_column: int, output_column: int) -> Samples | None:
    """A joint's columns; None if the messages have neither of its angles nor its effort."""
    position, effort = states.position, states.effort
    angle = position[:, input_column] if position is not None and input_column >= 0 else None
    output = position[:, output_column] if position is not None and output_column >= 0 else None
    torque = effort[:, output_column] if effort is not None and output_column >= 0 else None
    if angle is None and output is None and torque is None:
        return None
    return Samples(states.stamp, angle, output, torque)


def _rows(states: JointStates, rows: slice) -> JointStates:
    values = [None if column is None else column[rows] for column in states[4:]]
    return JointStates(states.row[rows], states.stamp[rows], states.names, states.frame_id, *values)


def _messages(received: Times, joints: Mapping[str, Prediction]) -> list[Publication]:
    names = tuple(joints)
    first = next(iter(joints.values()))
    predicted = _columns([p.predicted for p in joints.values()])
    torque = _columns([p.torque for p in joints.values()])
    measured = {name: p.measured for name, p in joints.items() if p.measured is not None}
    found: list[Publication] = []
    if not first.paired:
        found.append(Angles("~/transmission_error", received, first.stamp, names, predicted, torque))
    if measured:
        values = _columns(list(measured.values()))
        residual = values - _columns([joints[name].predicted for name in measured])
        found.append(
            Angles("~/measured_transmission_error", received, first.stamp, tuple(measured), values, None)
        )
        found.append(Angles("~/residual", received, first.stamp, tuple(measured), residual, None))
    return found


def _columns(values: list[Floats]) -> Floats:
    return np.stack(values, axis=1)

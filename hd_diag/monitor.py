"""All joints while they run: joint states in, transmission errors, per-tooth arrays and diagnostics out.

Nothing here reads a clock. What happens depends on the sequence of calls and their times alone, so a
recording of them gives the same results again: replay is this same code.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hd_diag.config import Config
from hd_diag.drive import MeshState, mesh_state
from hd_diag.health import report
from hd_diag.joint_monitor import JointMonitor, Prediction, Samples
from hd_diag.model.torsion_map import TorsionMap
from hd_diag.samples import Angles, Drawings, Floats, JointStates, Publication, Report, Teeth, Times

_NO_ROWS = np.empty(0, np.int64)


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
        self._array_period = dict.fromkeys(self.joints, -(2**62))
        self._mesh_period = dict.fromkeys(self.joints, -(2**62))
        # Each joint's periods begin at another time, so that no message has to wait for the arrays of all.
        self._shift = {name: number / len(self.joints) for number, name in enumerate(self.joints)}
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
            return self._in_halves(received, states)
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

    def _in_halves(self, received: Times, states: JointStates) -> list[Publication]:
        """Rows with something in between that must be looked at alone."""
        middle = received.size // 2
        found: list[Publication] = []
        for at in (slice(0, middle), slice(middle, None)):
            found += self.joint_states(received[at], states.part(at))
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
        """Per-tooth arrays and drawings where a period of their rates has begun."""
        found: list[Publication] = []
        for joint, predictions in results.items():
            for prediction in predictions:
                if prediction.paired:
                    continue
                stamp, shift = prediction.stamp, self._shift[joint]
                rows = _due(self._array_period, joint, stamp, self.config.array_rate, shift)
                if rows.size:
                    found += self._arrays(joint, received[-stamp.size :][rows], prediction, rows)
                rows = _due(self._mesh_period, joint, stamp, self.config.mesh_rate, shift)
                if rows.size:
                    found.append(self._drawings(joint, received[-stamp.size :][rows], prediction, rows))
        return found

    def _arrays(self, joint: str, received: Times, prediction: Prediction, rows: Times) -> list[Publication]:
        state = self._state(joint, prediction, rows)
        return [
            Teeth(f"~/{joint}/backlash", received, state.backlash),
            Teeth(f"~/{joint}/load", received, state.load),
        ]

    def _drawings(self, joint: str, received: Times, prediction: Prediction, rows: Times) -> Drawings:
        state, config = self._state(joint, prediction, rows), self.joints[joint].config
        return Drawings(
            f"~/{joint}/mesh",
            received,
            prediction.stamp[rows],
            joint,
            config.drive,
            prediction.input_angle[rows],
            state.load,
            state.torsion,
            max(config.limits["peak_tooth_load"].error, 1e-9),
        )

    def _state(self, joint: str, prediction: Prediction, rows: Times) -> MeshState:
        drive = self.joints[joint].config.drive
        torque = drive.kinematics.cup_torque(prediction.torque[rows])
        return mesh_state(drive, prediction.input_angle[rows], torque)


def _due(last: dict[str, int], joint: str, stamp: Times, rate: float, shift: float) -> Times:
    """Rows of rising stamps [ns] at which a period of a rate [Hz] begins; keeps the joint's last period.

    Periods begin earlier by `shift` of their length.
    """
    if rate <= 0.0:
        return _NO_ROWS
    length = round(1e9 / rate)
    offset = round(shift * length)
    before, after = last[joint], (int(stamp[-1]) + offset) // length
    if before == (int(stamp[0]) + offset) // length == after:
        return _NO_ROWS
    last[joint] = after
    period = (stamp + offset) // length
    return np.flatnonzero(period != np.concatenate(([before], period[:-1])))


def _samples(states: JointStates, input_column: int, output_column: int) -> Samples | None:
    """A joint's columns; None if the messages have neither of its angles nor its effort."""
    position, velocity, effort = states[4:]
    angle = position[:, input_column] if position is not None and input_column >= 0 else None
    output = position[:, output_column] if position is not None and output_column >= 0 else None
    torque = effort[:, output_column] if effort is not None and output_column >= 0 else None
    speed = velocity[:, input_column] if velocity is not None and input_column >= 0 else None
    if angle is None and output is None and torque is None:
        return None
    return Samples(states.stamp, angle, output, torque, speed)


def _messages(received: Times, joints: Mapping[str, Prediction]) -> list[Publication]:
    predictions = list(joints.values())
    stamp, paired = predictions[0].stamp, predictions[0].paired
    found: list[Publication] = []
    if not paired:
        error, torque = (
            _columns([p.predicted for p in predictions]),
            _columns([p.torque for p in predictions]),
        )
        found.append(Angles("~/transmission_error", received, stamp, tuple(joints), error, torque))
    measured = [p.measured for p in predictions if p.measured is not None]
    if measured:
        names = tuple(name for name, p in joints.items() if p.measured is not None)
        residual = [p.residual for p in predictions if p.residual is not None]
        topics = {"~/measured_transmission_error": measured, "~/residual": residual}
        found += [Angles(topic, received, stamp, names, _columns(v), None) for topic, v in topics.items()]
    return found


def _columns(values: list[Floats]) -> Floats:
    """Columns (n,) side by side, shape (n, k)."""
    return np.concatenate(values).reshape(len(values), -1).T

"""All joints while they run: joint states in, transmission errors, per-tooth arrays and diagnostics out.

Nothing here reads a clock. What happens depends on the sequence of calls and their times alone, so a
recording of them gives the same results again: replay is this same code.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hd_diag.arrays import Floats, Times
from hd_diag.drive import MeshState, mesh_state
from hd_diag.model.torsion_map import TorsionMap
from hd_diag.monitor.health import report
from hd_diag.monitor.joint import Asked, JointMonitor, Part, Prediction, Row, Samples
from hd_diag.monitor.moment import Moments
from hd_diag.monitor.periods import Periods
from hd_diag.monitor.predictions import angles, angles_of_moment
from hd_diag.monitor.settings import MonitorConfig
from hd_diag.streams.columns import Drawings, JointStates, Publication, Report, Teeth

_NAMELESS = "the message names the joint and gives no position of it"


class Monitor:
    """Monitor of all joints of a configuration.

    Parameters
    ----------
    config : MonitorConfig
    """

    def __init__(self, config: MonitorConfig) -> None:
        self.config = config
        self.joints = {joint.name: JointMonitor(joint) for joint in config.joints}
        self.foreign = 0
        # Each joint's periods begin at another time, so that no message has to wait for the arrays of all.
        shift = {name: number / len(self.joints) for number, name in enumerate(self.joints)}
        self._array_periods = {name: Periods(shift[name]) for name in self.joints}
        self._mesh_periods = {name: Periods(shift[name]) for name in self.joints}
        self._moments = Moments()
        self._columns: dict[tuple[str, ...], list[tuple[str, int, int]]] = {}

    def configure(self, config: MonitorConfig) -> None:
        """Use another configuration of the same joints from the next message on."""
        for joint in config.joints:
            self.joints[joint.name].configure(joint)
        self.config = config
        self._columns.clear()
        self._moments = Moments()
        for periods in (*self._array_periods.values(), *self._mesh_periods.values()):
            periods.change()

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
        if received.size > 1:
            states = states._replace(row=np.arange(received.size))
        return self.mixed_states(received, (states,))

    def mixed_states(self, received: Times, shapes: Sequence[JointStates]) -> list[Publication]:
        """What messages of several shapes give.

        Parameters
        ----------
        received : ndarray of int64, shape (n,)
            When each arrived [ns].
        shapes : sequence of JointStates
            The messages of each shape; their `row` are positions in `received`.

        Returns
        -------
        list of Publication
        """
        if received.size == 1:
            return self._one(received, shapes[0])
        parts, nameless, foreign = self._parts(shapes)
        plans = {name: self.joints[name].plan(part) for name, part in parts.items()}
        if None in plans.values():
            return self._in_halves(received, shapes)
        self.foreign += foreign
        for joint, count in nameless:
            self.joints[joint].reject(_NAMELESS, count)
        results = {name: self.joints[name].run(received, plan) for name, plan in plans.items() if plan}
        found = angles(received, results)
        for name, predictions in results.items():
            for prediction in predictions:
                if not prediction.paired:
                    found += self._teeth(received, name, prediction)
        return found

    def _one(self, received: Times, states: JointStates) -> list[Publication]:
        """What one message gives: as fast as can be, for live each comes alone."""
        selected = self._selected(states)
        self.foreign += not selected
        now = int(received[0])
        joints: list[JointMonitor] = []
        asked: list[Asked] = []
        stamp, values = int(states.stamp[0]), tuple(map(_listed, states[4:]))
        for name, *columns in selected:
            joint, row = self.joints[name], _row(stamp, values, *columns)
            if row is None:
                joint.reject(_NAMELESS)
                continue
            for each in joint.accept(now, row):
                joints.append(joint)
                asked.append(each)
        if not asked:
            return []
        moment = self._moments(joints, asked)
        found = angles_of_moment(received, moment)
        for number, each in enumerate(asked):
            name = joints[number].config.name
            stamp, arrays, meshes = each.stamp, self._array_periods[name], self._mesh_periods[name]
            if each.paired or (arrays.within(stamp) and meshes.within(stamp)):
                continue
            found += self._teeth(received, name, moment.prediction(number))
        return found

    def clock_set_back(self, stamp: int) -> None:
        """Let joints whose last stamp is later than one [ns] begin anew: the clock was set back."""
        for joint in self.joints.values():
            joint.clock_set_back(stamp)

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

    def _parts(
        self, shapes: Sequence[JointStates]
    ) -> tuple[dict[str, list[Part]], list[tuple[str, int]], int]:
        """Rows of each joint; joints that are named without a position, how often; messages of no joint."""
        found: dict[str, list[Part]] = {}
        nameless, foreign = [], 0
        for states in shapes:
            selected = self._selected(states)
            foreign += 0 if selected else states.row.size
            for joint, *columns in selected:
                samples = _samples(states, *columns)
                if samples is None:
                    nameless.append((joint, states.row.size))
                else:
                    found.setdefault(joint, []).append(Part(states.row, samples))
        if len(shapes) > 1:
            found = {name: found[name] for name in self.joints if name in found}
        return found, nameless, foreign

    def _in_halves(self, received: Times, shapes: Sequence[JointStates]) -> list[Publication]:
        """Rows with something in between that must be looked at alone."""
        middle = received.size // 2
        found: list[Publication] = []
        for low, high in ((0, middle), (middle, received.size)):
            parts = [states.between(low, high) for states in shapes]
            found += self.mixed_states(received[low:high], [part for part in parts if part.row.size])
        return found

    def _teeth(self, received: Times, joint: str, prediction: Prediction) -> list[Publication]:
        """Per-tooth arrays and drawings where a period of their rates has begun."""
        found: list[Publication] = []
        rows = self._array_periods[joint].begun(prediction.stamp, self.config.array_rate)
        if rows.size:
            found += self._arrays(joint, received[prediction.row[rows]], prediction, rows)
        rows = self._mesh_periods[joint].begun(prediction.stamp, self.config.mesh_rate)
        if rows.size:
            found.append(self._drawings(joint, received[prediction.row[rows]], prediction, rows))
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
        torque = drive.frame.cup_torque(prediction.torque[rows])
        return mesh_state(drive, prediction.input_angle[rows], torque)


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


def _listed(column: Floats | None) -> list[float] | None:
    """The only row of a column."""
    return None if column is None else column[0].tolist()


def _row(
    stamp: int, values: tuple[list[float] | None, ...], input_column: int, output_column: int
) -> Row | None:
    """What `_samples` gives, of one message."""
    position, velocity, effort = values
    has_input, has_output = input_column >= 0, output_column >= 0
    angle = position[input_column] if position is not None and has_input else None
    output = position[output_column] if position is not None and has_output else None
    torque = effort[output_column] if effort is not None and has_output else None
    if angle is None and output is None and torque is None:
        return None
    return Row(
        stamp, angle, output, torque, velocity[input_column] if velocity is not None and has_input else None
    )

"""Monitor of all joints: joint states in, transmission errors, per-tooth arrays and diagnostics out.

Nothing here reads a clock. The results depend on the sequence of calls and their times alone, so a recording
of these gives the same results again. A replay runs this same code.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from hd_diag.arrays import Floats, Times
from hd_diag.drive import mesh_state
from hd_diag.model.torsion_map import TorsionMap
from hd_diag.monitor.comparison import Comparison, Errors
from hd_diag.monitor.health import status
from hd_diag.monitor.joint import Joint, Window
from hd_diag.monitor.publications import Drawings, Publication, Report, Stamps, ToothArrays, angles
from hd_diag.monitor.settings import MonitorConfig
from hd_diag.streams.alignment import Aligned, Alignment, kernel
from hd_diag.streams.columns import LARGEST_TEMPERATURE, JointStates

# Joints with per-tooth arrays at the same time. With seven joints at 1 kHz this saves a sixth of all work and
# delays messages hardly more than one joint does. All seven together delay them for half as long again.
_TOGETHER = 4
_NEVER = -(2**62)  # number of a period
# Samples added to the residual's orders at once, since the next report may be far: half a millisecond of
# work, 0.2 us each; with 256 samples each takes 0.5 us.
_FOLLOWED = 2048


class Monitor:
    """Monitor of all joints of a configuration; publishes a `share` of per-tooth arrays and drawings."""

    def __init__(self, config: MonitorConfig) -> None:
        self.config = config
        self.streams = Alignment([joint.names for joint in config.joints])
        self.joints = {
            joint.name: Joint(joint, self.streams, number) for number, joint in enumerate(config.joints)
        }
        self.share = 1.0
        self.periods = np.full((2, len(self.joints)), _NEVER)
        self._names = tuple(self.joints)
        self._comparison = Comparison()
        self._set_in_force()

    def configure(self, config: MonitorConfig) -> None:
        """Use another configuration of the same joints from the next message on."""
        self._follow()
        for joint in config.joints:
            self.joints[joint.name].configure(joint)
        self.config = config
        self._set_in_force()

    @property
    def has_arrays(self) -> bool:
        """Whether per-tooth arrays or drawings are published."""
        return bool(self._periods)

    def pace(self, share: float) -> None:
        """Publish a share of the per-tooth arrays and drawings from the next message on."""
        self.share = share
        self._set_in_force()

    def use_map(self, joint: str, table: TorsionMap) -> bool:
        """Predict a joint by its map from the next message on; False if the map is of another mesh."""
        known = self.joints[joint]
        if table.mesh != known.config.drive.mesh:
            return False
        known.table = table
        self._comparison.use([*self.joints.values()])
        return True

    def reject(self, reason: str) -> None:
        """Count a message that cannot be read as a rejected sample of every joint."""
        for number in range(len(self.joints)):
            self.streams.reject(number, reason)

    def mixed_states(
        self,
        received: Times,
        shapes: Sequence[JointStates],
        refused: Sequence[tuple[int, str]] = (),
        heard: Times | None = None,
    ) -> list[Publication]:
        """Take messages of several layouts and return the publications.

        `received` are their times of arrival (n,) [ns]. The rows of `shapes`, and of `refused` messages that
        cannot be read (row, reason), are positions in it. `heard` are the times of arrival by the clock that
        measures silence (n,) [ns], by default the same. One message at a time or many at once give the same
        result, to the last bit.
        """
        return self.publications(received, self.errors(received if heard is None else heard, shapes, refused))

    def errors(
        self, heard: Times, shapes: Sequence[JointStates], refused: Sequence[tuple[int, str]] = ()
    ) -> Errors:
        """Take messages as `mixed_states` does and return errors, which `publications` turns into messages.

        A report may come in between, because publishing many samples together costs less.
        """
        samples = self.streams.take(heard, shapes, refused)
        if not samples.row.size:
            return Errors(samples, *np.empty((3, 0)))
        errors = self._comparison.errors(samples, *self._by_models(samples))
        if self._comparison.count - self._comparison.followed >= _FOLLOWED:
            self._follow()
        return errors

    def publications(self, received: Times, errors: Errors) -> list[Publication]:
        """Publications of errors, whose rows are positions in `received` (n,) [ns]."""
        if not errors.predicted.size:
            return []
        return [*angles(received, errors, self._names), *self._teeth(received, errors.samples)]

    def clock_set_back(self, stamp: int) -> None:
        """Restart the streams of joints with a last stamp after `stamp` [ns]: the clock was set back."""
        self.streams.clock_set_back(stamp)

    def temperature(self, joint: str, value: float) -> None:
        """Note a joint's temperature [degree Celsius]."""
        if abs(value) <= LARGEST_TEMPERATURE:
            self.joints[joint].temperature = value
        else:
            self.joints[joint].reject(f"temperature is {value}")

    def silence(self, now: int) -> dict[str, float]:
        """Time since each joint's last input, by the clock of `heard` [s].

        For a joint without any input the time counts from the first call.
        """
        heard = self.streams.joints["heard"]
        heard[heard < 0] = now
        return dict(zip(self._names, np.maximum(0.0, (now - heard) * 1e-9).tolist(), strict=True))

    def tick(
        self, now: int, stamp: int, facts: Mapping[str, str], silence: Mapping[str, float] | None = None
    ) -> Report:
        """Diagnostics of all joints since the last report; `now` is its time, `stamp` its header stamp [ns].

        `facts` come from the caller, such as ``log_state``. `silence` is the time since each joint's last
        input by a clock of the caller [s]; None takes the time of the report.
        """
        silent = self.silence(now) if silence is None else silence
        pairs = zip(self.joints.values(), self._windows(), strict=True)
        streams = self.streams
        statuses = [status(j, own, silent.get(j.config.name, math.nan), facts, streams) for j, own in pairs]
        return Report("/diagnostics", now, stamp, tuple(statuses), facts, silent)

    def begin_window(self) -> None:
        """Drop the samples kept for the next report."""
        self._windows()

    def _windows(self) -> list[Window]:
        """Window of each joint since the last report."""
        self._follow()
        kept = self._comparison.kept
        joints = enumerate(self.joints.values())  # compress is four times as fast as a mask for records
        windows = [joint.window(kept.compress(kept["joint"] == n)) for n, joint in joints]
        self._comparison.count = self._comparison.followed = 0
        self.streams.turn()
        return windows

    def _follow(self) -> None:
        """Add the new samples to the residuals' orders."""
        new = self._comparison.kept[self._comparison.followed :]
        self._comparison.followed = self._comparison.count
        for number, joint in enumerate(self.joints.values()):
            joint.orders.add(new, number)

    def _set_in_force(self) -> None:
        self._comparison.use([*self.joints.values()])
        rates = self.config.array_rate, self.config.mesh_rate
        self._periods = []
        for rate, last, is_drawn in zip(rates, self.periods, (False, True), strict=True):
            if rate > 0.0:
                period = round(1e9 / (rate * self.share))
                # Periods of a few joints begin together, which costs less; all at once would delay messages.
                groups = -(-last.size // _TOGETHER)
                offset = period * (np.arange(last.size) // _TOGETHER) // groups
                self._periods.append((period, offset, last, is_drawn))

    def _by_models(self, samples: Aligned) -> list[Floats]:
        """Predicted errors [rad] and speeds [rad/s] (m,) if some joints have extended models, else none."""
        modelled = [(number, joint) for number, joint in enumerate(self.joints.values()) if joint.runs]
        if not modelled:
            return []
        predicted, speed = np.full(samples.row.size, np.nan), samples.speed.copy()
        for number, joint in modelled:
            rows = np.flatnonzero(samples.joint == number)
            predicted[rows], speed[rows] = joint.predict(samples.part(rows))
        return [predicted, speed]

    def _teeth(self, received: Times, samples: Aligned) -> Iterator[Publication]:
        """Per-tooth arrays and drawings for samples that begin a period of their rates."""
        for period, offset, last, is_drawn in self._periods:
            rows = kernel().begun(samples.stamp, samples.joint, samples.paired, period, offset, last)
            for number in np.unique(samples.joint[rows]).tolist() if rows.size else ():
                joint = self.config.joints[number]
                own = samples.part(rows[samples.joint[rows] == number])
                at, drive, topic = received[own.row], joint.drive, f"~/{joint.name}"
                state = mesh_state(drive, own.input_angle, drive.frame.cup_torque(own.torque))
                if is_drawn:
                    full = max(joint.limits["peak_tooth_load"].error, 1e-9)
                    shown = own.input_angle, state.section_load, state.torsion, full
                    yield Drawings(f"{topic}/mesh", at, own.stamp, joint.name, drive, *shown)
                else:
                    yield Stamps(f"{topic}/stamp", at, own.stamp, joint.name)
                    yield ToothArrays(f"{topic}/backlash", at, state.backlash)
                    yield ToothArrays(f"{topic}/load", at, state.load)


def warm_up(config: MonitorConfig) -> None:
    """Compile all that the first message needs, or read it from the disk."""
    monitor, time = Monitor(config), np.zeros(1, np.int64)
    names = [(joint.input_joint, joint.output_joint) for joint in config.joints]
    nothing = np.zeros((1, 2 * len(names)))
    flat = tuple(name for pair in names for name in pair)
    keys = tuple(name for joint in config.joints for name in joint.mapped)
    signals = np.zeros((1, len(keys))) if keys else None
    states = JointStates(time, time, flat, "", nothing, nothing, nothing, signals, keys)
    monitor.mixed_states(time, (states,))
    monitor.tick(0, 0, {})

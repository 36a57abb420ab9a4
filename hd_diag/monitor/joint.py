"""One joint while it runs: its configuration and map, what is known of its sender and of its residual."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hd_diag.arrays import Floats, Times
from hd_diag.model.torsion_map import TorsionMap
from hd_diag.monitor.lost_samples import LostSamples
from hd_diag.monitor.model_run import ModelRun
from hd_diag.monitor.publications import Errors
from hd_diag.monitor.residual_orders import ResidualOrders
from hd_diag.monitor.settings import JointConfig
from hd_diag.streams.alignment import Aligned, Alignment, Names

_NO_TIMES, _NO_VALUES = np.empty(0, np.int64), np.empty(0)


class Window(NamedTuple):
    """What happened to a joint since the last report.

    Attributes
    ----------
    stamps : ndarray of int64
        Of the inputs [ns].
    residual : ndarray
        Where an output angle was reported [rad].
    torque, speed : ndarray
        Of all samples that a model predicted [N m], [rad/s].
    accepted, rejected : int
    """

    stamps: Times
    residual: Floats
    torque: Floats
    speed: Floats
    accepted: int
    rejected: int


class Joint:
    """State of one joint.

    Parameters
    ----------
    config : JointConfig
    streams : Alignment
        Of all joints.
    number : int
        Of this joint.

    Attributes
    ----------
    table : TorsionMap or None
        Map in force.
    temperature : float
        Last reported [degree Celsius].
    lost : LostSamples
    orders : ResidualOrders
    runs : tuple of ModelRun, or empty
        Of the inputs, and of outputs that come apart.
    """

    def __init__(self, config: JointConfig, streams: Alignment, number: int) -> None:
        self.config = config
        self.table: TorsionMap | None = None
        self.temperature = math.nan
        self.lost = LostSamples()
        self.orders = ResidualOrders()
        self.runs: tuple[ModelRun, ...] = ()
        self._streams, self._number = streams, number
        self.begin_model()
        self.begin_window()

    @property
    def samples(self) -> int:
        """Input angles taken so far."""
        return int(self._streams.joints["samples"][self._number])

    @property
    def rejected(self) -> int:
        """Samples that could not be used."""
        return int(self._streams.joints["rejected"][self._number])

    @property
    def unpaired(self) -> int:
        """Output angles without an input at their stamp."""
        return int(self._streams.joints["unpaired"][self._number])

    @property
    def clock_jumps(self) -> int:
        """How often the clock of the stamps was set back."""
        return int(self._streams.joints["clock_jumps"][self._number])

    @property
    def last_rejection(self) -> str:
        """Why the last sample that could not be used was refused."""
        return self._streams.last_rejection(self._number)

    @property
    def last(self) -> tuple[float, float] | None:
        """Input angle [rad] and torque [N m] of the last sample; None before the first."""
        joint = self._streams.joints[self._number]
        return (float(joint["angle"]), float(joint["load"])) if self.samples else None

    def reject(self, reason: str) -> None:
        """Count a sample that cannot be used."""
        self._streams.reject(self._number, reason)

    def configure(self, config: JointConfig) -> None:
        """Use another configuration from the next sample on; its map follows through `table`."""
        if config.drive.mesh != self.config.drive.mesh:
            self.table = None
        before, self.config = self.config, config
        if (config.drive, config.model) != (before.drive, before.model):
            self.orders = ResidualOrders()
        if config.model != before.model:
            self.begin_model()
        self._streams.configure(self._number, names_of(config))

    def begin_model(self) -> None:
        """Let the extended model begin anew; what is paired later has a stream of its own."""
        model = self.config.model
        self.runs = () if model is None else (ModelRun(model), ModelRun(model))

    def note(self, errors: Errors) -> None:
        """Keep further samples of the joint for the next report."""
        pairs = errors.part(np.isfinite(errors.samples.output_angle))
        columns = pairs.samples.stamp, pairs.samples.input_angle, pairs.samples.output_angle
        self.orders.add(*columns, pairs.residual)
        self._parts.append(errors)

    def judge(self) -> None:
        """Count what was lost of the samples since the last report; once before it."""
        window = self.window
        self.lost.judge(window.stamps, window.rejected)

    def begin_window(self) -> None:
        """From now on it is counted for the next report."""
        self._parts: list[Errors] = []
        self._samples_before, self._rejected_before = self.samples, self.rejected

    @property
    def window(self) -> Window:
        """What happened since the last report."""
        counts = self.samples - self._samples_before, self.rejected - self._rejected_before
        if not self._parts:
            return Window(_NO_TIMES, _NO_VALUES, _NO_VALUES, _NO_VALUES, *counts)
        every = Errors.joined(self._parts)
        modelled = np.isfinite(every.speed)
        return Window(
            every.samples.stamp[every.samples.paired == 0],
            every.residual[np.isfinite(every.samples.output_angle)],
            every.samples.torque[modelled],
            every.speed[modelled],
            *counts,
        )

    def predict(self, samples: Aligned) -> tuple[Floats, Floats]:
        """Transmission error [rad] and speed [rad/s] that the joint's model gives for its next samples."""
        error, speed = np.empty(samples.stamp.size), np.empty(samples.stamp.size)
        for paired, run in enumerate(self.runs):
            rows = np.flatnonzero(samples.paired == paired)
            if rows.size:
                error[rows], speed[rows] = run(samples.part(rows), self.temperature, self.table)
        return error, speed


def names_of(config: JointConfig) -> Names:
    """What the alignment of streams must know of a joint."""
    return Names(config.input_joint, config.output_joint, config.torque)

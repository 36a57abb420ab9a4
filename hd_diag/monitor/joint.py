"""One joint while it runs: its configuration and map, what is known of its sender and of its residual."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from hd_diag.arrays import Floats, Times
from hd_diag.model.torsion_map import TorsionMap
from hd_diag.monitor.model_run import ModelRun
from hd_diag.monitor.residual_orders import ResidualOrders
from hd_diag.monitor.settings import JointConfig
from hd_diag.streams.alignment import Aligned, Alignment

_JUDGED_AT_LEAST = 8  # stamps, for their usual step


class Window(NamedTuple):
    """What happened to a joint since the last report.

    Stamps of the inputs [ns]; residuals where an output angle was reported [rad]; torques [N m] and speeds
    [rad/s] of all samples that a model predicted; how many samples were accepted and rejected.
    """

    stamps: Times
    residual: Floats
    torque: Floats
    speed: Floats
    accepted: int
    rejected: int


class LostSamples:
    """Count of a joint's lost samples: jitter adds and takes away steps, a loss only adds.

    `usual_step` is the period of the sender [ns]; 0 while it is not known.
    """

    def __init__(self) -> None:
        self.count = self.lately = 0
        self.usual_step = 0.0
        self.unjudged: Times = np.empty(0, np.int64)

    def judge(self, stamps: Times, rejected: int) -> None:
        """Count what is missing among further samples, by their stamps (n,) [ns].

        They are judged from the last stamp before on, and once there are enough of them. What a sender makes
        up for after a call was not lost: it is taken back. Neither is what came and was `rejected`.
        """
        self.unjudged = np.concatenate((self.unjudged, stamps))
        if self.unjudged.size < _JUDGED_AT_LEAST:
            return
        from hd_diag.monitor.kernel import lost  # late: it imports numba

        self.usual_step, missing, net, short = lost(self.unjudged, self.usual_step)
        self.unjudged = self.unjudged[-1:]
        if self.usual_step > 0.0:
            count = max(0, int(min(missing, net)) - rejected)
            self.count += count - min(self.lately, max(0, -int(net)), short)
            self.lately = count


class Joint:
    """State of one joint, by its number in the alignment of all.

    `table` is the map in force, `temperature` the last reported [degree Celsius], `runs` are those of its
    model, of the inputs and of outputs that come apart; empty without one.
    """

    def __init__(self, config: JointConfig, streams: Alignment, number: int) -> None:
        self.config = config
        self.table: TorsionMap | None = None
        self.temperature = math.nan
        self.lost = LostSamples()
        self.orders = ResidualOrders()
        self.runs: tuple[ModelRun, ...] = ()
        self._streams, self._number = streams, number
        self._reported = self.state.copy()
        self._begin_model()

    @property
    def state(self) -> Any:
        """What the streams know of it: a record of `JOINT`."""
        return self._streams.joints[self._number]

    @property
    def samples(self) -> int:
        """Input angles taken so far."""
        return int(self.state["samples"])

    @property
    def rejected(self) -> int:
        """Samples that could not be used."""
        return int(self.state["rejected"])

    @property
    def last_rejection(self) -> str:
        """Why the last sample that could not be used was refused."""
        return self._streams.last_rejection(self._number)

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
            self._begin_model()
        self._streams.configure(self._number, config.names)

    def _begin_model(self) -> None:
        model = self.config.model
        self.runs = () if model is None else (ModelRun(model), ModelRun(model))

    def window(self, kept: Any) -> Window:
        """What happened since the last report, of the joint's samples since then, as `Comparison.kept`."""
        before, self._reported = self._reported, self.state.copy()
        accepted, rejected = (int(self._reported[n] - before[n]) for n in ("samples", "rejected"))
        stamps, is_modelled = kept["stamp"][kept["paired"] == 0], np.isfinite(kept["speed"])
        self.lost.judge(stamps, rejected)
        residual = kept["residual"][np.isfinite(kept["output_angle"])]
        return Window(
            stamps, residual, kept["torque"][is_modelled], kept["speed"][is_modelled], accepted, rejected
        )

    def predict(self, samples: Aligned) -> tuple[Floats, Floats]:
        """Transmission error [rad] and speed [rad/s] that the joint's model gives for its next samples."""
        error, speed = np.empty(samples.stamp.size), np.empty(samples.stamp.size)
        for paired, run in enumerate(self.runs):
            rows = np.flatnonzero(samples.paired == paired)
            if rows.size:
                error[rows], speed[rows] = run(samples.part(rows), self.temperature, self.table)
        return error, speed

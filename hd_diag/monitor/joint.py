"""One joint while it runs: its configuration and map, what is known of its sender and of its residual."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from hd_diag.arrays import Floats, Integers, Times
from hd_diag.model.torsion_map import TorsionMap
from hd_diag.monitor.lost_samples import LostSamples
from hd_diag.monitor.model_run import ModelRun
from hd_diag.monitor.residual_orders import Order, ResidualOrders
from hd_diag.monitor.settings import JointConfig
from hd_diag.streams.alignment import Aligned, Alignment

_TOTALS = ("angle", "load", "samples", "rejected", "unpaired", "clock_jumps")


class Window(NamedTuple):
    """What happened to a joint between two reports, and how the second found it.

    Stamps of the inputs [ns]; residuals where an output angle was reported [rad]; torques [N m] and speeds
    [rad/s] of all samples that a model predicted; how many were accepted and rejected; input angle [rad] and
    torque [N m] of the last sample, None before the first; counts since the beginning; orders of the
    residual, those that the motion shows.
    """

    stamps: Times
    residual: Floats
    torque: Floats
    speed: Floats
    accepted: int
    rejected: int
    last: tuple[float, float] | None
    samples: int
    all_rejected: int
    unpaired: int
    clock_jumps: int
    missed: int
    orders: Sequence[Order]


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
        self.begin_model()

    @property
    def samples(self) -> int:
        """Input angles taken so far."""
        return int(self._streams.joints["samples"][self._number])

    @property
    def rejected(self) -> int:
        """Samples that could not be used."""
        return int(self._streams.joints["rejected"][self._number])

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
            self.begin_model()
        self._streams.configure(self._number, config.names)

    def begin_model(self) -> None:
        """Let the extended model begin anew; what is paired later has a stream of its own."""
        model = self.config.model
        self.runs = () if model is None else (ModelRun(model), ModelRun(model))

    def windows(
        self, kept: Any, ends: Integers, known: Any, orders: Sequence[Sequence[Order]]
    ) -> list[Window]:
        """What happened between reports, of all samples since the one before them, as `Comparison.kept`.

        `ends` (l,) are how many of these came before each report, `known` (l + 1,) what was known of the
        joint at the report before and at each, `orders` (l) those of the residual then.
        """
        is_modelled = np.isfinite(kept["speed"])
        parts = zip(
            _pieces(kept["stamp"], kept["paired"] == 0, ends),
            _pieces(kept["residual"], np.isfinite(kept["output_angle"]), ends),
            _pieces(kept["torque"], is_modelled, ends),
            _pieces(kept["speed"], is_modelled, ends),
            np.diff(known["samples"]).tolist(),
            np.diff(known["rejected"]).tolist(),
            strict=True,
        )
        totals = zip(*(known[name][1:].tolist() for name in _TOTALS), strict=True)
        found = []
        for part, (angle, load, *total), own in zip(parts, totals, orders, strict=True):
            self.lost.judge(part[0], part[-1])
            last = (angle, load) if total[0] else None
            found.append(Window._make((*part, last, *total, self.lost.count, own)))
        return found

    def predict(self, samples: Aligned) -> tuple[Floats, Floats]:
        """Transmission error [rad] and speed [rad/s] that the joint's model gives for its next samples."""
        error, speed = np.empty(samples.stamp.size), np.empty(samples.stamp.size)
        for paired, run in enumerate(self.runs):
            rows = np.flatnonzero(samples.paired == paired)
            if rows.size:
                error[rows], speed[rows] = run(samples.part(rows), self.temperature, self.table)
        return error, speed


def _pieces(values: Any, chosen: Any, ends: Integers) -> list[Any]:
    """The chosen values between ends."""
    rows = np.flatnonzero(chosen)
    bounds = rows.searchsorted(ends).tolist()
    kept = values[rows]
    return [kept[first:last] for first, last in zip([0, *bounds], bounds, strict=False)]

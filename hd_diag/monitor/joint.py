"""One joint while it runs: its configuration and map, its lost samples and the orders of its residual."""

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
from hd_diag.streams.no_torque import no_torque
from hd_diag.streams.rules import CLOCK_JUMP
from hd_diag.streams.second_publisher import other_rows

_JUDGED_AT_LEAST = 8  # least stamps from which their usual step is estimated
_STEPS_TOGETHER = 32
_KEPT = 0.02  # relative spread of the steps of a periodic sender [-]
_OFF_MULTIPLE = 0.25  # allowed difference of a step from whole periods [-]
_TURN = 2.0 * math.pi + 1e-6  # greatest range of an encoder that wraps [rad]
_SAME = 0.9  # share of equal steps from which the period has changed
_SHORT = 0.5  # share of a period below which a step makes up for a delay
_IN_BURSTS = 8.0  # mean over usual step that means bursts: a reader loses less than 7 of 8


class Window(NamedTuple):
    """Samples of a joint since the last report.

    `stamps` of the inputs [ns]; `residual` of samples with an output angle [rad]; `torque` [N m] and `speed`
    [rad/s] of samples with a known speed; numbers of `accepted` and `rejected` samples; `others` is a text on
    samples of a second publisher, or empty.
    """

    stamps: Times
    residual: Floats
    torque: Floats
    speed: Floats
    accepted: int
    rejected: int
    others: str


class LostSamples:
    """Count of a joint's lost samples: jitter makes steps longer and shorter, a loss only longer.

    `usual_step` is the period of the sender [ns], 0 while it is unknown.
    """

    def __init__(self) -> None:
        self.count = self.lately = 0
        self.usual_step = 0.0
        self.unjudged: Times = np.empty(0, np.int64)

    def judge(self, stamps: Times, rejected: int) -> None:
        """Count the samples that are missing between further stamps (n,) [ns], once there are enough.

        If a delayed sender sends samples after the next call, these were not lost and their count is taken
        back. Samples that came and were `rejected` are not counted.
        """
        self.unjudged = np.concatenate((self.unjudged, stamps))
        if self.unjudged.size < _JUDGED_AT_LEAST:
            return
        steps = np.diff(self.unjudged).astype(np.float64)
        steps = steps[(steps > 0.0) & (steps < CLOCK_JUMP)]  # without clock changes and pauses
        self.unjudged = self.unjudged[-1:]
        self.usual_step = usual = _known_step(steps, self.usual_step) or _usual_step(steps)
        if usual > 0.0:
            # Limited by the long steps and by the whole time, since short steps make up for some.
            missing = np.sum(np.rint(steps[steps > 1.5 * usual] / usual) - 1.0)
            net = int(np.rint(np.sum(steps) / usual)) - steps.size
            count = max(0, min(int(missing), net) - rejected)
            self.count += count - min(self.lately, max(0, -net), int(np.sum(steps < _SHORT * usual)))
            self.lately = count


def _known_step(steps: Floats, known: float) -> float:
    """The known period [ns] if it still holds despite losses or bursts; else 0.

    A reader that falls behind may lose most samples: nearly all steps are then multiples of the period, and
    not all equal. A sender that is held up sends bursts: most steps are then short, with the same mean.
    """
    in_bursts = 2 * np.sum(steps < _SHORT * known) > steps.size
    if known > 0.0 and in_bursts and float(np.mean(steps)) > _SHORT * known:
        return known
    if known <= 0.0 or 2 * np.sum(steps > 1.5 * known) <= steps.size:
        return 0.0
    multiples = np.rint(steps / known)
    most = np.unique(multiples, return_counts=True)[1].max()
    whole = np.sum(np.abs(steps / known - multiples) < _OFF_MULTIPLE)
    return known if most < _SAME * steps.size and whole > _SAME * steps.size else 0.0


def _usual_step(steps: Floats) -> float:
    """Period of a sender [ns], over several steps, because a sender makes up for delays by short steps."""
    if not steps.size:
        return 0.0
    span = max(1, min(_STEPS_TOGETHER, steps.size // 2))
    time = np.append(0.0, np.cumsum(steps))
    usual = _median(time[span:] - time[:-span]) / span
    # With many losses most spans have one; a sender that keeps its period shows it in single steps.
    single = _median(steps)
    is_kept = np.sum(np.abs(steps - single) < _KEPT * single) > 0.5 * steps.size
    mean = float(np.mean(steps))
    if mean > _IN_BURSTS * usual:
        return mean
    return float(single if is_kept and single > 0.5 * usual else usual)


def _median(values: Floats) -> float:
    """Median of finite values; numpy's own takes four times as long for a second of samples."""
    half = values.size // 2
    least = half - 1 + values.size % 2
    ordered = np.partition(values, (least, half))
    return float(0.5 * (ordered[least] + ordered[half]))


class Joint:
    """State of one joint, by its number in the alignment of all joints.

    `table` is the map in force, `temperature` the last reported one [degree Celsius]. `runs` are two runs of
    the joint's model, for the inputs and for separate outputs; empty without a model.
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
        """The joint's state in the streams: a record of `JOINT`."""
        return self._streams.joints[self._number]

    @property
    def samples(self) -> int:
        """Number of input angles taken so far."""
        return int(self.state["samples"])

    @property
    def rejected(self) -> int:
        """Number of samples that could not be used."""
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
        """Window since the last report, from the joint's samples since then, records as `Comparison.kept`."""
        before, self._reported = self._reported, self.state.copy()
        accepted, rejected = (int(self._reported[n] - before[n]) for n in ("samples", "rejected"))
        stamps, is_modelled = kept["stamp"][kept["paired"] == 0], np.isfinite(kept["speed"])
        self.lost.judge(stamps, rejected)
        residual = kept["residual"][np.isfinite(kept["output_angle"])]
        modelled = kept["torque"][is_modelled], kept["speed"][is_modelled]
        return Window(stamps, residual, *modelled, accepted, rejected, self._others(kept))

    def _others(self, kept: Any) -> str:
        """Sentence on samples of a second publisher; empty if there are none or the input is integrated."""
        own = kept.compress(kept["paired"] == 0)
        if not own.size or self.config.signals.is_velocity:
            return ""
        time, bag = 1e-9 * (own["stamp"] - own["stamp"][0]), np.zeros(own.size, np.int64)
        columns = {"input": own["input_angle"], "output": own["output_angle"]}
        if not self.no_torque:
            columns["torque"] = own["torque"]
        seen, turns = self._streams.encoders[self._number], (abs(self.config.names.input_factor), 1.0)
        within = (seen["high"] - seen["low"] <= _TURN).tolist()
        turn = zip(columns, within, turns, strict=False)
        return other_rows(time, bag, columns, {n: _TURN * size for n, one, size in turn if one})[1]

    @property
    def no_torque(self) -> str:
        """Why the reported torque was not measured; empty if it was, and before the first half turn."""
        seen = self._streams.encoders[self._number][0]
        turned = seen["high"] - seen["low"] > 0.5 * _TURN
        least, most = float(self.state["least_torque"]), float(self.state["most_torque"])
        return no_torque(least, most) if turned else ""

    def predict(self, samples: Aligned) -> tuple[Floats, Floats]:
        """Transmission error [rad] and speed [rad/s] that the joint's model gives for its next samples."""
        error, speed = np.empty(samples.stamp.size), np.empty(samples.stamp.size)
        for paired, run in enumerate(self.runs):
            rows = np.flatnonzero(samples.paired == paired)
            if rows.size:
                error[rows], speed[rows] = run(samples.part(rows), self.temperature, self.table)
        return error, speed

"""The output angle arrives late against the input angle."""

from __future__ import annotations

from functools import partial

import numpy as np

from hd_diag.arrays import Floats, Integers
from hd_diag.effects.effect import Effect, Stage, Stepped, Values
from hd_diag.effects.excitation import speed_beyond
from hd_diag.effects.quantity import Quantity
from hd_diag.effects.signals import MISSING_STEPS, Signals

_SPEED = 20.0  # least speed of the input [rad/s]: at ratio 100, 50 us read 2 arcsec there
_POINTS = 4  # points of the interpolating polynomial: the ripple turns by half a radian per sample
_ABOUT = 2  # samples on either side of the nearest one, if later samples are known

# Times [s] and output angles [rad] of the latest samples.
State = tuple[Floats, Floats]


class StreamDelay(Effect):
    """``theta_out(t - dt) - theta_out(t)``, to first order ``-dt (omega_o + dTE/dt)``.

    A running model does not know later samples, so there a negative delay is taken to first order.
    """

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """Negative speed of the output, ripple included [rad/s]; see :meth:`Effect.columns`."""
        return -(signals.speed / signals.ratio + signals.predicted_rate)[:, None]

    def response(self, signals: Signals, coefficients: Floats, nonlinear: Values) -> Floats:
        """Response along a record, interpolated from samples on both sides; see :meth:`Effect.response`.

        Interpolation from one side would average the counts of the input's encoder on that side, and imitate
        a delay.
        """
        delay, found = float(coefficients[0]), np.asarray(self.columns(signals, nonlinear) @ coefficients)
        if delay and signals.size > 1:
            angle, time = signals.output_angle + signals.predicted, signals.time
            points, weights = _late(signals, delay)
            ends = (-1, 0)[delay > 0.0]  # of a run, beyond which nothing is known
            known = np.concatenate([np.abs(time[run] - time[run][ends]) for run in signals.runs()])
            # Do not interpolate across gaps where rows of a long record were left out.
            span = signals.time[points[:, -1]] - signals.time[points[:, 0]]
            near = span < MISSING_STEPS * np.median(np.diff(signals.time))
            late = np.sum(weights * angle[points], axis=1) - angle
            found = np.where((known >= abs(delay)) & near, late, found)
        return found

    def start(self, nonlinear: Values) -> State:
        """No sample yet."""
        return np.empty(0), np.empty(0)

    def step(self, state: State, signals: Signals, coefficients: Floats, nonlinear: Values) -> Stepped:
        """Output angle a delay ago less the present one; see :meth:`Effect.step`."""
        delay, now = float(coefficients[0]), signals.output_angle + signals.predicted
        time, angle = np.append(state[0], signals.time), np.append(state[1], now)
        result = self.columns(signals, nonlinear) @ coefficients
        if delay > 0.0 and time.size >= _POINTS:
            then = signals.time - delay
            known = then > time[_POINTS - 2]
            points, weights = _between(time, then[known])
            result[known] = np.sum(weights * angle[points], axis=1) - now[known]
        kept = max(int(np.searchsorted(time, time[-1] - max(delay, 0.0))) - _POINTS, 0) if time.size else 0
        return np.asarray(result), (time[kept:], angle[kept:])

    def carry(self, signals: Signals, added: Floats, coefficients: Floats, nonlinear: Values) -> Floats:
        """Added parts a delay ago less the present ones; see :meth:`Effect.carry`."""
        delay = float(coefficients[0])
        kept = signals.kept.get("stream_delay")
        if kept is None or kept[0] != delay:  # cached, because many calls have one delay
            kept = signals.kept["stream_delay"] = delay, *_late(signals, delay)
        _, points, weights = kept
        result = -added
        for place, weight in zip(points.T, weights.T, strict=True):
            result += weight[:, None] * added.take(place, axis=0)
        return np.asarray(result)


def _late(signals: Signals, delay: float) -> tuple[Integers, Floats]:
    """Rows, and their weights, that interpolate a value a delay before each row, within its run; (n, k) each.

    Before its run a value is that of the first row. Runs that are too short are not delayed.
    """
    about = np.arange(-_ABOUT, _ABOUT + 1)
    points = np.repeat(np.arange(signals.size)[:, None], about.size, axis=1)
    weights = np.full(points.shape, 1.0 / about.size)
    for run in signals.runs():
        time = signals.time[run]
        if time.size >= about.size:
            at = np.clip(time - delay, time[0], time[-1])
            nearest = np.searchsorted(0.5 * (time[1:] + time[:-1]), at)
            own = np.clip(nearest, _ABOUT, time.size - 1 - _ABOUT)[:, None] + about
            points[run], weights[run] = run.start + own, _weights(time, at, own)
    return points, weights


def _between(time: Floats, at: Floats) -> tuple[Integers, Floats]:
    """Indices and weights (n, k) of samples around times `at`: the first not before, and those before it."""
    after = np.clip(np.searchsorted(time, at), _POINTS - 1, time.size - 1)
    points = after[:, None] + np.arange(1 - _POINTS, 1)
    return points, _weights(time, at, points)


def _weights(time: Floats, at: Floats, points: Integers) -> Floats:
    """Lagrange weights of the polynomial through samples `points` (n, k), at times `at` (n,) [s]."""
    place, weights = time[points] - at[:, None], np.ones(points.shape)
    for one in range(points.shape[1]):
        for other in range(points.shape[1]):
            if other != one:
                weights[:, one] *= place[:, other] / (place[:, other] - place[:, one])
    return weights


EFFECT = StreamDelay(
    name="stream_delay",
    cause="The output angle is stamped later than it was measured, compared with the input angle.",
    kind="sensor",
    frame="time",
    needs=("time", "speed", "output_angle", "predicted", "predicted_rate"),
    excitation=(partial(speed_beyond, speed=_SPEED),),
    stage=Stage.STREAM,
    remembers=True,
    proportional=False,
    broadband=True,
    quantities=(
        Quantity(
            "delay", "s", -0.05, 0.05, 1e-4, "dt, age of the output angle at its stamp beyond the input's"
        ),
    ),
    confused_with=("viscous_windup", "coulomb_windup", "resonance"),
    source="theta_out(t - dt): the clocks of two streams in one message",
    inspect=(
        "Where the two angles get their stamps: bus cycles, filters of the encoders, message filters. 10 us "
        "read 2.6 arcsec at 20 turns per second of the input and ratio 100. Same distance in time at all "
        "speeds; a filter's delay is that of its group. Swap the order in which the encoders are read: it "
        "must change."
    ),
)

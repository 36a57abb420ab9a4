"""Whether a record's motion excites an effect, and which extra motion would."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.effects.signals import Signals

# Whether the motion suffices; if not, the shortest extra motion that would.
Verdict = tuple[bool, str]


# A check of a record's motion. `partial` binds the arguments after the signals.
Check = Callable[[Signals], Verdict]

TURN = 2.0 * math.pi

_SPEED_STEP = 0.1  # share of the greatest speed; speeds closer than this count as one
_DIGIT = 1e-9  # share of the rated torque; smaller changes are rounding
_STILL = 1e-3  # [rad/s]; below this the input stands
_LEAST_LOAD = 0.1  # share of the rated torque at which teeth surely bear, whatever its zero's error


def _verdict(possible: bool, extra: str) -> Verdict:
    return possible, "" if possible else extra


def enough_samples(signals: Signals) -> Verdict:
    """Whether there are ten samples, enough to have some before and after a step."""
    return _verdict(signals.size >= 10, "fewer than ten samples: record before and after the step")


def _span(values: Floats) -> float:
    return float(np.ptp(values)) if values.size else 0.0


def input_turns(signals: Signals) -> float:
    """Turns that the wave generator covers [-]."""
    return _span(signals.wave_generator_angle) / TURN


def output_turns(signals: Signals) -> float:
    """Turns that the output covers [-]."""
    return _span(signals.output_angle) / TURN


def enough_input_turns(signals: Signals, turns: float) -> Verdict:
    """Whether the wave generator covers enough turns."""
    found = input_turns(signals)
    return _verdict(
        found >= turns,
        f"the wave generator covers {found:.3g} turns: let it run one way through {turns:g} turns "
        f"({turns / abs(signals.ratio):.3g} of the output)",
    )


def enough_output_turns(signals: Signals, turns: float) -> Verdict:
    """Whether the output covers enough turns."""
    found = output_turns(signals)
    return _verdict(
        found >= turns,
        f"the output covers {found:.3g} turns: let it run one way through {turns:g} "
        f"({turns * abs(signals.ratio):.0f} of the input)",
    )


def torque_varies(signals: Signals, fraction: float = 0.25) -> Verdict:
    """Whether the torque spans a fraction of the rated one."""
    span = _span(signals.torque)
    wanted = fraction * signals.rated_torque
    if not (known := torque_known(signals))[0]:
        return known
    return _verdict(
        span >= wanted,
        f"the torque spans {span:.3g} N m, {wanted:.3g} N m are needed: repeat the motion under another load",
    )


def loaded(signals: Signals) -> Verdict:
    """Whether the teeth surely bear load; within the backlash the gear's ripple cannot be predicted."""
    wanted = _LEAST_LOAD * signals.rated_torque
    most = float(np.max(np.abs(signals.torque), initial=0.0))
    return _verdict(
        most >= wanted,
        f"no load is known beyond {_signed(most)} N m, within the gear's play: repeat the motion under "
        f"{wanted:.2g} N m or more, measured",
    )


def torque_beyond(signals: Signals, fraction: float) -> Verdict:
    """Whether the torque goes beyond a fraction of the rated one in both directions."""
    torque = fraction * signals.rated_torque
    return _reaches(signals, torque, f"load the joint once up to {torque:.3g} N m in each direction")


def torque_through_zero(signals: Signals) -> Verdict:
    """Whether the torque is well on both sides of zero."""
    wanted = 0.05 * signals.rated_torque
    ends = f"from {_signed(-wanted)} to {_signed(wanted)} N m"
    return _reaches(signals, wanted, f"lead it slowly through zero, {ends}")


def _reaches(signals: Signals, torque: float, extra: str) -> Verdict:
    """Whether the torque goes that far in both directions [N m]."""
    every = signals.torque if signals.size else np.zeros(1)
    low, high = float(every.min()), float(every.max())
    if not (known := torque_known(signals))[0]:
        return known
    reached = f"the torque reaches from {_signed(low)} to {_signed(high)} N m"
    return _verdict(low <= -torque and high >= torque, f"{reached}: {extra}")


def torque_known(signals: Signals) -> Verdict:
    """Whether the torque changes by more than rounding; otherwise it may be assumed, or noise alone."""
    changes = _span(signals.torque) > _DIGIT * signals.rated_torque
    return _verdict(changes, "no torque is measured, or it never changes: record it under a load that does")


def torque_reverses(signals: Signals, fraction: float) -> Verdict:
    """Whether the torque reverses by a fraction of the rated one at three values or more, within a run."""
    swing, found = fraction * signals.rated_torque, 0
    for run in signals.runs():
        turns = np.sort(_turning_points(signals.torque[run], swing))
        found = max(found, int(np.count_nonzero(np.diff(turns) > 0.5 * swing)) + 1 if turns.size else 0)
    number = {0: "no value", 1: "one value"}.get(found, f"{found} values")
    return _verdict(
        found >= 3,
        f"the torque turns back at {number}, three are needed, {swing:.3g} N m apart or more: swing "
        "the load up, half-way down and up again without a pause",
    )


def both_directions(signals: Signals) -> Verdict:
    """Whether the input runs each way in at least a twentieth of the samples."""
    share = [float(np.mean(way * signals.speed > _STILL)) if signals.size else 0.0 for way in (1.0, -1.0)]
    return _verdict(min(share) >= 0.05, "the joint runs one way only: drive the same stretch back as well")


def several_speeds(signals: Signals, number: int) -> Verdict:
    """Whether the input runs at enough different speeds."""
    speed = np.abs(signals.speed[np.abs(signals.speed) > _STILL])
    found = 0
    if speed.size:
        level = np.bincount(np.rint(speed / (_SPEED_STEP * speed.max())).astype(np.int64))
        found = int(np.count_nonzero(level >= max(10, 0.005 * speed.size)))
    return _verdict(
        found >= number,
        f"{found} {'speed' if found == 1 else 'speeds'}: repeat the motion at {number} different speeds, "
        "or ramp the speed",
    )


def _signed(value: float) -> str:
    """Value as text with a typographic minus sign; "0" where its magnitude is below 5e-4."""
    return f"{value:.3g}".replace("-", "\N{MINUS SIGN}", 1) if abs(value) >= 5e-4 else "0"


def speed_beyond(signals: Signals, speed: float) -> Verdict:
    """Whether the input reaches a speed [rad/s]."""
    found = float(np.max(np.abs(signals.speed), initial=0.0))
    return _verdict(
        found >= speed,
        f"the input reaches {found:.3g} rad/s: run the joint fast, with its ripple, at {speed:.3g} rad/s or "
        "more",
    )


def temperature_varies(signals: Signals, span: float = 3.0) -> Verdict:
    """Whether the temperature is measured and changes by `span` [K]."""
    if signals.temperature is None:
        return False, "no temperature is measured: record it, cold and after warming up by 3 K"
    found = _span(signals.temperature)
    return _verdict(
        found >= span, f"the temperature changes by {found:.2g} K: repeat the motion {span:g} K warmer"
    )


def sample_interval(signals: Signals) -> float:
    """Median time between samples of a run [s]; infinite if there is none."""
    steps = [np.diff(signals.time[run]) for run in signals.runs()]
    every = np.concatenate(steps) if steps else np.empty(0)
    return float(np.median(every)) if every.size else math.inf


def _turning_points(torque: Floats, swing: float) -> Floats:
    """Torques at which the torque reverses by more than a swing, as in rainflow counting [N m]."""
    if not torque.size:
        return np.empty(0)
    low = high = float(torque[0])
    way, found = 0, []
    for value in _extremes(torque).tolist():
        low, high = min(low, value), max(high, value)
        if way >= 0 and high - value > swing:
            found += [high] * (way != 0)
            way, low, high = -1, value, value
        elif way <= 0 and value - low > swing:
            found += [low] * (way != 0)
            way, low, high = 1, value, value
    return np.array(found)


def _extremes(values: Floats) -> Floats:
    """Local extremes and both ends; reversals depend on no other values."""
    change = np.diff(values)
    inner = np.flatnonzero(change[1:] * change[:-1] <= 0.0) + 1
    return np.asarray(values[np.concatenate(([0], inner, [values.size - 1]))])

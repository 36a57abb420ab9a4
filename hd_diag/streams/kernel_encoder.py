"""Makes reported encoder angles continuous, compiled: a part of `kernel`, and for tables."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.model.kernel.compiler import entry_point, part

_TURN = 2.0 * math.pi
_ROUNDING = 1e-6  # a wrapped angle may leave its turn by this much [rad]
_WORD = 65536.0  # counts of a 32-bit counter over those of a 16-bit one


@part
def continuous(encoder: Any, stretch: int, angle: float, counter: float) -> float:
    """An angle that may wrap, with its turns [rad]; `counter` is the angle of 16 bits of counts, else 0."""
    if encoder.stretch != stretch:
        if encoder.stretch < 0:
            encoder.low = encoder.high = angle
        encoder.stretch, encoder.turns, encoder.angle = stretch, 0.0, angle
    before = _period(encoder.high - encoder.low, counter)
    encoder.low, encoder.high = min(encoder.low, angle), max(encoder.high, angle)
    period = _period(encoder.high - encoder.low, counter)
    if period != before:
        encoder.turns = 0.0
    if abs(angle - encoder.angle) > 0.5 * period:
        encoder.turns -= math.copysign(1.0, angle - encoder.angle)
    encoder.angle = angle
    return float(angle + (period * encoder.turns if encoder.turns != 0.0 else 0.0))


@part
def _period(reach: float, counter: float) -> float:
    """Angle after which an encoder with this range wraps [rad]: a turn, 16 or 32 bits, or infinite."""
    if reach <= _TURN + _ROUNDING:
        return _TURN
    if counter > _TURN and reach <= counter:
        return counter
    if counter > 0.0 and reach <= counter * _WORD:
        return counter * _WORD
    return math.inf


@entry_point
def continued(angle: Floats, counter: float, encoders: Any) -> Floats:
    """Continuous angles (n,) [rad], from angles of an encoder not seen before; nan is passed over."""
    found = np.empty_like(angle)
    for i in range(angle.size):
        known = not math.isnan(angle[i])
        found[i] = continuous(encoders[0], 0, angle[i], counter) if known else math.nan
    return found

"""What effects see of each other: from the gear over the drive's spring to the stream of samples."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Effect, Stage
from hd_diag.effects.signals import Signals


def seen_at(
    stage: Stage, signals: Signals, parts: Sequence[tuple[Effect, Floats]], rate: Callable[[Floats], Floats]
) -> Signals:
    """Signals for the effects of a stage: the spring carries errors of the teeth, a late stream shows all.

    From those with the base model's own prediction and what effects add [rad] (n,) each, of which those of
    the same and later stages do not count; the rate is the derivative by time of values at the samples.
    """
    before = [(effect, part) for effect, part in parts if Stage.GEAR <= effect.stage < stage]
    if stage == Stage.SPRING:
        teeth = [part for effect, part in before if effect.of_teeth]
        return replace(signals, tooth_ripple=np.sum(teeth, axis=0)) if teeth else signals
    if not before:
        return signals
    total: Floats = signals.predicted + np.sum([part for _, part in before], axis=0)
    return replace(signals, predicted=total, predicted_rate=rate(total))

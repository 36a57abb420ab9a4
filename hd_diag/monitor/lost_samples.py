"""Samples that the stamps say were lost on the way."""

from __future__ import annotations

import numpy as np

from hd_diag.arrays import Floats, Times

_STEPS_TOGETHER = 32
_KEPT = 0.02  # by which the steps of a sender that keeps its period differ [-]
_OFF_MULTIPLE = 0.25  # by which a step may differ from whole periods [-]
_SAME = 0.9  # share of steps that are alike: the period is another now
_JUDGED_AT_LEAST = 8  # stamps, for their usual step


class LostSamples:
    """Count of a joint's lost samples: jitter adds and takes away steps, a loss only adds.

    Attributes
    ----------
    count : int
    usual_step : float
        Period of the sender [ns]; 0 while it is not known.
    """

    def __init__(self) -> None:
        self.count = self.lately = 0
        self.usual_step = 0.0
        self.unjudged: Times = np.empty(0, np.int64)

    def judge(self, stamps: Times, rejected: int) -> None:
        """Count what is missing among further samples.

        Parameters
        ----------
        stamps : ndarray of int64, shape (n,)
            Of the samples since the last call [ns]; they are judged from the last stamp before on, and once
            there are enough of them. What a sender makes up for after a call was not lost: it is taken back.
        rejected : int
            Samples that came and could not be used: they are not lost.
        """
        self.unjudged = np.concatenate((self.unjudged, stamps))
        if self.unjudged.size < _JUDGED_AT_LEAST:
            return
        steps = np.diff(self.unjudged).astype(np.float64)
        self.unjudged = self.unjudged[-1:]
        steps = steps[steps > 0.0]  # a clock that was set back
        usual = self.usual_step = _known_step(steps, self.usual_step) or _usual_step(steps)
        if usual <= 0.0:
            return
        long = np.sum(np.rint(steps[steps > 1.5 * usual] / usual) - 1.0)
        net = np.rint(np.sum(steps) / usual) - steps.size
        lost = max(0, int(min(long, net)) - rejected)
        made_up = min(self.lately, max(0, -int(net)), int(np.count_nonzero(steps < 0.5 * usual)))
        self.lately = lost
        self.count += lost - made_up


def _known_step(steps: Floats, known: float) -> float:
    """The period known so far [ns], where a reader that falls behind lets samples of it through; else 0.

    Then most samples may be lost: nearly all steps are multiples of the period, and not all the same.
    """
    if known <= 0.0 or 2 * np.count_nonzero(steps > 1.5 * known) <= steps.size:
        return 0.0
    multiples = np.rint(steps / known)
    whole = np.abs(steps / known - multiples) < _OFF_MULTIPLE
    _, counts = np.unique(multiples, return_counts=True)
    return known if counts.max() < _SAME * steps.size and float(np.mean(whole)) > _SAME else 0.0


def _usual_step(steps: Floats) -> float:
    """Period of a sender [ns]: over several steps, for one that makes up for its delays has short ones."""
    if not steps.size:
        return 0.0
    span = max(1, min(_STEPS_TOGETHER, steps.size // 2))
    time = np.concatenate(([0.0], np.cumsum(steps)))
    usual = float(np.median(time[span:] - time[:-span])) / span
    # With many losses there is one in most spans; where the sender keeps its period a single step tells it.
    single = float(np.median(steps))
    is_kept = np.mean(np.abs(steps - single) < _KEPT * single) > 0.5
    return single if is_kept and single > 0.5 * usual else usual

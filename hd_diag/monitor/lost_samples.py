"""Samples that the stamps say were lost on the way."""

from __future__ import annotations

import numpy as np

from hd_diag.arrays import Times

_JUDGED_AT_LEAST = 8  # stamps, for their usual step


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

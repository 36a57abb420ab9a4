"""Output angles that arrive apart from the input: each is compared with the input at its own stamp."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Floats, Times

REMEMBERED = 256
"""Input samples kept for output angles that arrive later, and output angles that may wait for an input."""

# An output angle is compared with an input angle interpolated over at most this time [ns].
_GAP = 50_000_000

Input = tuple[int, float]
Output = tuple[int, float, float]


class Inputs(NamedTuple):
    """Input angles by rising stamp: position of the message, stamp [ns], angle [rad], each (n,)."""

    row: Times
    stamp: Times
    angle: Floats


class Outputs(NamedTuple):
    """Output angles by rising stamp: position of the message, stamp [ns], angle [rad], torque [N m], (n,)."""

    row: Times
    stamp: Times
    angle: Floats
    torque: Floats

    def part(self, rows: npt.NDArray[np.bool_] | slice) -> Outputs:
        """Some of them."""
        return Outputs(self.row[rows], self.stamp[rows], self.angle[rows], self.torque[rows])


class Pairs(NamedTuple):
    """What becomes of output angles.

    Attributes
    ----------
    found : Outputs
        Those with an input, at the position of the message that made the pair complete.
    input_angle : ndarray
        Interpolated to their stamps [rad].
    unpaired : int
        Those whose input is too far away or forgotten.
    waiting : Outputs
        Those for which no input is late enough yet.
    """

    found: Outputs
    input_angle: Floats
    unpaired: int
    waiting: Outputs


def interpolated(inputs: deque[Input], stamp: int) -> float | None:
    """Input angle at a stamp between two samples not too far apart; None outside."""
    later: Input | None = None
    for time, angle in reversed(inputs):
        if time == stamp:
            return angle
        if time < stamp:
            if later is None or later[0] - time > _GAP:
                return None
            return angle + (later[1] - angle) * ((stamp - time) / (later[0] - time))
        later = time, angle
    return None


def pairs(
    known: Sequence[Input], inputs: Inputs, waiting: Sequence[Output], outputs: Outputs
) -> Pairs | None:
    """The same for many messages at once, to the last bit.

    Parameters
    ----------
    known : sequence of (int, float)
        Earlier inputs: stamp [ns], angle [rad]; the last `REMEMBERED` of them.
    inputs : Inputs
        Later than the known ones.
    waiting : sequence of (int, float, float)
        Earlier outputs later than the known inputs: stamp [ns], angle [rad], torque [N m].
    outputs : Outputs
        Later than those that wait.

    Returns
    -------
    Pairs or None
        None where more outputs would have to wait than can be.
    """
    inputs, outputs = _after(known, inputs), _outputs_after(waiting, outputs)
    later = np.searchsorted(inputs.stamp, outputs.stamp)
    complete = later < inputs.stamp.size
    ready, later = outputs.part(complete), later[complete]
    row = np.maximum(ready.row, inputs.row[later])
    before = np.arange(outputs.row.size) - np.searchsorted(row, outputs.row)
    if np.any((before >= REMEMBERED) & (outputs.row >= 0)):
        return None
    oldest = np.maximum(np.searchsorted(inputs.row, row, side="right") - REMEMBERED, 0)
    exact = inputs.stamp[later] == ready.stamp
    earlier = np.where(exact, later, later - 1)
    near = (earlier >= oldest) & (inputs.stamp[later] - inputs.stamp[earlier] <= _GAP)
    found, later, earlier = ready._replace(row=row).part(near), later[near], earlier[near]
    angle = _between(inputs, earlier, later, found.stamp)
    return Pairs(found, angle, int(near.size - angle.size), outputs.part(~complete))


def _between(inputs: Inputs, earlier: Times, later: Times, stamp: Times) -> Floats:
    start, angle = inputs.stamp[earlier], inputs.angle[earlier]
    length = np.maximum(inputs.stamp[later] - start, 1)  # where the stamps agree nothing is added
    share = (stamp - start).astype(np.float64) / length.astype(np.float64)
    return np.where(earlier == later, angle, angle + (inputs.angle[later] - angle) * share)


def _after(known: Sequence[Input], inputs: Inputs) -> Inputs:
    if not known:
        return inputs
    stamp, angle = zip(*known, strict=True)
    return Inputs(
        np.concatenate((np.full(len(known), -1), inputs.row)),
        np.concatenate((np.array(stamp, np.int64), inputs.stamp)),
        np.concatenate((np.array(angle), inputs.angle)),
    )


def _outputs_after(waiting: Sequence[Output], outputs: Outputs) -> Outputs:
    if not waiting:
        return outputs
    stamp, angle, torque = zip(*waiting, strict=True)
    return Outputs(
        np.concatenate((np.full(len(waiting), -1), outputs.row)),
        np.concatenate((np.array(stamp, np.int64), outputs.stamp)),
        np.concatenate((np.array(angle), outputs.angle)),
        np.concatenate((np.array(torque), outputs.torque)),
    )

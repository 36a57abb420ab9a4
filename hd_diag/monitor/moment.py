"""One message, as it comes while live: all joints that it tells of are predicted side by side."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hd_diag.arrays import Floats, Times
from hd_diag.drive import Drives
from hd_diag.monitor.joint import Asked, JointMonitor, Prediction, Samples

_ROW = np.zeros(1, np.int64)


class Moment(NamedTuple):
    """Predictions that one message lets be made, k of them, joint by joint.

    Attributes
    ----------
    joints : list of JointMonitor
    asked : list of Asked
    stamp : ndarray of int64, shape (k,)
        [ns]
    torque, predicted, measured, residual : ndarray, shape (k,)
        [N m], [rad]; nan where no output angle is reported.
    """

    joints: list[JointMonitor]
    asked: list[Asked]
    stamp: Times
    input_angle: Floats
    torque: Floats
    predicted: Floats
    measured: Floats
    residual: Floats

    def prediction(self, number: int) -> Prediction:
        """One of them as a row of its joint."""
        at = slice(number, number + 1)
        given = self.stamp[at], self.input_angle[at], self.torque[at], self.predicted[at]
        return Prediction(_ROW, *given, paired=self.asked[number].paired)


class Moments:
    """Makes moments of the joints of one configuration; what they have in common is computed once."""

    def __init__(self) -> None:
        self._drives: dict[tuple[str, ...], Drives] = {}

    def __call__(self, joints: list[JointMonitor], asked: list[Asked]) -> Moment:
        """Predictions asked for, each noted by its joint.

        Parameters
        ----------
        joints : list of k JointMonitor
            Each as often as it asks.
        asked : list of k Asked

        Returns
        -------
        Moment
        """
        stamp = np.array([each.stamp for each in asked], np.int64)
        angle, torque = (np.array(column) for column in zip(*(each[1:3] for each in asked), strict=True))
        output = np.array([math.nan if each.output_angle is None else each.output_angle for each in asked])
        predicted = self._predicted(joints, asked, stamp, angle, torque)
        measured = self._together(joints).frame.measured_error(angle, output)
        found = Moment(joints, asked, stamp, angle, torque, predicted, measured, measured - predicted)
        for number, (joint, each) in enumerate(zip(joints, asked, strict=True)):
            at = slice(number, number + 1)
            joint.note(stamp[at], each.paired)
            if each.output_angle is not None:
                joint.note_residual(stamp[at], angle[at], output[at], found.residual[at])
        return found

    def _predicted(
        self, joints: list[JointMonitor], asked: list[Asked], stamp: Times, angle: Floats, torque: Floats
    ) -> Floats:
        if all(joint.config.model is None for joint in joints):
            tables = [joint.table for joint in joints]
            return self._together(joints).transmission_error(angle, torque, tables)
        found = np.empty(angle.shape)
        for number, (joint, each) in enumerate(zip(joints, asked, strict=True)):
            at = slice(number, number + 1)
            speed = None if each.speed is None else np.array([each.speed])
            rows = Samples(stamp[at], angle[at], None, None, speed)
            found[at] = joint.predict(rows, torque[at], each.paired)
        return found

    def _together(self, joints: Sequence[JointMonitor]) -> Drives:
        names = tuple([joint.config.name for joint in joints])
        found = self._drives.get(names)
        if found is None:
            found = Drives([joint.config.drive for joint in joints])
            self._drives = {**self._drives, names: found} if len(self._drives) < 64 else {names: found}
        return found

"""The rules of `alignment` compiled: rows of messages in, aligned samples out, with state between calls.

`alignment` imports this module when first needed, because it imports numba. No result depends on the number
of rows per call. The state is in records per joint (`JOINT`) and in rings (`INPUT`, `OUTPUT`).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hd_diag.arrays import Bytes, Floats, Integers, Times
from hd_diag.model.kernel.compiler import entry_point, part
from hd_diag.streams.columns import LARGEST_ANGLE, LARGEST_TORQUE
from hd_diag.streams.kernel_encoder import continuous
from hd_diag.streams.rules import CLOCK_JUMP, DRIFT_TIME, LONGEST_HOLD, NEVER, PAIRING_GAP, Given, Reason

_INPUT, _OUTPUT, _TORQUE, _SPEED = int(Given.INPUT), int(Given.OUTPUT), int(Given.TORQUE), int(Given.SPEED)
_REFUSED, _OTHER, _UNREADABLE = int(Given.REFUSED), int(Given.OTHER), int(Reason.UNREADABLE)
_UNSTAMPED = int(Given.UNSTAMPED)
_NAMELESS, _BAD_INPUT, _BAD_OUTPUT = int(Reason.NAMELESS), int(Reason.INPUT), int(Reason.OUTPUT)
_BAD_TORQUE, _LATE_INPUT, _LATE_OUTPUT = int(Reason.TORQUE), int(Reason.LATE_INPUT), int(Reason.LATE_OUTPUT)
_FIRST, _LAST = -(2**63), 2**63 - 1  # before and after every stamp [ns]


@entry_point
def align(
    stamp: Times,
    heard: Times,
    values: Floats,
    given: Bytes,
    joints: Any,
    encoders: Any,
    inputs: Any,
    waiting: Any,
) -> tuple[Integers, Floats]:
    """Aligned samples, columns (6, m) and (4, m) as in `Aligned`.

    `stamp` and times of reception `heard` are (n,) [ns]. `values` (n, k, 4) are input and output angle,
    torque and speed of k joints; the angles become continuous. `given` (n, k) flags the given values.
    """
    room = values.shape[0] * joints.size
    for j in range(joints.size):
        room += joints[j].waiting
    whole, found, count = np.empty((6, room), np.int64), np.empty((4, room)), 0
    for row in range(values.shape[0]):
        for j in range(joints.size):
            if given[row, j]:
                completed = _with_velocity(joints[j], int(given[row, j]), values[row, j])
                before = joints[j].input_stamp
                left = _checked(joints[j], row, stamp[row], completed, values[row, j])
                _count_turns(joints[j], encoders[j], left, values[row, j])
                if joints[j].velocity_ratio != 0.0:
                    left = _integrate(joints[j], stamp[row], before, left, values[row, j])
                if left & _TORQUE:
                    joints[j].torque, joints[j].torque_stamp = values[row, j, 2], stamp[row]
                    joints[j].least_torque = min(joints[j].least_torque, values[row, j, 2])
                    joints[j].most_torque = max(joints[j].most_torque, values[row, j, 2])
                if left & _INPUT:
                    _take_input(joints[j], stamp[row], heard[row], left, values[row, j], inputs[j])
                    output = values[row, j, 1] if left & _OUTPUT else math.nan
                    speed = values[row, j, 3] if left & _SPEED else math.nan
                    whole[:3, count] = row, j, stamp[row]
                    whole[3:, count] = joints[j].torque_stamp, joints[j].stretch, 0
                    found[:, count] = joints[j].angle, output, joints[j].load, speed
                    count += 1
                elif left & _OUTPUT:
                    _keep_output(joints[j], stamp[row], values[row, j, 1], waiting[j])
        count = _pair(row, joints, inputs, waiting, whole, found, count)
    return whole[:, :count], found[:, :count]


@entry_point
def begin_after(joints: Any, stamp: int) -> None:
    """Restart the streams of joints with a last stamp after `stamp` [ns]."""
    for j in range(joints.size):
        if max(joints[j].input_stamp, joints[j].output_stamp) > stamp:
            _begin(joints[j])


@part
def _begin(joint: Any) -> None:
    """Restart a joint's stream."""
    joint.input_stamp = joint.output_stamp = joint.torque_stamp = NEVER
    joint.inputs = joint.waiting = joint.output_seen = 0
    joint.torque = math.nan
    joint.followed, joint.away, joint.drift = 0, 0.0, 0.0
    joint.stretch += 1


@part
def _refuse(joint: Any, reason: int, value: float, late: int) -> int:
    joint.rejected += 1
    joint.reason, joint.reason_value, joint.reason_late = reason, value, late
    return 0


@part
def _checked(joint: Any, row: int, stamp: int, given: int, value: Floats) -> int:
    """Flags of given values that can be used; 0 if the row is refused."""
    unstamped, given = int(given & _UNSTAMPED != 0), given & ~_UNSTAMPED
    if given & _REFUSED:
        return _refuse(joint, _UNREADABLE, 0.0, row)
    if given == _OTHER:
        return 0
    if not given & (_INPUT | _OUTPUT | _TORQUE):
        return _refuse(joint, _NAMELESS, 0.0, 0)
    if stamp < max(joint.input_stamp, joint.output_stamp) - CLOCK_JUMP:
        joint.clock_jumps += joint.by_reception == unstamped  # otherwise it is another clock
        _begin(joint)
    joint.by_reception = unstamped
    joint.unstamped += unstamped
    if given & _TORQUE and not given & _INPUT and math.isnan(value[1]) and not math.isnan(value[2]):
        given &= ~_OUTPUT
    if given & _INPUT:
        if not abs(value[0]) <= LARGEST_ANGLE:
            return _refuse(joint, _BAD_INPUT, value[0], 0)
        if stamp <= joint.input_stamp:
            return _refuse(joint, _LATE_INPUT, 0.0, joint.input_stamp - stamp)
    elif given & _OUTPUT and stamp <= joint.output_stamp:
        return _refuse(joint, _LATE_OUTPUT, 0.0, joint.output_stamp - stamp)
    if given & _TORQUE and not abs(value[2]) <= LARGEST_TORQUE:
        if not (math.isnan(value[2]) and math.isnan(joint.torque)):
            return _refuse(joint, _BAD_TORQUE, value[2], 0)
        given &= ~_TORQUE
    if given & _OUTPUT and not abs(value[1]) <= LARGEST_ANGLE:
        if not math.isnan(value[1]) or joint.output_seen:
            return _refuse(joint, _BAD_OUTPUT, value[1], 0)
        given &= ~_OUTPUT
    return given


@part
def _count_turns(joint: Any, encoders: Any, given: int, value: Floats) -> None:
    """Make the angles of a row continuous, and convert input and speed to the wave generator's."""
    if given & _INPUT and joint.velocity_ratio == 0.0:
        value[0] = continuous(encoders[0], joint.stretch, value[0], joint.input_counter) * joint.input_factor
    if given & _OUTPUT:
        value[1] = continuous(encoders[1], joint.stretch, value[1], joint.output_counter)
    if given & _SPEED:
        value[3] *= joint.input_factor


@part
def _with_velocity(joint: Any, given: int, value: Floats) -> int:
    """Flags of given values; an input velocity takes the place of the angle in the checks."""
    if joint.velocity_ratio != 0.0 and given & _SPEED:
        value[0] = value[3]
        given |= _INPUT
    return given


@part
def _integrate(joint: Any, stamp: int, before: int, given: int, value: Floats) -> int:
    """Replace the input angle by the integral of the velocity; returns the flags of given values.

    The integral slowly follows the output times the ratio: their difference decays over `DRIFT_TIME`. There
    is no angle before an output is known. `before` is the stamp of the previous input.
    """
    elapsed = (stamp - before) * 1e-9
    if given & _INPUT:
        if stamp - before > PAIRING_GAP:
            joint.followed = 0  # the offset from the output is kept across the gap
        joint.away += 0.5 * (joint.rate + value[3]) * elapsed * joint.followed
        joint.rate = value[3]
    if given & _OUTPUT:
        own = joint.velocity_ratio * value[1]
        if joint.followed:
            joint.away -= own - joint.own
        joint.own, joint.followed = own, 1
    if given & _INPUT and joint.followed:
        joint.drift += (1.0 - math.exp(-min(elapsed, DRIFT_TIME) / DRIFT_TIME)) * (joint.away - joint.drift)
        value[0] = joint.own + joint.away - joint.drift
        return given
    return given & ~_INPUT


@part
def _load(joint: Any, stamp: int) -> float:
    """Torque at a stamp [N m]: reported, or the assumed one."""
    is_known = abs(stamp - joint.torque_stamp) <= LONGEST_HOLD and not math.isnan(joint.torque)
    value: float = joint.torque if is_known else joint.assumed_torque
    return value


@part
def _take_input(joint: Any, stamp: int, heard: int, given: int, value: Floats, ring: Any) -> None:
    joint.input_stamp, joint.heard = stamp, heard
    joint.angle, joint.load = value[0], _load(joint, stamp)
    joint.samples += 1
    place = joint.inputs % ring.size
    ring[place].stamp, ring[place].angle = stamp, value[0]
    joint.inputs += 1
    if given & _OUTPUT:
        joint.output_seen, joint.output_stamp = 1, max(joint.output_stamp, stamp)


@part
def _keep_output(joint: Any, stamp: int, angle: float, ring: Any) -> None:
    """Let an output angle wait for an input; if too many wait, the oldest is dropped."""
    joint.output_seen, joint.output_stamp = 1, stamp
    if joint.waiting == ring.size:
        joint.unpaired += 1
        joint.waiting -= 1
        joint.first += 1
    place = (joint.first + joint.waiting) % ring.size
    ring[place].stamp, ring[place].angle = stamp, angle
    ring[place].torque, ring[place].torque_stamp = _load(joint, stamp), joint.torque_stamp
    joint.waiting += 1


@part
def _pair(
    row: int, joints: Any, inputs: Any, waiting: Any, whole: Integers, found: Floats, count: int
) -> int:
    """Add samples of waiting outputs whose input is known, by stamp and joint; returns the new count."""
    while True:
        stamp = _LAST
        for j in range(joints.size):
            if joints[j].waiting:
                first = waiting[j, joints[j].first % waiting.shape[1]].stamp
                if first <= joints[j].input_stamp:
                    stamp = min(stamp, first)
        if stamp == _LAST:
            return count
        for j in range(joints.size):
            output = waiting[j, joints[j].first % waiting.shape[1]]
            if not joints[j].waiting or output.stamp != stamp or stamp > joints[j].input_stamp:
                continue
            joints[j].first += 1
            joints[j].waiting -= 1
            angle = _interpolated(joints[j], inputs[j], stamp)
            if math.isnan(angle):
                joints[j].unpaired += 1
            else:
                whole[:, count] = row, j, stamp, output.torque_stamp, joints[j].stretch, 1
                found[:, count] = angle, output.angle, output.torque, math.nan
                count += 1


@part
def _interpolated(joint: Any, ring: Any, stamp: int) -> float:
    """Input angle at a stamp not after the last input [rad]; nan if the inputs around it are far apart."""
    low, high = joint.inputs - min(joint.inputs, ring.size), joint.inputs - 1
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if ring[middle % ring.size].stamp >= stamp else (middle + 1, high)
    later, earlier = ring[low % ring.size], ring[(low - 1) % ring.size]
    if later.stamp == stamp:
        return float(later.angle)
    is_oldest = low == joint.inputs - min(joint.inputs, ring.size)
    if is_oldest or later.stamp - earlier.stamp > PAIRING_GAP:
        return math.nan
    share = float(stamp - earlier.stamp) / float(later.stamp - earlier.stamp)
    return float(earlier.angle + (later.angle - earlier.angle) * share)


@entry_point
def messages(
    row: Times, stamp: Times, paired: Integers, joint: Integers, output_angle: Floats
) -> tuple[Integers, Integers, Integers, Integers]:
    """Samples to publish: first those at the inputs' own stamps, then those with an output angle.

    A message holds samples of one row and stamp, either paired or not. A run is of consecutive messages with
    the same joints. For both kinds the result has the indices of the samples (m,), and for each run its first
    place among them and the number of joints per message (2, runs).
    """
    own, compared = np.flatnonzero(paired == 0), np.flatnonzero(~np.isnan(output_angle))
    return own, _runs(row, stamp, paired, joint, own), compared, _runs(row, stamp, paired, joint, compared)


@part
def _runs(row: Times, stamp: Times, paired: Integers, joint: Integers, chosen: Integers) -> Integers:
    bounds, messages, begin = np.empty((2, chosen.size), np.int64), 0, 0
    while begin < chosen.size:
        first, end = chosen[begin], begin + 1
        while end < chosen.size and row[chosen[end]] == row[first]:
            if stamp[chosen[end]] != stamp[first] or paired[chosen[end]] != paired[first]:
                break
            end += 1
        width = end - begin
        like = messages > 0 and bounds[1, messages - 1] == width
        for k in range(begin, end if like else begin):
            like = like and joint[chosen[k]] == joint[chosen[k - width]]
        if not like:
            bounds[0, messages], bounds[1, messages] = begin, width
            messages += 1
        begin = end
    return bounds[:, :messages]


@entry_point
def begun(
    stamp: Times, joint: Integers, paired: Integers, period: int, offset: Times, last: Times
) -> Integers:
    """Indices of samples that begin a period [ns] of their joint; paired ones are skipped.

    The joints' periods begin earlier by an `offset` (k,) [ns]. `last` (k,) holds the numbers of the joints'
    last periods and is updated.
    """
    found, count = np.empty(stamp.size, np.int64), 0
    for i in range(stamp.size):
        number = (stamp[i] + offset[joint[i]]) // period
        if not paired[i] and number != last[joint[i]]:
            last[joint[i]] = number
            found[count] = i
            count += 1
    return found[:count]

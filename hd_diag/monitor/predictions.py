"""Predictions of all joints as messages: joints that are predicted at the same moment share one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

import numpy as np

from hd_diag.arrays import Floats, Times
from hd_diag.monitor.joint import Prediction
from hd_diag.monitor.moment import Moment
from hd_diag.streams.columns import Angles, Publication

_PREDICTED = "~/transmission_error"
_MEASURED = "~/measured_transmission_error"
_RESIDUAL = "~/residual"


class _Group(NamedTuple):
    """Joints predicted at the same stamps by the same messages, and the number of the first of them."""

    joints: dict[str, Prediction]
    first: int

    @property
    def one(self) -> Prediction:
        return next(iter(self.joints.values()))

    def part(self, rows: slice) -> _Group:
        return _Group({name: found.part(rows) for name, found in self.joints.items()}, self.first)


def angles(received: Times, results: Mapping[str, list[Prediction]]) -> list[Publication]:
    """Messages of predictions.

    Parameters
    ----------
    received : ndarray of int64, shape (n,)
        When the messages that gave the predictions arrived [ns].
    results : mapping of str to list of Prediction
        By joint, at most one paired and one that is not.

    Returns
    -------
    list of Publication
        In every topic in the order in which the messages one by one would give them.
    """
    numbers = {name: number for number, name in enumerate(results)}
    groups = [
        group
        for paired in (False, True)
        for group in _groups(
            {n: p for n, found in results.items() for p in found if p.paired == paired}, numbers
        )
    ]
    errors = _in_order([group for group in groups if not group.one.paired])
    compared = _in_order([part for group in groups for part in _compared(group)])
    found: list[Publication] = [_errors(received[group.one.row], group) for group in errors]
    return found + [m for group in compared for m in _comparisons(received[group.one.row], group)]


def angles_of_moment(received: Times, moment: Moment) -> list[Publication]:
    """Messages of one moment, the same as of several.

    Parameters
    ----------
    received : ndarray of int64, shape (1,)
        When the message that gave it arrived [ns].
    moment : Moment

    Returns
    -------
    list of Publication
    """
    shared: dict[tuple[bool, int], list[int]] = {}
    for number, asked in enumerate(moment.asked):
        shared.setdefault((asked.paired, asked.stamp), []).append(number)
    found: list[Publication] = []
    for (paired, _), rows in shared.items():
        if not paired:
            values = moment.predicted, moment.torque
            found.append(_side_by_side(_PREDICTED, received, moment, rows, *values))
        compared = [row for row in rows if moment.asked[row].output_angle is not None]
        if compared:
            for topic, value in ((_MEASURED, moment.measured), (_RESIDUAL, moment.residual)):
                found.append(_side_by_side(topic, received, moment, compared, value))
    return found


def _side_by_side(
    topic: str,
    received: Times,
    moment: Moment,
    rows: list[int],
    position: Floats,
    effort: Floats | None = None,
) -> Angles:
    names = tuple([moment.joints[row].config.name for row in rows])
    if len(rows) < len(moment.asked):
        position, effort = position[rows], None if effort is None else effort[rows]
    stamp = moment.stamp[rows[0] : rows[0] + 1]
    return Angles(topic, received, stamp, names, position[None], None if effort is None else effort[None])


def _groups(predictions: dict[str, Prediction], numbers: Mapping[str, int]) -> list[_Group]:
    """Predictions by the joints that share their messages."""
    if not predictions:
        return []
    one, *others = predictions.values()
    if all(np.array_equal(one.stamp, other.stamp) and np.array_equal(one.row, other.row) for other in others):
        return [_Group(predictions, numbers[next(iter(predictions))])]
    keys = [np.stack((p.row, p.stamp), axis=1) for p in predictions.values()]
    every, place = np.unique(np.concatenate(keys), axis=0, return_inverse=True)
    row_of = np.full((len(every), len(keys)), -1)
    ends = np.cumsum([len(key) for key in keys])
    for column, rows in enumerate(np.split(place.reshape(-1), ends[:-1])):
        row_of[rows, column] = np.arange(rows.size)
    patterns, which = np.unique(row_of >= 0, axis=0, return_inverse=True)
    found = []
    for number, pattern in enumerate(patterns):
        rows = row_of[which.reshape(-1) == number]
        members = {
            name: prediction.part(rows[:, column])
            for column, (name, prediction) in enumerate(predictions.items())
            if pattern[column]
        }
        found.append(_Group(members, numbers[next(iter(members))]))
    return found


def _compared(group: _Group) -> Iterator[_Group]:
    """The group's joints that have a measured error."""
    joints = {name: found for name, found in group.joints.items() if found.measured is not None}
    if joints:
        yield group if len(joints) == len(group.joints) else _Group(joints, group.first)


def _in_order(groups: list[_Group]) -> Iterable[_Group]:
    """Groups taken apart so that message follows message as the rows that gave them."""
    if len(groups) < 2:
        return groups
    sizes = [group.one.stamp.size for group in groups]
    owner = np.repeat(np.arange(len(groups)), sizes)
    first, paired = (
        np.repeat(column, sizes) for column in zip(*((g.first, g.one.paired) for g in groups), strict=True)
    )
    row, stamp = (
        np.concatenate(column) for column in zip(*((g.one.row, g.one.stamp) for g in groups), strict=True)
    )
    owner = owner[np.lexsort((stamp, paired, first, row))]
    done = [0] * len(groups)
    parts = []
    bounds = np.flatnonzero(np.diff(owner)) + 1
    for begin, end in zip([0, *bounds.tolist()], [*bounds.tolist(), owner.size], strict=True):
        number = int(owner[begin])
        parts.append(groups[number].part(slice(done[number], done[number] + end - begin)))
        done[number] += end - begin
    return parts


def _errors(received: Times, group: _Group) -> Angles:
    found = list(group.joints.values())
    values = _columns([p.predicted for p in found]), _columns([p.torque for p in found])
    return Angles(_PREDICTED, received, group.one.stamp, tuple(group.joints), *values)


def _comparisons(received: Times, group: _Group) -> Iterator[Angles]:
    names, stamp = tuple(group.joints), group.one.stamp
    measured = [p.measured for p in group.joints.values() if p.measured is not None]
    residual = [p.residual for p in group.joints.values() if p.residual is not None]
    for topic, values in ((_MEASURED, measured), (_RESIDUAL, residual)):
        yield Angles(topic, received, stamp, names, _columns(values), None)


def _columns(values: list[Floats]) -> Floats:
    """Columns (n,) side by side, shape (n, k)."""
    return np.concatenate(values).reshape(len(values), -1).T

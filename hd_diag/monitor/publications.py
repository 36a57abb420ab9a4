"""What leaves a monitor: angles, per-tooth arrays, drawings and diagnostics. Times: int64 [ns]."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from hd_diag.arrays import Floats, Integers, Times
from hd_diag.drive import Drive
from hd_diag.monitor.comparison import Errors
from hd_diag.streams.alignment import Aligned, kernel

PREDICTED = "~/transmission_error"
MEASURED = "~/measured_transmission_error"
RESIDUAL = "~/residual"


class Angles(NamedTuple):
    """Angles to publish: topic, time of the cause [ns] (n,), stamp [ns] (n,), names (k), values (n, k)."""

    topic: str
    received: Times
    stamp: Times
    names: tuple[str, ...]
    position: Floats
    effort: Floats | None


class ToothArrays(NamedTuple):
    """Per-tooth values to publish: topic, time of the cause [ns] (n,), values (n, 2, Z_R), flanks (+, -)."""

    topic: str
    received: Times
    values: Floats


class Drawings(NamedTuple):
    """Gears to draw: topic, time of the cause [ns] (n,), and what a drawing shows.

    Stamps [ns] and input angles as reported [rad], (n,); forces on the flanks (n, 2, Z_R) [N]; torsion (n,)
    [rad]; the force that has the last colour [N].
    """

    topic: str
    received: Times
    stamp: Times
    joint: str
    drive: Drive
    input_angle: Floats
    load: Floats
    torsion: Floats
    full_scale: float


class Status(NamedTuple):
    """Diagnostics of one joint: level 0 (OK), 1 (WARN), 2 (ERROR), one line of text, and stable keys."""

    joint: str
    level: int
    message: str
    values: dict[str, str]

    @property
    def name(self) -> str:
        """As diagnostics call it."""
        return f"hd_diag: {self.joint}"


class Report(NamedTuple):
    """Diagnostics of all joints: topic, time of the cause [ns], header stamp [ns], silence of each [s]."""

    topic: str
    received: int
    stamp: int
    statuses: tuple[Status, ...]
    facts: Mapping[str, str] = {}
    silence: Mapping[str, float] = {}


Publication = Angles | ToothArrays | Drawings | Report


def angles(received: Times, errors: Errors, names: Sequence[str]) -> Iterator[Angles]:
    """Messages of transmission errors: joints with a sample at one stamp of one message share one.

    Of the times at which the messages arrived (n,) [ns] and the names of all joints. In each topic they have
    the order in which the messages one by one would give them.
    """
    samples = errors.samples
    columns = samples.row, samples.stamp, samples.paired, samples.joint, samples.output_angle
    chosen, bounds, compared, compared_bounds = kernel().messages(*columns)
    own = _Messages.of(received, samples, names, chosen, bounds)
    yield from own.angles(PREDICTED, errors.predicted, samples.torque)
    if chosen.size == compared.size == samples.row.size:
        both = own
    else:
        both = _Messages.of(received, samples, names, compared, compared_bounds)
    yield from both.angles(MEASURED, errors.measured)
    yield from both.angles(RESIDUAL, errors.residual)


class _Messages(NamedTuple):
    """Samples of some messages, None for all, and for each run of like messages what they have in common.

    That is: its first sample and the one after its last, times of the cause and stamps [ns], names of joints.
    """

    chosen: Integers | None
    runs: list[tuple[int, int, Times, Times, tuple[str, ...]]]

    @staticmethod
    def of(
        received: Times, samples: Aligned, names: Sequence[str], chosen: Integers, bounds: Integers
    ) -> _Messages:
        """Messages of the chosen samples; `bounds` as the kernel gives them."""
        row, stamp, joint, found = samples.row, samples.stamp, samples.joint, []
        is_whole = chosen.size == row.size
        if not is_whole:
            row, stamp, joint = row[chosen], stamp[chosen], joint[chosen]
        begins, widths = bounds.tolist()
        for begin, end, width in zip(begins, [*begins[1:], chosen.size], widths, strict=False):
            joints = tuple([names[j] for j in joint[begin : begin + width].tolist()])
            first = slice(begin, end, width)
            found.append((begin, end, received[row[first]], stamp[first], joints))
        return _Messages(None if is_whole else chosen, found)

    def angles(self, topic: str, position: Floats, effort: Floats | None = None) -> Iterator[Angles]:
        """Messages with a value of each sample (m,)."""
        if self.chosen is not None:
            position = position[self.chosen]
            effort = None if effort is None else effort[self.chosen]
        for begin, end, received, stamp, joints in self.runs:
            shape = stamp.size, len(joints)
            torque = None if effort is None else effort[begin:end].reshape(shape)
            yield Angles(topic, received, stamp, joints, position[begin:end].reshape(shape), torque)

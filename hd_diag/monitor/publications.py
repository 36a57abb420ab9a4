"""Outputs of a monitor: angles, per-tooth arrays, drawings and diagnostics. Times: int64 [ns]."""

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


class Stamps(NamedTuple):
    """Stamps of per-tooth arrays: topic, time of the cause [ns] (n,), stamp [ns] (n,), joint."""

    topic: str
    received: Times
    stamp: Times
    joint: str


class ToothArrays(NamedTuple):
    """Per-tooth values to publish: topic, time of the cause [ns] (n,), values (n, 2, Z_R), flanks (+, -)."""

    topic: str
    received: Times
    values: Floats


class Drawings(NamedTuple):
    """Gears to draw: topic, time of the cause [ns] (n,), and the content of each drawing.

    Stamps [ns] and input angles as reported [rad], (n,); forces on the flanks (n, sections, 2, Z_R) [N];
    torsion (n,) [rad]; `full_scale` is the force of the last colour [N].
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
        """Name of the joint in diagnostics."""
        return f"hd_diag: {self.joint}"


class Report(NamedTuple):
    """Diagnostics of all joints: topic, time of the cause [ns], header stamp [ns], silence of each [s]."""

    topic: str
    received: int
    stamp: int
    statuses: tuple[Status, ...]
    facts: Mapping[str, str] = {}
    silence: Mapping[str, float] = {}


Publication = Angles | Stamps | ToothArrays | Drawings | Report


def angles(received: Times, errors: Errors, names: Sequence[str]) -> Iterator[Angles]:
    """Messages of transmission errors; each topic has them in the order of the messages that caused them.

    Samples of one message with the same stamp share a published message. `received` are the times at which
    the causing messages arrived (n,) [ns], `names` those of all joints.
    """
    samples = errors.samples
    columns = samples.row, samples.stamp, samples.paired, samples.joint, samples.output_angle
    chosen, bounds, compared, compared_bounds = kernel().messages(*columns)
    own = both = _runs(received, samples, names, chosen, bounds)
    if not chosen.size == compared.size == samples.row.size:
        both = _runs(received, samples, names, compared, compared_bounds)
    for rows, head in own:
        yield Angles(PREDICTED, *head, errors.predicted[rows], samples.torque[rows])
    for topic, values in ((MEASURED, errors.measured), (RESIDUAL, errors.residual)):
        for rows, head in both:
            yield Angles(topic, *head, values[rows], None)


def _runs(
    received: Times, samples: Aligned, names: Sequence[str], chosen: Integers, bounds: Integers
) -> list[tuple[Integers, tuple[Times, Times, tuple[str, ...]]]]:
    """Chosen samples (messages, joints) of each run of messages with the same joints, and their heads.

    A head has times of the cause [ns], stamps [ns] and names of the joints. `bounds` are from the kernel.
    """
    found = []
    begins, widths = bounds.tolist()
    for begin, end, width in zip(begins, [*begins[1:], chosen.size], widths, strict=False):
        rows = chosen[begin:end].reshape(-1, width)
        first = rows[:, 0]
        joints = tuple([names[j] for j in samples.joint[rows[0]].tolist()])
        found.append((rows, (received[samples.row[first]], samples.stamp[first], joints)))
    return found

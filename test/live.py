"""Shared by tests of the running monitor: configurations, messages and outputs."""

import functools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hd_diag.config.configuration import Config, resolve
from hd_diag.messages.encoding import encode_joint_states
from hd_diag.messages.publications import Encoded
from hd_diag.model.torsion_map import TorsionMap
from hd_diag.replay.map_builder import map_of
from hd_diag.streams.columns import JointStates

RATIO = 100.0
START = 1_700_000_000_000_000_000  # [ns]
MS = 1_000_000  # [ns]


def parameters(*joints: str, **given: Any) -> dict[str, Any]:
    """Flat parameters of joints with the default drive; in names ``__`` stands for a dot."""
    own = {name.replace("__", "."): value for name, value in given.items()}
    return {"joints": list(joints or ("joint_1",)), **own}


def config(*joints: str, **given: Any) -> Config:
    return resolve(parameters(*joints, **given))


TWO = config("a", "b", array_rate=100.0, mesh_rate=30.0)
OTHER_TWO = config(
    "a", "b", array_rate=40.0, a__eccentricity__magnitude=7e-6, a__torque=-2.0, b__cup_compliance=1e-5
)


@functools.cache
def map_of_two() -> TorsionMap:
    """Map of either joint of `TWO`, which have the same drive."""
    return map_of(TWO.joints[0])


def states(
    names: Sequence[str],
    stamp: Sequence[int],
    position: Sequence[Sequence[float]] | None,
    effort: Sequence[Sequence[float]] | None = None,
    velocity: Sequence[Sequence[float]] | None = None,
) -> JointStates:
    """Joint states with one set of names."""
    columns = [
        None if v is None else np.array(v, np.float64).reshape(len(stamp), -1)
        for v in (position, velocity, effort)
    ]
    rows = np.arange(len(stamp), dtype=np.int64)
    return JointStates(rows, np.array(stamp, np.int64), tuple(names), "", *columns)


def message(stamp: int, position: Mapping[str, float], effort: Mapping[str, float] | None = None) -> bytes:
    """One JointState in CDR; missing efforts are nan, as broadcasters write them."""
    values = None if effort is None else [[effort.get(name, np.nan) for name in position]]
    return encode_joint_states(list(position), [stamp], [list(position.values())], None, values)[0].tobytes()


def sample(stamp: int, angle: float, output: float, torque: float, joint: str = "joint_1") -> bytes:
    """One JointState with all signals that a joint reports."""
    return message(stamp, {f"{joint}_motor": angle, joint: output}, {f"{joint}_motor": 0.0, joint: torque})


class Recording:
    """Sink of a session that keeps everything sent, by topic."""

    def __init__(self) -> None:
        self.all: list[Encoded] = []

    def __call__(self, encoded: Encoded) -> None:
        self.all.append(encoded)

    def topics(self) -> dict[str, list[tuple[int, bytes]]]:
        """Times [ns] and messages of each topic, in order."""
        found: dict[str, list[tuple[int, bytes]]] = {}
        for topic, _, received, rows in self.all:
            found.setdefault(topic, []).extend(zip(received.tolist(), map(bytes, rows), strict=True))
        return found


def with_log(path: object, *joints: str, **own: Any) -> dict[str, Any]:
    """Parameters of joints, twenty reports per second, and a log at a path; `own` are log parameters."""
    log = {f"log.{name}": value for name, value in own.items()}
    return {**parameters(*joints, diagnostics_rate=20.0), "log.path": str(path), **log}

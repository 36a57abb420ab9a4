"""A bag player on rclpy, like ``ros2 bag play --clock``, and the angles in a bag."""

import time
from collections.abc import Collection
from pathlib import Path
from typing import Any

from logs import messages_of
from rosgraph_msgs.msg import Clock
from running import Rig
from sensor_msgs.msg import JointState, Temperature

from hd_diag.bag import BagReader

CLASSES = {"sensor_msgs/msg/JointState": JointState, "sensor_msgs/msg/Temperature": Temperature}
SECOND = 1_000_000_000


class Player:
    """Plays the joint states and temperatures of a bag into a rig's namespace, with ``/clock``."""

    def __init__(self, rig: Rig, bag: Path) -> None:
        self._messages = [each for each in messages_of(bag) if each[1] in CLASSES]
        kinds = {topic: CLASSES[kind] for topic, kind, _, _ in self._messages}
        self._publishers: dict[str, Any] = {t: rig.publisher(t.lstrip("/"), k) for t, k in kinds.items()}
        self._clock = rig.publisher("clock", Clock)

    def play(self, rate: float, loops: int, dropped: Collection[int]) -> int:
        """Play repeatedly at a multiple of the bag's pace; return the number of messages published.

        `dropped` are the indices of messages that get lost on the way.
        """
        first, published = self._messages[0][-1], 0
        for _ in range(loops):
            begin = time.monotonic()
            for number, (topic, _, data, now) in enumerate(self._messages):
                time.sleep(max(0.0, begin + (now - first) / SECOND / rate - time.monotonic()))
                self._tick(now)
                if number not in dropped:
                    self._publishers[topic].publish(data)
                    published += 1
        return published

    def _tick(self, now: int) -> None:
        clock = Clock()
        clock.clock.sec, clock.clock.nanosec = divmod(now, SECOND)
        self._clock.publish(clock)


def angles(bag: Path, topic: str) -> list[tuple[int, tuple[float, ...]]]:
    """Stamp [ns], positions and efforts of every JointState of a topic, in order."""
    found: list[tuple[int, tuple[float, ...]]] = []
    with BagReader(bag) as reader:
        for batch in reader.batches([topic]):
            columns, rejected = reader.joint_states(batch)
            assert not rejected
            rows = []
            for states in columns:
                values = [v for v in (states.position, states.effort) if v is not None]
                for i, row in enumerate(states.row.tolist()):
                    rows.append((row, int(states.stamp[i]), tuple(float(x) for v in values for x in v[i])))
            found += [(stamp, given) for _, stamp, given in sorted(rows)]
    return found

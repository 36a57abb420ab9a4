"""Which faults in the joints' reports are new, and how the node's console announces them."""

from __future__ import annotations

import math
import time
from collections.abc import Hashable, Iterable, Sequence
from typing import Any

from hd_diag.formatting import visible
from hd_diag.monitor.publications import Status

OF_NO_JOINT = {"LOG_FAILED", "OK"}

_CALM = 5.0  # time without a fault after which the console calls it over [s]
_LONGEST = 500  # characters of a line


class Beginnings:
    """Finds new faults in joints' reports; a fault that returns within `pause` [s] is the same one."""

    def __init__(self, pause: float) -> None:
        self._pause = pause
        self._ended: dict[str, dict[Hashable, float]] = {}  # end by joint and fault; inf while it lasts

    def of(self, joint: str, found: Iterable[Hashable]) -> set[Hashable]:
        """The new ones among the faults in a joint's report."""
        now, reported, ended = time.monotonic(), {*found}, self._ended.setdefault(joint, {})
        begun = {each for each in reported if now - ended.get(each, -math.inf) > self._pause}
        ended.update({each: min(ended[each], now) for each in ended.keys() - reported})
        ended.update(dict.fromkeys(reported, math.inf))
        return begun

    def is_over(self, joint: str) -> bool:
        """Whether a joint has had no fault for longer than the pause."""
        last = max(self._ended.get(joint, {}).values(), default=-math.inf)
        return time.monotonic() - last > self._pause


class Console:
    """Prints in the node's output when a joint gets a new or a worse fault, and when it has none again."""

    def __init__(self, logger: Any) -> None:
        self._logger, self._begun = logger, Beginnings(_CALM)
        self._told: set[str] = set()  # joints whose fault was announced

    def follow(self, statuses: Sequence[Status]) -> None:
        """Announce what a report changes."""
        for joint, level, message, values in statuses:
            code = values["fault_code"]
            levels = range(1, level + 1) if code not in OF_NO_JOINT else ()
            if self._begun.of(joint, [(code, each) for each in levels]):
                self._told.add(joint)
                self._say(level, f"{joint}: {code}: {message}")
            elif joint in self._told and self._begun.is_over(joint):
                self._told.remove(joint)
                self._logger.info(f"{joint}: OK, no fault for {_CALM:g} s")

    def _say(self, level: int, text: str) -> None:
        if level > 1:  # two calls: rclpy raises if one call changes its severity
            self._logger.error(visible(text, _LONGEST))
        else:
            self._logger.warning(visible(text, _LONGEST))

"""Faults of the joints' reports that begin: which are new, and what the node's console says of them."""

from __future__ import annotations

import math
import time
from collections.abc import Hashable, Iterable, Sequence
from typing import Any

from hd_diag.formatting import visible
from hd_diag.monitor.publications import Status

OF_NO_JOINT = {"LOG_FAILED", "OK"}

_CALM = 5.0  # without a fault, after which the console takes it for over [s]
_LONGEST = 500  # characters of a line


class Beginnings:
    """Which of what joints report begins; what comes back within some time [s] is the same that goes on."""

    def __init__(self, pause: float) -> None:
        self._pause = pause
        self._ended: dict[str, dict[Hashable, float]] = {}  # of each joint and fault; infinity while it lasts

    def of(self, joint: str, found: Iterable[Hashable]) -> set[Hashable]:
        """What begins, of all that a report of a joint has."""
        now, reported, ended = time.monotonic(), {*found}, self._ended.setdefault(joint, {})
        begun = {each for each in reported if now - ended.get(each, -math.inf) > self._pause}
        ended.update({each: min(ended[each], now) for each in ended.keys() - reported})
        ended.update(dict.fromkeys(reported, math.inf))
        return begun

    def is_over(self, joint: str) -> bool:
        """Whether nothing of a joint lasts, or could still come back as the same."""
        last = max(self._ended.get(joint, {}).values(), default=-math.inf)
        return time.monotonic() - last > self._pause


class Console:
    """Says in a node's output when a joint has a fault, another or a worse one, and when it has none."""

    def __init__(self, logger: Any) -> None:
        self._logger, self._begun = logger, Beginnings(_CALM)
        self._told: set[str] = set()  # joints whose fault was said

    def follow(self, statuses: Sequence[Status]) -> None:
        """Look at a report."""
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
        if level > 1:  # each severity needs a line of its own, or rclpy raises
            self._logger.error(visible(text, _LONGEST))
        else:
            self._logger.warning(visible(text, _LONGEST))

"""Sequence numbers of messages: they identify a message and show how many are missing."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

Identity = tuple[int, int]
"""Time of a publication [ns] and its sequence number: together unique on a topic."""

_NEW = 2.0  # time after finding a publisher within which a jump may be its first message [s]
_BEGUN = 500  # a publisher first heard at a number up to this has just begun: half a second at 1 kHz


def identity(info: Mapping[str, Any]) -> Identity | None:
    """Identity of a message from its info; None if the middleware gives no sequence numbers."""
    number = info["publication_sequence_number"]
    return None if number is None else (info["source_timestamp"], number)


class Missing:
    """Counts missing messages from the sequence numbers of the received ones.

    A publisher numbers its messages and they come in order, so a jump is a loss. A message does not name its
    publisher: a number continues from the nearest lower one. Losses before the first message are unknown.
    """

    def __init__(self) -> None:
        self.count = 0
        self._last: list[int] = []  # last number of each publisher, the most recent at the end
        self._publishers = self._new = 0
        self._found = 0.0

    def publishers(self, count: int) -> None:
        """Set the number of known publishers."""
        if count > self._publishers:
            self._new += count - self._publishers
            self._found = time.monotonic()
        self._publishers = count

    def follows(self, number: int) -> bool:
        """Whether a number directly follows a publisher's last one."""
        return number - 1 in self._last

    def withheld(self, number: int) -> None:
        """Count a message with this number as lost, because the reliable reader withheld it.

        If nothing of its publisher was taken yet, the one before counts too, or all if it has just begun.
        """
        self._new = 0
        if not any(before < number for before in self._last):
            self._last.append(number - 2 if number > _BEGUN else 0)
        self.take(number)
        self.count += 1

    def take(self, number: int) -> None:
        """Register a received message by its number."""
        lower = [number - 1] if self.follows(number) else [last for last in self._last if last < number]
        before = max(lower, default=None)
        jump = 0 if before is None else number - before - 1
        if before is None or (jump and self._new > 0 and time.monotonic() - self._found < _NEW):
            self._new, jump = max(self._new - 1, -1), 0  # -1: the message came before its publisher was known
        else:
            self._last.remove(before)
        self._last = [*self._last, number][-max(self._publishers, 1) :]
        self.count += jump

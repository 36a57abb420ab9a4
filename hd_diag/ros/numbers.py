"""Numbers that publishers give their messages: which message it is, and how many are missing."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

Identity = tuple[int, int]
"""Time of a publication [ns], and its number: no two of a topic have both."""

_NEW = 2.0  # time after a publisher was found in which its first message is no jump of another [s]
_BEGUN = 500  # a publisher first heard at a lower number has begun since: half a second of 1 kHz


def identity(info: Mapping[str, Any]) -> Identity | None:
    """Which message it is, by what came with it; None where an implementation gives no numbers."""
    number = info["publication_sequence_number"]
    return None if number is None else (info["source_timestamp"], number)


class Missing:
    """How many messages are missing, by the numbers of those that came.

    A publisher counts its messages and they come in order, so a jump is a loss. Which publisher a message is
    of is not given: a number goes on from the nearest below it. What is before a first one is not known.
    """

    def __init__(self) -> None:
        self.count = 0
        self._last: list[int] = []  # of each publisher, the one that came last at the end
        self._publishers = self._new = 0
        self._found = 0.0

    def publishers(self, count: int) -> None:
        """So many publishers are known now."""
        if count > self._publishers:
            self._new += count - self._publishers
            self._found = time.monotonic()
        self._publishers = count

    def follows(self, number: int) -> bool:
        """Whether it is the next of a publisher."""
        return number - 1 in self._last

    def withheld(self, number: int) -> None:
        """A message with this number is lost, which its publisher's reader withheld.

        If that publisher has given nothing yet, one before is lost too, or all where it has just begun.
        """
        self._new = 0
        if not any(before < number for before in self._last):
            self._last.append(number - 2 if number > _BEGUN else 0)
        self.take(number)
        self.count += 1

    def take(self, number: int) -> None:
        """Take a message by its number."""
        lower = [number - 1] if self.follows(number) else [last for last in self._last if last < number]
        before = max(lower, default=None)
        jump = 0 if before is None else number - before - 1
        if before is None or (jump and self._new > 0 and time.monotonic() - self._found < _NEW):
            self._new, jump = max(self._new - 1, -1), 0  # -1: it came before its publisher was known
        else:
            self._last.remove(before)
        self._last = [*self._last, number][-max(self._publishers, 1) :]
        self.count += jump

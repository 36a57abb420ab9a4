"""Finds messages that arrive but are withheld by a reliable subscription.

Fast DDS asks again for a message that it cannot read, such as one without a payload, for as long as its
publisher keeps it. Until then a reliable reader silently withholds all later messages. A best-effort reader
delivers them, so it shows whether messages arrive while a subscription is silent.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence

from rclpy.node import Node

from hd_diag.ros.numbers import Identity, identity
from hd_diag.ros.second_reader import SecondReader
from hd_diag.ros.subscriptions import SignalInput

_SILENT = 0.2  # silence of a topic after which the best-effort reader looks [s]
_MISSED = 1.0, 6.0  # the same of a joint, whose topic others may use too: from, to [s]
# Time after which an arrived message counts as withheld [s]: a message lost on the way is sent again after
# the publisher's next heartbeat, which Fast DDS sends every 3 s.
_WITHHELD = 3.5
_KEPT = 5.0  # the reader is kept so long after a silence: slow topics have many [s]
_DEPTH = 10  # messages that the reader holds, if they are small


class _Beside:
    """Messages that have arrived but were not delivered by a subscription, with their arrival times."""

    def __init__(self, node: Node, taken: SignalInput) -> None:
        self._node, self._taken = node, taken
        self._reader: SecondReader | None = None
        self._arrived: dict[Identity, float] = {}
        self._needed = -math.inf

    def look(self, missed: bool) -> None:
        """See `Withheld.look`; `missed`: a joint is silent, though its topic may not be."""
        now = time.monotonic()
        wanted = missed or now - self._taken.heard > _SILENT
        self._needed = now if wanted else self._needed
        if now - self._needed > _KEPT:
            self.close()
            return
        if self._reader is None:
            self._reader = SecondReader(self._node, "_hd_diag_beside", self._taken, _DEPTH)
        own = [identity(info) for _, info in self._reader.take()] if wanted else []
        arrived = self._arrived | {each: now for each in own if each is not None} if wanted else {}
        given = set(self._taken.given) if arrived else set()
        self._arrived = {each: since for each, since in arrived.items() if each not in given}
        if now - min(self._arrived.values(), default=now) > _WITHHELD:
            self._taken.begin_anew(number for _, number in self._arrived)
            self._arrived.clear()

    def close(self) -> None:
        """Stop looking."""
        if self._reader is not None:
            self._reader.close()
        self._reader = None
        self._arrived.clear()


class Withheld:
    """Finds subscriptions of a node that withhold messages, and renews them."""

    def __init__(self, node: Node, inputs: Sequence[SignalInput]) -> None:
        self._beside = [_Beside(node, each) for each in inputs]

    def look(self, silences: Sequence[float]) -> None:
        """Check all subscriptions; `silences` are the times without samples of the joints [s]."""
        begin, end = _MISSED
        for each in self._beside:
            each.look(any(begin < silence < end for silence in silences))

    def close(self) -> None:
        """Stop looking."""
        for each in self._beside:
            each.close()

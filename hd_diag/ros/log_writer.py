"""The node's log: everything that went in and came out, and every event on which the outputs depend."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from hd_diag.bag import BagError, BagWriter, LogFolder, Qos, Retention
from hd_diag.config.configuration import LogConfig
from hd_diag.formatting import visible
from hd_diag.messages.schemas import Definition

# Time from a failure to the next attempt [s]: it doubles, and begins anew after a log that lasted.
_SHORTEST, _LONGEST, _LASTING = 1.0, 30.0, 60.0
_PARTS = 10  # into which a log is cut at least that may not grow beyond a size or an age


class LogWriter:
    """A log that never stops its owner: what goes wrong with it is shown by `state`, and it goes on later.

    It needs the definitions of types that ROS 2 Jazzy does not have, by name. The state is ``off``, ``writing
    PATH`` or ``failed: REASON``. Each log is a new one; with `overwrite` it has a fixed name, and one that
    exists is replaced at the start alone: what lies there later may be another's.
    """

    def __init__(self, config: LogConfig, definitions: Mapping[str, Definition] | None = None) -> None:
        self._config, self._definitions = config, definitions or {}
        self._folder = LogFolder(Path(config.path), config.overwrite)
        self._size = math.ceil(_shortest(config.split_size, config.max_size / _PARTS))
        self._duration = _shortest(config.split_duration, config.max_age / _PARTS)
        most = config.max_size and max(1, config.max_size - self._size)
        self._retention = Retention(self._folder, most, config.max_age)
        self.state = "off"
        self._writer: BagWriter | None = None
        self._given = 0
        self._again_at, self._pause, self._began = math.inf, 0.0, time.monotonic()
        if config.path:
            self._attempt(lambda: self._begin(config.overwrite))

    @property
    def facts(self) -> dict[str, str]:
        """For the diagnostics: the state, messages lost because it failed, why old files stay too long."""
        written = sum(self._writer.counts.values()) if self._writer else 0
        lost = str(self._given - written)
        return {"log_state": self.state, "log_lost": lost, "log_warning": self._retention.problem}

    def write(self, topic: str, type_name: str, data: bytes, time: int, qos: Qos | None = None) -> None:
        """Write one message, received or caused at a time [ns]."""
        if not self._config.path:
            return
        self._given += 1
        writer, known = self._writer, self._definitions.get(type_name)
        if writer is not None and self._again_at == math.inf:
            self._attempt(lambda: writer.write(topic, type_name, data, time, qos=qos, known=known))

    def write_output(self, topic: str, type_name: str, data: bytes, time: int) -> None:
        """Write one message that others get too, unless the log is for what a replay needs alone."""
        if self._config.topics == "all":
            self.write(topic, type_name, data, time)

    def flush_if_due(self) -> bool:
        """Write what has waited for the flush period; True where logging goes on in a new file."""
        if self._config.path:
            self._attempt(lambda: self._retention.look(self._writer, time.monotonic()))
        if self._again_at == math.inf:
            if self._writer is not None:
                self._attempt(self._writer.flush_if_due)
            return False
        if time.monotonic() >= self._again_at:
            self._attempt(self._go_on)
        return self._again_at == math.inf

    def split_if_due(self, now: int) -> bool:
        """Go on in a new file if this one is large or, at a log time [ns], long enough; True if so.

        Its owner then writes all that a replay of it needs.
        """
        writer = self._writer
        if (
            writer is None
            or self._again_at < math.inf
            or not writer.has_reached(self._size, self._duration, now)
        ):
            return False
        self._attempt(writer.split)
        self._attempt(lambda: self._retention.look(writer, time.monotonic(), at_once=True))
        return self._again_at == math.inf

    def close(self) -> None:
        """Finish the file."""
        if self._writer is not None:
            if self._again_at == math.inf:
                self.state = "off"
            self._attempt(self._writer.close)
        self._retention.close()
        self._config, self._writer, self._again_at = LogConfig(), None, math.inf

    def _begin(self, overwrite: bool) -> None:
        config = self._config
        self._writer = BagWriter(
            self._folder.bag(),
            compression=config.compression,
            flush_period=config.flush_period,
            sync_period=config.sync_period,
            overwrite=overwrite,
        )
        self.state = f"writing {visible(str(self._writer.path))}"

    def _go_on(self) -> None:
        if self._writer is None:
            self._begin(overwrite=False)
        else:
            self._writer.resume()
            self.state = f"writing {visible(str(self._writer.paths[-1]))}"
        self._again_at, self._began = math.inf, time.monotonic()

    def _attempt(self, action: Callable[[], object]) -> None:
        try:
            action()
        except (BagError, ValueError, OSError) as error:
            now = time.monotonic()
            lasted = self._again_at == math.inf and now - self._began > _LASTING
            self._pause = _SHORTEST if lasted or not self._pause else min(2.0 * self._pause, _LONGEST)
            self._again_at = now + self._pause
            self.state = f"failed: {visible(str(error))}"


def _shortest(*limits: float) -> float:
    """The least of those that are limits, 0 where none is."""
    return min((limit for limit in limits if limit), default=0)

"""The node's log: everything that went in and came out, and every event that the outputs depend on."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from hd_diag.bag import BagError, BagWriter, LogFolder, Memory, Qos, Received, Retention
from hd_diag.config.configuration import LogConfig
from hd_diag.formatting import visible
from hd_diag.messages.schemas import Definition

# Time from a failure to the next attempt [s]: it doubles, and starts again after a log that lasted.
_SHORTEST, _LONGEST, _LASTING = 1.0, 30.0, 60.0
_POURING = 0.01  # longest that the memory is written at once [s]
_PARTS = 10  # least number of files of a log that has a largest size or age


class LogWriter:
    """A log that never stops its owner: what goes wrong with it is shown by `state`, and it goes on later.

    It needs the definitions of types that ROS 2 Jazzy does not have, by name. The state is ``off``, ``keeping
    the last ... s``, ``writing PATH`` or ``failed: REASON``. Each recording is a bag; with `overwrite` the
    first has a fixed name, and one that exists is replaced at the start alone: what lies there later may be
    another's. `bags` are those of this start.

    In the mode ``snapshot`` a recording begins with what the memory holds. It is written little by little,
    and what comes meanwhile waits behind it.
    """

    def __init__(self, config: LogConfig, definitions: Mapping[str, Definition] | None = None) -> None:
        self._config, self._definitions = config, definitions or {}
        self._folder = LogFolder(Path(config.path), config.overwrite)
        self._size = math.ceil(_shortest(config.split_size, config.max_size / _PARTS))
        self._duration = _shortest(config.split_duration, config.max_age / _PARTS)
        most = config.max_size and max(1, config.max_size - self._size)
        self._retention = Retention(self._folder, most, config.max_age)
        self._memory = Memory(config.before if config.mode == "snapshot" else 0.0, config.memory)
        self._idle = f"keeping the last {config.before:g} s" if config.mode == "snapshot" else "off"
        self.state = self._idle if config.path else "off"
        self.bags: list[Path] = []
        self._with_input: dict[Path, None] = {}  # files in which something received stands, in order
        self._has_input = False  # the open one
        self._writer: BagWriter | None = None
        self._until = -math.inf  # end of the recording, if there is one
        self._given = self._lost = 0
        self._again_at, self._pause, self._began = math.inf, 0.0, time.monotonic()
        if config.path and config.mode == "continuous":
            self._until = math.inf
            self._attempt(lambda: self._begin(config.overwrite))

    @property
    def facts(self) -> dict[str, str]:
        """For the diagnostics: the state, messages lost because it failed, why old files stay too long."""
        written = sum(self._writer.counts.values()) if self._writer else 0
        return {
            "log_state": self.state,
            "log_lost": str(self._lost + self._given - written),
            "log_warning": self._retention.problem,
            "log_memory_s": f"{self._memory.seconds:.1f}",
            "log_memory_bytes": str(self._memory.size),
        }

    @property
    def is_recording(self) -> bool:
        """Whether messages are written, or would be if the log had not failed."""
        return self._until > -math.inf

    @property
    def will_end(self) -> bool:
        """Whether what is being written will be whole soon: a snapshot, or what the memory held."""
        return self.is_recording and (bool(self._memory) or self._until < math.inf)

    def record(self, seconds: float = math.inf) -> bool:
        """Write from the memory's beginning, or else from now on, for some seconds at least.

        True where the owner then writes all that a replay needs. BagError where there is no place for it.
        """
        if not self._config.path:
            raise BagError("log.path", "is empty: there is no place for a log")
        was, self._until = self.is_recording, max(self._until, time.monotonic() + seconds)
        if not was:
            self._attempt(lambda: self._begin(self._config.overwrite and not self.bags))
        return not was and not self._memory

    def stop(self) -> None:
        """End the recording, once what the memory held is written."""
        if self.is_recording:
            self._until = time.monotonic()

    def write(self, topic: str, type_name: str, data: bytes, time: int, qos: Qos | None = None) -> None:
        """Write one message, received or caused at a time [ns]."""
        self.write_some(topic, type_name, [data], [time], qos)

    def write_some(
        self,
        topic: str,
        type_name: str,
        rows: Sequence[bytes],
        times: Sequence[int],
        qos: Qos | None = None,
    ) -> None:
        """Write messages of one topic that are taken together, each with its own time, as `write`."""
        if self._memory or not self.is_recording:
            for data, at in zip(rows, times, strict=True):
                self._keep(Received(topic, type_name, data, at, qos))
        elif self._config.path:
            self._write(topic, type_name, rows, times, qos)

    def _keep(self, message: Received) -> None:
        """Put it into the memory; what gives way there is lost to a recording that has begun."""
        gone = self._memory.put(message)
        if gone and self.is_recording:
            self._lost += gone
            if not self._memory and self._again_at == math.inf:  # what comes next needs a new beginning
                self._attempt(self._overflow)

    def _overflow(self) -> None:
        raise BagError("log.memory", "is too small for what came while a snapshot was written")

    def _write(
        self, topic: str, type_name: str, rows: Sequence[bytes], times: Sequence[int], qos: Qos | None
    ) -> None:
        self._given += len(rows)
        if qos is not None and not self._has_input and self._writer is not None:
            self._with_input[self._writer.paths[-1]] = None
            self._has_input = True
        writer, known = self._writer, self._definitions.get(type_name)
        if writer is not None and self._again_at == math.inf:
            self._attempt(lambda: writer.write_some(topic, type_name, rows, times, qos, known))

    def write_outputs(self, topic: str, type_name: str, rows: Sequence[bytes], times: Sequence[int]) -> None:
        """Write messages that others get too, unless the log is for what a replay needs alone."""
        if self._config.topics == "all":
            self.write_some(topic, type_name, rows, times)

    def flush_if_due(self) -> bool:
        """Write what has waited for the flush period; True where logging goes on in a new file."""
        if self._config.path:
            self._attempt(lambda: self._retention.look(self._writer, time.monotonic()))
        if self._again_at == math.inf:
            if self._writer is not None:
                self._pour()
                self._attempt(self._writer.flush_if_due)
            return self._has_ended()
        if self._has_ended():
            return True
        if self.is_recording and time.monotonic() >= self._again_at:
            self._attempt(self._go_on)
        return self._again_at == math.inf and not self._memory

    def split_if_due(self, now: int, at_once: bool = False) -> bool:
        """Go on in a new file, or part of the memory, if this one is large or, at a log time [ns], long.

        If True, its owner then writes all that a replay of it needs.
        """
        if not self.is_recording:
            is_due = self._config.mode == "snapshot" and bool(self._config.path) and self._memory.is_due(now)
            if is_due:
                self._memory.begin_part(now)
            return is_due
        writer = self._writer
        if writer is None or self._again_at < math.inf or self._memory:
            return False
        if not at_once and not writer.has_reached(self._size, self._duration, now):
            return False
        self._has_input = False
        self._attempt(writer.split)
        self._attempt(lambda: self._retention.look(writer, time.monotonic(), at_once=True))
        return self._again_at == math.inf

    def finished(self, since: float) -> list[Path]:
        """Files of this start that hold inputs, are finished, and changed after a time [s since 1970]."""
        open_file = self._writer.paths[-1] if self._writer is not None else None
        found, others = [], {open_file, *self._retention.going}
        for file in self._with_input:
            with suppress(OSError):  # it may have been deleted
                found += [file] if file not in others and file.stat().st_mtime >= since else []
        self._with_input = dict.fromkeys(found) | ({open_file: None} if self._has_input and open_file else {})
        return found

    def close(self) -> None:
        """Finish the file, with what the memory holds where a recording has begun."""
        while self.is_recording and self._memory and self._again_at == math.inf:
            self._pour()
        self._close()
        self._retention.close()
        self._config, self.state = LogConfig(), "off" if self.state == self._idle else self.state

    def _close(self) -> None:
        if self._writer is not None:
            if self._again_at == math.inf:
                self.state = self._idle
            self._attempt(self._writer.close)
            self._lost += self._given - sum(self._writer.counts.values())
        self._given, self._writer, self._again_at, self._until = 0, None, math.inf, -math.inf
        self._has_input = False

    def _has_ended(self) -> bool:
        """End the recording where it is time; True where the memory begins again."""
        if not self.is_recording or self._memory or time.monotonic() < self._until:
            return False
        self._close()
        if self._config.mode == "snapshot":
            self._memory.begin_part(time.time_ns())
        return bool(self._memory)

    def _pour(self) -> None:
        """Write a part of what the memory holds."""
        end = time.monotonic() + _POURING
        while self._memory and self._again_at == math.inf and time.monotonic() < end:
            for topic, type_name, data, at, qos in self._memory.take():
                self._write(topic, type_name, [data], [at], qos)

    def _begin(self, overwrite: bool) -> None:
        config = self._config
        self._writer = BagWriter(
            self._folder.bag() if overwrite or not self.bags else LogFolder(self._folder.path).bag(),
            compression=config.compression,
            flush_period=config.flush_period,
            sync_period=config.sync_period,
            overwrite=overwrite,
        )
        self.bags.append(self._writer.path)
        self.state = f"writing {visible(str(self._writer.path))}"

    def _go_on(self) -> None:
        if self._writer is None:
            self._begin(overwrite=False)
        else:
            self._has_input = False
            self._writer.resume()
            self.state = f"writing {visible(str(self._writer.paths[-1]))}"
            if self._memory:
                self._lost += self._memory.drop()  # the new file begins where a replay can
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

"""The node's log: its inputs, its outputs, and every event that the outputs depend on."""

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

# Pause after a failure [s]: it doubles from the shortest to the longest; a log that lasts resets it.
_SHORTEST, _LONGEST, _LASTING = 1.0, 30.0, 60.0
_POURING = 0.01  # longest time spent at once on writing the memory [s]
_PARTS = 10  # least number of files within a log's size or age limit


class LogWriter:
    """A log that never stops its owner: `state` shows a failure, and the log continues later.

    `definitions` are those of types that ROS 2 Jazzy lacks, by name. The state is ``off``, ``keeping the last
    ... s``, ``writing PATH`` or ``failed: REASON``. Each recording is a bag. With `overwrite` the first bag
    has a fixed name; an existing bag is replaced only at the start, because a later one may be somebody
    else's. `bags` are those written since the start.

    In the mode ``snapshot`` a recording begins with the memory's messages. They are written little by little;
    new messages wait behind them.
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
        self._with_input: dict[Path, None] = {}  # files that hold received messages, in order
        self._has_input = False  # whether the open file is one of them
        self._writer: BagWriter | None = None
        self._until = -math.inf  # end of the recording; -inf without one
        self._given = self._lost = 0
        self._again_at, self._pause, self._began = math.inf, 0.0, time.monotonic()
        if config.path and config.mode == "continuous":
            self._until = math.inf
            self._attempt(lambda: self._begin(config.overwrite))

    @property
    def facts(self) -> dict[str, str]:
        """For the diagnostics: state, messages lost by failures, why old files stay too long, memory used."""
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
        """Whether the recording is soon complete: it has an end, or the memory is still being written."""
        return self.is_recording and (bool(self._memory) or self._until < math.inf)

    def record(self, seconds: float = math.inf) -> bool:
        """Record for at least some seconds, from the memory's beginning or, if it is empty, from now on.

        If True, the owner must then write all that a replay needs. BagError if no path is configured.
        """
        if not self._config.path:
            raise BagError("log.path", "is empty: there is no place for a log")
        was, self._until = self.is_recording, max(self._until, time.monotonic() + seconds)
        if not was:
            self._attempt(lambda: self._begin(self._config.overwrite and not self.bags))
        return not was and not self._memory

    def stop(self) -> None:
        """End the recording once the memory is written."""
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
        """Write messages of one topic at once, each with its own time [ns]."""
        if self._memory or not self.is_recording:
            for data, at in zip(rows, times, strict=True):
                self._keep(Received(topic, type_name, data, at, qos))
        elif self._config.path:
            self._write(topic, type_name, rows, times, qos)

    def _keep(self, message: Received) -> None:
        """Put a message into the memory. During a recording, messages that give way to it are lost."""
        gone = self._memory.put(message)
        if gone and self.is_recording:
            self._lost += gone
            if not self._memory and self._again_at == math.inf:  # fail, to begin a new file later
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
        """Write published messages, unless the log holds only what a replay needs."""
        if self._config.topics == "all":
            self.write_some(topic, type_name, rows, times)

    def flush_if_due(self) -> bool:
        """Write messages older than the flush period; True if logging begins again, in a file or memory."""
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
        """Begin a new file or memory part if the present one is too large or, at a log time [ns], too long.

        `at_once` begins a new file in any case. If True, the owner must then write all that its replay needs.
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
        """Finished files since the start that hold inputs and changed after a time [s since 1970]."""
        open_file = self._writer.paths[-1] if self._writer is not None else None
        found, others = [], {open_file, *self._retention.going}
        for file in self._with_input:
            with suppress(OSError):  # it may have been deleted
                found += [file] if file not in others and file.stat().st_mtime >= since else []
        self._with_input = dict.fromkeys(found) | ({open_file: None} if self._has_input and open_file else {})
        return found

    def close(self) -> None:
        """Finish the file; during a recording the memory is written first."""
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
        """End a recording that is due; True if the memory begins again."""
        if not self.is_recording or self._memory or time.monotonic() < self._until:
            return False
        self._close()
        if self._config.mode == "snapshot":
            self._memory.begin_part(time.time_ns())
        return bool(self._memory)

    def _pour(self) -> None:
        """Write a part of the memory."""
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
                self._lost += self._memory.drop()  # the new file must begin where a replay can
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
    """The least of the limits that are set; 0 if none is."""
    return min((limit for limit in limits if limit), default=0)

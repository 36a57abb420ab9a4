"""The node's log: everything that went in and came out, and every event on which the outputs depend."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from hd_diag.bag import BagError, BagWriter, Qos
from hd_diag.config.configuration import LogConfig
from hd_diag.messages.schemas import Definition


class LogWriter:
    """A log that never stops its owner: what goes wrong with the file turns it off and is shown by `state`.

    It needs the definitions of types that ROS 2 Jazzy does not have, by name. The state is ``off``, ``writing
    PATH`` or ``failed: REASON``.
    """

    def __init__(self, config: LogConfig, definitions: Mapping[str, Definition] | None = None) -> None:
        self.config = config
        self._definitions = definitions or {}
        self.state = "off"
        self._writer: BagWriter | None = None
        self._open()

    def write(self, topic: str, type_name: str, data: bytes, time: int, qos: Qos | None = None) -> None:
        """Write one message, received or caused at a time [ns]."""
        writer, known = self._writer, self._definitions.get(type_name)
        if writer is not None:
            self._attempt(lambda: writer.write(topic, type_name, data, time, qos=qos, known=known))

    def flush_if_due(self) -> None:
        """Hand the open chunk to the system where it has waited for the flush period."""
        if self._writer is not None:
            self._attempt(self._writer.flush_if_due)

    def configure(self, config: LogConfig) -> bool:
        """Go on as another configuration says, and give whether a log begins.

        It does at another path, and the old one is finished. Otherwise periods and sizes act at once, the
        compression from the next file on.
        """
        has_moved = config.path != self.config.path
        self.config = config
        if has_moved:
            self.close()
            self.state = "off"
            self._open()
        elif self._writer is not None:
            self._writer.change(**self._options())
        return has_moved

    def close(self) -> None:
        """Finish the file."""
        writer, self._writer = self._writer, None
        if writer is not None:
            self.state = "off"
            self._attempt(writer.close)

    def _open(self) -> None:
        config = self.config

        def begin() -> None:
            self._writer = BagWriter(config.path, overwrite=config.overwrite, **self._options())

        if config.path:
            self.state = f"writing {config.path}"
            self._attempt(begin)

    def _options(self) -> dict[str, Any]:
        """What of a log may change while it is written."""
        return {
            "compression": self.config.compression,
            "flush_period": self.config.flush_period,
            "max_size": self.config.split_size,
            "max_duration": self.config.split_duration,
        }

    def _attempt(self, action: Callable[[], object]) -> None:
        try:
            action()
        except (BagError, ValueError, OSError) as error:
            self.state = f"failed: {error}"
            writer, self._writer = self._writer, None
            if writer is not None:
                self._attempt(writer.close)

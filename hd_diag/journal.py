"""The node's log: everything that went in and came out, and every event on which the outputs depend."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hd_diag.bag import BagError, BagWriter, Qos
from hd_diag.config import LogConfig


class Journal:
    """A log that never stops its owner: what goes wrong with the file turns it off and is told by `state`.

    Parameters
    ----------
    config : LogConfig

    Attributes
    ----------
    state : str
        ``off``, ``writing PATH`` or ``failed: REASON``.
    """

    def __init__(self, config: LogConfig) -> None:
        self.config = config
        self.state = "off"
        self._writer: BagWriter | None = None
        if config.path:
            self._open()

    @property
    def is_open(self) -> bool:
        """Whether the log is being written."""
        return self._writer is not None

    def write(self, topic: str, type_name: str, data: bytes, time: int, qos: Qos | None = None) -> None:
        """Write one message, received or caused at a time [ns]."""
        if self._writer is None:
            return
        try:
            self._writer.write(topic, type_name, data, time, qos=qos)
        except (BagError, ValueError) as error:
            self._fail(error)

    def write_rows(self, topic: str, type_name: str, rows: npt.NDArray[np.uint8], times: npt.NDArray[np.int64]) -> None:
        """Write messages of constant size, shape (n, size), caused at times [ns] (n,)."""
        if self._writer is None:
            return
        try:
            self._writer.write_many(topic, type_name, rows, times)
        except (BagError, ValueError) as error:
            self._fail(error)

    def flush_if_due(self) -> None:
        """Hand the open chunk to the system where it has waited for the flush period."""
        if self._writer is None:
            return
        try:
            self._writer.flush_if_due()
        except BagError as error:
            self._fail(error)

    def close(self) -> None:
        """Finish the file."""
        if self._writer is not None:
            self._writer.close()
            if self._writer.error is not None:
                self.state = f"failed: {self._writer.error}"
            elif self.state.startswith("writing"):
                self.state = "off"
        self._writer = None

    def _open(self) -> None:
        config = self.config
        try:
            self._writer = BagWriter(
                config.path,
                compression=config.compression,
                flush_period=config.flush_period,
                max_size=config.split_size,
                max_duration=config.split_duration,
                overwrite=config.overwrite,
            )
        except (BagError, ValueError, OSError) as error:
            self._fail(error)
        else:
            self.state = f"writing {config.path}"

    def _fail(self, error: Exception) -> None:
        self.state = f"failed: {error}"
        if self._writer is not None:
            self._writer.close()
            self._writer = None

"""Where live results go: a picture that is drawn anew in a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
from types import TracebackType
from typing import TextIO, TypeVar

from rich.console import Console, RenderableType
from rich.live import Live
from rich.text import Text

_Kind = TypeVar("_Kind", bound="Terminal")


class Terminal:
    """A stream that shows a live picture, inside a ``with`` statement, where it is a terminal.

    Parameters
    ----------
    stream : file, optional
        stdout by default.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stdout
        self._console = Console(file=self._stream, highlight=False)
        is_live = self._stream.isatty() and not self._console.is_dumb_terminal
        self._live = Live(console=self._console, auto_refresh=False) if is_live else None

    @property
    def is_live(self) -> bool:
        """Whether pictures can be drawn; elsewhere there are lines only."""
        return self._live is not None

    @property
    def height(self) -> int:
        """Lines of the terminal."""
        return self._console.height

    def __enter__(self: _Kind) -> _Kind:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, exc: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.stop()

    def draw(self, picture: RenderableType) -> None:
        """Replace the live picture."""
        if self._live is not None:
            self._live.update(picture, refresh=True)

    def say(self, *lines: str) -> None:
        """Print lines, above the live picture where there is one; unknown characters are spelled out."""
        encoding = self._console.encoding
        for line in lines:
            text = line.encode(encoding, "backslashreplace").decode(encoding)
            if self._live is not None:
                self._console.print(Text(text), soft_wrap=True)
            else:  # not by rich, which ends the program where the reader of a pipe has gone
                self._stream.write(text + "\n")
        self._stream.flush()

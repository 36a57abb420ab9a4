"""What verbs print: lines and tables for people."""

from __future__ import annotations

import os
import shutil
import sys
from typing import TYPE_CHECKING, TextIO

import click

from hd_diag.formatting import visible

if TYPE_CHECKING:
    from rich.table import Table

_LONGEST = 2000  # characters of a line; a file may supply some of them
_WIDEST = 1000  # characters of a table in a pipe: rich wraps what is wider


def tell(line: str, *, err: bool = False) -> None:
    """Print one line, without control characters of files; on a terminal it breaks between words."""
    line, stream = visible(line, _LONGEST), sys.stderr if err else sys.stdout
    if stream.isatty():
        indent = " " * (len(line) - len(line.lstrip()))
        line = click.wrap_text(line.strip(), shutil.get_terminal_size().columns, indent, f"{indent}  ")
    show(f"{line}\n", err=err)


def show(text: str, *, err: bool = False) -> None:
    """Print text as it is. If its reader has gone (``head``), drop it and all that follows, and go on.

    The same holds if stderr cannot be written to: nobody can be told.
    """
    try:
        click.echo(text, nl=False, err=err)
    except OSError as error:
        if not (err or isinstance(error, BrokenPipeError)):
            raise
        discard_output(sys.stderr if err else sys.stdout)


def discard_output(stream: TextIO) -> None:
    """Send the remaining output of a stream to /dev/null."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def number_table(*columns: str, title: str | None = None) -> Table:
    """A table with the first column to the left and numbers to the right; such tables fit 80 columns."""
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for k, column in enumerate(columns):
        table.add_column(column, justify="right" if k else "left", no_wrap=True)
    return table


def show_table(table: Table) -> None:
    """Print a table without markup; in a pipe it is as wide as it needs, and no number is cut off."""
    from rich.console import Console

    console = Console(width=None if sys.stdout.isatty() else _WIDEST, highlight=False, markup=False)
    wide = console.options.update(max_width=_WIDEST)
    console.width = max(console.width, console.measure(table, options=wide).minimum)
    with console.capture() as text:  # rich would exit with 1 if nobody reads
        console.print(table)
    show(text.get())

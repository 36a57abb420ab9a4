"""What ``hd-diag recover`` takes, and its help."""

from __future__ import annotations

from pathlib import Path

import click

from hd_diag.cli import options


@options.verb("recover torn.mcap --out whole.mcap")
@click.argument("bag", type=options.Source(path_type=Path))
@options.BAG
@options.OVERWRITE
@options.JSON
def recover() -> None:
    """Save what can be read of an unfinished or damaged bag.

    Everything in closed chunks, and what can be read of the open one, is copied into a new bag. The new bag
    is read back. The command says what was saved and what was lost. Exit codes: 0 something was saved, even
    if not everything; 2 nothing can be saved; 130 after Ctrl-C, which leaves a valid file. After an error the
    output has no end, so that it never passes for complete. With --overwrite the old bag stays until the new
    one is complete.
    """

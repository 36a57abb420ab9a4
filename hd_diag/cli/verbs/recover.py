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
    """Save what can be saved of a bag that a crash left unfinished.

    Everything in closed chunks, and what can be read of the open one, is copied into a new bag and read back.
    Says what was saved and what was lost. Exit code 0 also where something was lost: losing is not this
    command's doing; 2 where nothing can be saved. Ctrl-C leaves a valid file and ends with code 130; after an
    error the output is left without its end. A bag that --overwrite replaces stays until the new one is
    whole.
    """

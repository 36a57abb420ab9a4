"""What ``hd-diag figures`` takes, and its help."""

from __future__ import annotations

from pathlib import Path

import click

from hd_diag.cli import options


@options.verb("figures --out figures --format png")
@click.option(
    "--out", required=True, type=click.Path(file_okay=False, path_type=Path), help="Folder for the files."
)
@options.CONFIG
@options.shown("--format", "svg", "Of the figures.", type=click.Choice(["svg", "png", "pdf"]))
def figures() -> None:
    """Draw the model's counterparts of the paper's Figs. 5, 6 and 7.

    For the first configured joint: the neutral layer's motion, backlash and load over the teeth, one tooth
    over time, for eccentricities from none to 23 µm. figures.md gets captions with the numbers that the
    paper's claims come to. Beside them drive.*: what is eccentric to what, positive directions, where teeth
    interfere.
    """

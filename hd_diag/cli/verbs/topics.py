"""What ``hd-diag topics`` takes, and its help."""

from __future__ import annotations

from pathlib import Path

import click

from hd_diag.cli import options


@options.verb("topics joint.mcap")
@click.argument("bag", type=options.Source(path_type=Path))
@options.JSON
def topics() -> None:
    """Say what is in a bag, what could be input, output and torque of a joint, and the mapping to paste.

    Angles that turn in proportion by a gear's ratio, or as two encoders of one joint, are an input with its
    output; what else has the joint's name or number is its torque, current or temperature. Units are guesses
    from names and jumps. The first 50 000 messages of each topic are looked at.
    """

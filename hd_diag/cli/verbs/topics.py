"""What ``hd-diag topics`` takes, and its help."""

from __future__ import annotations

from pathlib import Path

import click

from hd_diag.cli import options


@options.verb("topics joint.mcap")
@click.argument("bag", type=options.Source(path_type=Path))
@options.JSON
def topics() -> None:
    """List what is in a bag and propose the configuration of its joints, ready to paste.

    Two angles whose speeds have the ratio of a gear, or that look like two encoders of one joint, are
    proposed as input and output. Signals with the joint's name or number are its torque, current or
    temperature. Units are guessed from names and jumps. The first 50 000 messages of each topic are read.
    """

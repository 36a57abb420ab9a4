"""What ``hd-diag replay`` takes, and its help."""

from __future__ import annotations

from pathlib import Path

import click

from hd_diag.cli import options


@options.verb("replay log --out again.mcap")
@click.argument("bag", type=options.Source(path_type=Path))
@options.BAG
@click.option(
    "--config",
    "config_file",
    type=options.Source(dir_okay=False),
    help="ROS parameter file. [default: what the node's log holds]",
)
@click.option(
    "--topic",
    "topics",
    multiple=True,
    help="Topic with joint states; repeatable. [default: all but what a node published]",
)
@options.OVERWRITE
@options.JSON
def replay() -> None:
    """Run the model over a bag and write what the node would have published.

    Time is the bag's, computed as fast as possible. Without --config the bag must be a log of the node: its
    configuration and every change of it are followed, and the outputs equal those of the live run bit for
    bit. Reads MCAP files and rosbag2 folders (MCAP or sqlite3), also unfinished ones. If the bag has no
    sample of a joint, stderr says what the bag has, and the exit code is 2. Ctrl-C leaves a valid file and
    ends with code 130. After an error the output has no end, so that it never passes for complete. With
    --overwrite the old bag stays until the new one is complete.
    """

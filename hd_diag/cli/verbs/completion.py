"""What ``hd-diag completion`` takes, and its help."""

from __future__ import annotations

import click

from hd_diag.cli import options


@options.verb("completion bash")
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
def completion() -> None:
    """Print a script with which a shell completes commands, options and files.

    Write it where the shell looks. bash (4.4 or newer): ~/.local/share/bash-completion/completions/hd-diag;
    zsh: a file _hd-diag in a folder of $fpath; fish: ~/.config/fish/completions/hd-diag.fish. A new shell
    reads it.
    """

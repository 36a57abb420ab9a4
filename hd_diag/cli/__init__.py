"""The command line: one module per verb, listed in `verbs`."""

from hd_diag.cli.verbs import cli, main

__all__ = ["cli", "main"]

"""The command line as click has it: verbs, arguments, options."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from hd_diag.cli import cli


def content(folder: Path) -> dict[str, Any]:
    """What command_line.md is filled with."""
    context = click.Context(cli)
    names = cli.list_commands(context)
    return {"about": cli.help or "", "verbs": [_verb(name, cli.commands[name]) for name in names]}


def _verb(name: str, command: click.Command) -> dict[str, Any]:
    """Usage, help by paragraphs, options with their meaning: as `--help` says it."""
    context = click.Context(command, info_name=f"hd-diag {name}", parent=None, **command.context_settings)
    options = [option for option in command.get_params(context) if isinstance(option, click.Option)]
    return {
        "name": name,
        "usage": " ".join(command.collect_usage_pieces(context)),
        "help": (command.help or "").split("\n\n"),
        "example": (command.epilog or "").removeprefix("Example: "),
        "options": [record for option in options if (record := option.get_help_record(context))],
    }

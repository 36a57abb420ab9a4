"""The command line, from click's own description: command_line.md."""

from __future__ import annotations

import click

from hd_diag.cli import cli
from parts import plain, table


def about() -> str:
    """Help of the whole program."""
    return plain(cli.help or "")


def verbs() -> str:
    """A section for each verb: usage, example, help, options, as `--help` has them."""
    names = cli.list_commands(click.Context(cli))
    return "\n\n".join(_section(name, cli.commands[name]) for name in names)


def _section(name: str, command: click.Command) -> str:
    whole = click.Context(
        cli, info_name="hd-diag", **cli.context_settings
    )  # whose help options verbs inherit
    context = click.Context(command, info_name=name, parent=whole, **command.context_settings)
    usage = " ".join(["hd-diag", name, *command.collect_usage_pieces(context)])
    options = [option for option in command.get_params(context) if isinstance(option, click.Option)]
    records = [record for option in options if (record := option.get_help_record(context))]
    rows = [[f"`{option.replace('|', chr(92) + '|')}`", plain(meaning)] for option, meaning in records]
    example = (command.epilog or "").removeprefix("\b\nExample: ")
    paragraphs = [
        f"## {name}",
        f"```text\n{usage}\n```",
        f"```sh\n{example}\n```",
        *map(plain, (command.help or "").split("\n\n")),
        table(["option", "meaning"], rows),
    ]
    return "\n\n".join(paragraphs)

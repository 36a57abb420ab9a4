"""``hd-diag completion``: a script by which a shell asks ``hd-diag`` itself for completions."""

from __future__ import annotations

import click
from click.shell_completion import (
    BashComplete,
    FishComplete,
    ZshComplete,
    add_completion_class,
    get_completion_class,
)

_NAME = "hd-diag"


@add_completion_class
class _Bash(BashComplete):
    """bash passes the "=" of ``--config=name`` as a separate word, which click would take for the value."""

    def get_completion_args(self) -> tuple[list[str], str]:
        words, incomplete = super().get_completion_args()
        return [word for word in words if word != "="], incomplete


@add_completion_class
class _Zsh(ZshComplete):
    """zsh completes the whole of ``--config=name``: the option's name stays before the value."""

    source_template = ZshComplete.source_template.replace(
        "    local -a completions\n", "    compset -P '--*='\n    local -a completions\n", 1
    ).replace("compadd -U ", "compadd ")


@add_completion_class
class _Fish(FishComplete):
    """fish accepts completions that begin with the whole word, ``--config=name``."""

    source_template = FishComplete.source_template.replace(
        "\n    end;\nend;\n",
        "\n    end | string replace -r '^' -- (string match -r '^--[^=]*=' -- (commandline -t); or echo '')"
        ";\nend;\n",
        1,
    )


def completion(shell: str) -> None:
    """Run ``hd-diag completion``."""
    kind, group = get_completion_class(shell), click.get_current_context().find_root().command
    assert kind is not None  # the option only takes known shells
    # click looks for completion requests to this command in this variable.
    click.echo(kind(group, {}, _NAME, f"_{_NAME.replace('-', '_').upper()}_COMPLETE").source())

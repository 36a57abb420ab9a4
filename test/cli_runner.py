"""The command line run in this process, with stderr kept apart by every click that is supported."""

import inspect

from click.testing import CliRunner


def runner() -> CliRunner:
    """A runner whose results have a stderr of their own: click before 8.2 mixes unless told not to."""
    known = inspect.signature(CliRunner).parameters
    return CliRunner(mix_stderr=False) if "mix_stderr" in known else CliRunner()

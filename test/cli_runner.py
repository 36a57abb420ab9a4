"""The command line run in this process, with stderr kept apart by every click that is supported."""

import inspect

from click.testing import CliRunner, Result

from hd_diag.cli import cli


def runner() -> CliRunner:
    """A runner whose results have a stderr of their own: click before 8.2 mixes unless told not to."""
    known = inspect.signature(CliRunner).parameters
    return CliRunner(mix_stderr=False) if "mix_stderr" in known else CliRunner()


def hd_diag(*arguments: object) -> Result:
    """The whole command line with these arguments."""
    return runner().invoke(cli, [*map(str, arguments)])


def assert_one_line_error(result: Result, *parts: str) -> None:
    """Exit code 2, nothing on stdout, one line on stderr with these parts, not a traceback."""
    assert isinstance(result.exception, SystemExit)
    assert (result.exit_code, result.stdout) == (2, "")
    assert len(result.stderr.splitlines()) == 1
    assert result.stderr.startswith("hd-diag: ")
    for part in parts:
        assert part in result.stderr

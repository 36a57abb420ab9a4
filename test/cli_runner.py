"""The command line run in this process, with stderr kept apart by every click that is supported."""

import contextlib
import inspect
import resource
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from click.testing import CliRunner, Result

from hd_diag.cli import cli, progress
from hd_diag.config.configuration import dump, resolve

progress._PERIOD = 1e6  # [s]; a slow machine adds no lines of progress to what tests compare

ASSUMED = (
    "hd-diag: joint_1: without --config this is taken for the example drive, ratio 100, rated torque 56 N m; "
    "hd-diag gear writes a file for yours\n"
)
"""Last line of stderr where a record was judged without a configuration."""


def runner() -> CliRunner:
    """A runner whose results have a stderr of their own: click before 8.2 mixes unless told not to."""
    known = inspect.signature(CliRunner).parameters
    return CliRunner(mix_stderr=False) if "mix_stderr" in known else CliRunner()


def hd_diag(*arguments: object, **more: Any) -> Result:
    """The whole command line with these arguments."""
    return runner().invoke(cli, [*map(str, arguments)], **more)


def assert_one_line_error(result: Result, *parts: str) -> None:
    """Exit code 2, nothing on stdout, one line on stderr with these parts, not a traceback."""
    assert isinstance(result.exception, SystemExit)
    assert (result.exit_code, result.stdout) == (2, "")
    assert len(result.stderr.splitlines()) == 1
    assert "an error of hd-diag itself" not in result.stderr
    assert result.stderr.startswith("hd-diag: ")
    for part in parts:
        assert part in result.stderr


def config_file(folder: Path, **values: Any) -> Path:
    """A parameter file with some values of joint_1; double underscores for dots."""
    path = folder / "drive.yaml"
    path.write_text(dump(resolve({f"joint_1.{k.replace('__', '.')}": v for k, v in values.items()})))
    return path


@contextlib.contextmanager
def files_up_to(size: int) -> Iterator[None]:
    """The system ends a write at this size of a file [byte], as a full disk does."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)

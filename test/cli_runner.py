"""The command line run in this process; stderr is separate with every supported version of click."""

import contextlib
import inspect
import resource
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from click.testing import CliRunner, Result

from hd_diag.cli import cli, progress
from hd_diag.config.configuration import dump, resolve

progress._PERIOD = 1e6  # [s]; slow machines must not add progress lines to output that tests compare

ASSUMED = (
    "hd-diag: joint_1: without --config this is taken for the example drive, ratio 100, rated torque 56 N m; "
    "hd-diag gear writes a file for yours\n"
)
"""Last line of stderr if a record was judged without a configuration."""


def runner() -> CliRunner:
    """A runner whose results have a separate stderr; click before 8.2 mixes by default."""
    known = inspect.signature(CliRunner).parameters
    return CliRunner(mix_stderr=False) if "mix_stderr" in known else CliRunner()


def hd_diag(*arguments: object, **more: Any) -> Result:
    """Run the whole command line with these arguments."""
    return runner().invoke(cli, [*map(str, arguments)], **more)


def assert_one_line_error(result: Result, *parts: str) -> None:
    """Check for exit code 2, empty stdout, and one line on stderr with these parts and no traceback."""
    assert isinstance(result.exception, SystemExit)
    assert (result.exit_code, result.stdout) == (2, "")
    assert len(result.stderr.splitlines()) == 1
    assert "an error of hd-diag itself" not in result.stderr
    assert result.stderr.startswith("hd-diag: ")
    for part in parts:
        assert part in result.stderr


def config_file(folder: Path, **values: Any) -> Path:
    """Write a parameter file with some values of joint_1; in names ``__`` stands for a dot."""
    path = folder / "drive.yaml"
    path.write_text(dump(resolve({f"joint_1.{k.replace('__', '.')}": v for k, v in values.items()})))
    return path


@contextlib.contextmanager
def files_up_to(size: int) -> Iterator[None]:
    """Limit files to this size [byte]: the system ends a write there, as a full disk does."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)

"""What the verbs of the command line share: options, kinds of files, one-line errors.

Neither this nor :mod:`hd_diag.cli.verbs` imports more than click: help and completion come at once.
"""

from __future__ import annotations

import functools
import gc
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

import click

from hd_diag.cli.targets import Problem, check_targets

_Command = TypeVar("_Command", bound=Callable[..., Any])


class Source(click.Path):
    """A file or bag that a verb reads."""


class Target(click.Path):
    """A file that a verb writes; its name must have one of the `endings`, if there are any."""

    def __init__(self, *endings: str, folders: bool = False, stdout: bool = False) -> None:
        super().__init__(dir_okay=folders, allow_dash=stdout, path_type=str if stdout else Path)
        self._endings = endings

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The path, or a Problem if its name has another ending."""
        path = Path(value)
        is_special = path.exists() and not path.is_file()  # for a device or a pipe the ending says nothing
        if self._endings and path.suffix.lower() not in self._endings and not is_special:
            raise Problem(f"{value}: the name must end with {' or '.join(self._endings)}")
        return super().convert(value, param, ctx)


class BagTarget(Target):
    """A bag that a verb writes: a file, or a folder, which has no file ending."""

    def __init__(self) -> None:
        super().__init__(folders=True)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The path, or a Problem if its name is not that of a bag."""
        suffix = Path(value).suffix.lower()
        if suffix != ".mcap" and suffix[1:].isalnum() and suffix[1:2].isalpha() and not Path(value).is_dir():
            raise Problem(f"{value}: a bag is a file *.mcap, or a folder whose name has no ending")
        return super().convert(value, param, ctx)


def verb(example: str, module: str = "", **settings: Any) -> Callable[[Callable[..., Any]], click.Command]:
    """Decorate a function without a body: its name, docstring and options declare a verb.

    The function of the same name in ``hd_diag.cli.<module>`` (by default that of the verb's name) does the
    work and returns the exit code (None: 0). It is imported when the verb is called, after input and output
    files were compared. ConfigError and BagError become one line. Settings are those of click's context.
    """

    def made(stub: Callable[..., Any]) -> click.Command:
        name, line = stub.__name__, (stub.__doc__ or "").partition("\n")[0]

        @functools.wraps(stub)
        def run(**given: Any) -> Any:
            check_files()
            function = getattr(import_module(f"hd_diag.cli.{module or name}"), name)
            gc.freeze()  # objects of imports stay
            gc.enable()
            try:
                with warnings.catch_warnings():
                    if not sys.warnoptions:  # numpy's warnings do not help users, who see nan
                        warnings.simplefilter("ignore", RuntimeWarning)
                    return function(**given)
            except ValueError as error:
                raise _problem(error, "overwrite" in given) from error

        text = f"\b\nExample: hd-diag {example}"
        return click.command(epilog=text, short_help=line, context_settings=settings)(run)

    return made


def check_files(targets: Iterable[str | Path | None] | None = None, inputs: Iterable[Path] = ()) -> None:
    """Refuse, before the work, output files of the running verb that coincide with each other or an input.

    Without `targets`, those of the command line are checked. `inputs` are files that the verb reads beside
    those of the command line; later calls check against them too.
    """
    context = click.get_current_context(silent=True)
    if context is None:
        return
    read = context.meta.setdefault(f"{__name__}.read", [])
    read += inputs
    check_targets(_paths(context, Target) if targets is None else targets, *_paths(context, Source), *read)


def _paths(context: click.Context, kind: type[click.Path]) -> list[Path]:
    """The given paths of this kind."""
    values = [context.params[p.name] for p in context.command.params if isinstance(p.type, kind) and p.name]
    flat = [one for value in values for one in (value if isinstance(value, tuple) else (value,))]
    return [Path(one) for one in flat if one not in (None, "-")]


def _problem(error: ValueError, overwrites: bool) -> ValueError | Problem:
    """A Problem for errors of a configuration or a bag; any other error as it is."""
    from hd_diag.bag.errors import BagError
    from hd_diag.config.parameters import ConfigError

    if not isinstance(error, (BagError, ConfigError)):
        return error
    advice = ": --overwrite replaces it" if overwrites and str(error).endswith("exists already") else ""
    return Problem(f"{error}{advice}")


def shown(flag: str, default: Any, text: str, **more: Any) -> Callable[[_Command], _Command]:
    """An option whose default the help shows."""
    return click.option(flag, default=default, show_default=True, help=text, **more)


def together(*options: Callable[[Any], Any]) -> Callable[[_Command], _Command]:
    """Several options as one, in their order."""

    def decorated(stub: Any) -> Any:
        return functools.reduce(lambda found, option: option(found), reversed(options), stub)

    return decorated


def numbers(rows: Iterable[tuple[str, click.ParamType[Any], str]]) -> Callable[[_Command], _Command]:
    """Options for numbers, one for each name with its type and help."""
    return together(
        *(click.option(f"--{name.replace('_', '-')}", type=kind, help=text) for name, kind, text in rows)
    )


def json_option(what: str) -> Callable[[_Command], _Command]:
    """Option ``--json``; `what` names the content."""
    kind = Target(stdout=True)
    return click.option("--json", "json_file", type=kind, help=f"Write {what} here; - is stdout.")


def figure_option(what: str) -> Callable[[_Command], _Command]:
    """Option ``--figure``; `what` names the drawing."""
    text = f"Draw {what}: *.png, *.svg or *.pdf."
    return click.option("--figure", type=Target(".png", ".svg", ".pdf"), help=text)


PAGE = Target(".html", ".htm")
CONFIG = click.option(
    "--config",
    "config_file",
    type=Source(dir_okay=False),
    help="ROS parameter file. [default: the example drive]",
)
BAG = click.argument("bag", type=Source(path_type=Path))
JOINT = click.option("--joint", help="Joint. [default: the first configured]")
JOINTS = click.option("--joint", "names", multiple=True, help="Joint; repeatable. [default: all configured]")
OUT_BAG = click.option("--out", required=True, type=BagTarget(), help="*.mcap or a rosbag2 folder.")
OVERWRITE = click.option("--overwrite", is_flag=True, help="Replace an existing output.")
JOBS = click.option(
    "--jobs", type=click.IntRange(1), help="Processes on this machine. [default: one per core that is free]"
)
FAIL_ON_CAUSE = click.option(
    "--fail-on-cause", is_flag=True, help="Exit with code 1 if a cause or something unexplained is found."
)
JSON = json_option("the result")
TIME_LIMIT = shown(
    "--time-limit",
    60.0,
    "Limit of the computing time for each joint. The result says what was left out; the fit, the "
    "gain and the unexplained rest are never left out.",
    metavar="SECONDS",
    type=click.FloatRange(0.0),
)

records = together(
    click.argument("bags", nargs=-1, required=True, type=Source(path_type=Path)),
    CONFIG,
    JOINTS,
    click.option(
        "--columns",
        metavar="time=T,input=I,output=O[,torque=M,temperature=C,record=R]",
        help="The BAGS are CSV files with these columns [s, rad, rad, N m, degree Celsius], or in other "
        "units: input=m[deg], output=l[counts/8192], torque=i[A]*11.2.",
    ),
    click.option(
        "--rate",
        type=click.FloatRange(0.0, min_open=True),
        help="Rows per second of CSV files without a time.",
    ),
    click.option(
        "--delimiter", default="", help="Between the columns of CSV files, tab or space. [default: detected]"
    ),
    click.option(
        "--input-divided",
        "divided",
        is_flag=True,
        help="The input angle of the CSV files is already divided by the ratio.",
    ),
    click.option(
        "--effects",
        "effect_files",
        metavar="FILE",
        multiple=True,
        type=Source(dir_okay=False, path_type=Path),
        help="Python file with further effects, as EFFECT or EFFECTS; repeatable. The file is executed.",
    ),
)
"""Options that choose a verb's records."""


@contextmanager
def needing_ros(what: str) -> Iterator[None]:
    """Report an ImportError inside as missing ROS."""
    try:
        yield
    except ImportError as error:
        raise Problem(
            f"{what} needs ROS 2 Jazzy (rclpy), which cannot be imported: {error}; "
            "source its setup.bash, or take the hd-diag of make demo"
        ) from error

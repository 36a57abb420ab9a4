"""The node's command line and parameter files, checked before ROS reads them."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from rclpy.utilities import remove_ros_args

from hd_diag.config.configuration import ConfigError, load
from hd_diag.config.parameter_file import for_any_node, is_for, sections
from hd_diag.formatting import visible


class UsageError(Exception):
    """Arguments that cannot be used; the text is one line."""


def check_arguments(arguments: Sequence[str], config_file: str = "") -> dict[str, list[str]]:
    """Sections of each parameter file; raises UsageError for unusable arguments and files.

    The configuration is read in every namespace, so its section ``hd_diag`` is listed as ``/**``.
    """
    unknown = remove_ros_args(list(arguments))[1:]
    if unknown:
        example = "those for ROS stand behind --ros-args, as in: --ros-args -r __ns:=/arm"
        raise UsageError(f"unknown arguments: {' '.join(unknown)}; {example}")
    found = {}
    for file in parameter_files(arguments):
        try:
            found[str(file)] = [str(name) for name in sections(file)]
        except ConfigError as error:
            raise UsageError(f"{file}: {error}") from error
    if config_file:
        found[config_file] = ["/**" if name.strip("/") == "hd_diag" else name for name in found[config_file]]
    return found


@contextlib.contextmanager
def read_in_every_namespace(arguments: Sequence[str], config_file: str) -> Iterator[list[str]]:
    """The arguments, with the configuration replaced by a copy that ROS reads for a node of any name.

    ROS silently ignores a section ``hd_diag`` if the node has a namespace or another name.
    """
    if not config_file:
        yield [*arguments]
        return
    with tempfile.NamedTemporaryFile("w", encoding="utf-8", prefix="hd_diag_", suffix=".yaml") as copy:
        copy.write(for_any_node(config_file))
        copy.flush()
        yield [copy.name if word == config_file else word for word in arguments]


def parameter_files(arguments: Sequence[str]) -> list[Path]:
    """Parameter files that a command line names."""
    return [Path(arguments[i + 1]) for i, a in enumerate(arguments[:-1]) if a == "--params-file"]


def unread(sections: Mapping[str, Sequence[str]], node: str) -> list[str]:
    """Warnings on parameter files without a section for a node; ROS accepts them silently."""
    return [
        visible(f"{file} has no section for {node}, but {', '.join(sorted(given)) or 'nothing'}")
        for file, given in sections.items()
        if not any(is_for(name, node) for name in given)
    ]


def reason(arguments: Sequence[str], error: Exception) -> str:
    """Why the node cannot start. A parameter file's own error comes first: rcl words it badly."""
    for file in parameter_files(arguments) if not isinstance(error, UsageError) else []:
        try:
            load(file)
        except ConfigError as found:
            return str(found)
    if type(error).__name__ == "UnknownROSArgsError":
        return f"unknown ROS arguments: {error}"
    return " ".join(str(error).split())

"""The node's command line and parameter files, checked before ROS reads them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rclpy.utilities import remove_ros_args

from hd_diag.config.configuration import ConfigError, load
from hd_diag.config.parameter_file import sections


class UsageError(Exception):
    """Arguments that cannot be used; the text is one line."""


def check_arguments(arguments: Sequence[str]) -> dict[str, list[Any]]:
    """Sections of each parameter file; raises UsageError for words and files that cannot be used."""
    unknown = remove_ros_args(list(arguments))[1:]
    if unknown:
        raise UsageError(f"unknown arguments: {' '.join(unknown)} (those for ROS stand behind --ros-args)")
    found = {}
    for file in parameter_files(arguments):
        try:
            found[str(file)] = sections(file)
        except ConfigError as error:
            raise UsageError(f"{file}: {error}") from error
    return found


def parameter_files(arguments: Sequence[str]) -> list[Path]:
    """Parameter files that a command line names."""
    return [Path(arguments[i + 1]) for i, a in enumerate(arguments[:-1]) if a == "--params-file"]


def reason(arguments: Sequence[str], error: Exception) -> str:
    """Why the node cannot start: the parameter file's own fault where it has one, which rcl words badly."""
    for file in parameter_files(arguments) if not isinstance(error, UsageError) else []:
        try:
            load(file)
        except ConfigError as found:
            return str(found)
    if type(error).__name__ == "UnknownROSArgsError":
        return f"unknown ROS arguments: {error}"
    return " ".join(str(error).split())

"""JSON from untrusted files, read strictly and checked against one declared structure."""

from __future__ import annotations

import json
import os
import stat
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hd_diag.config.parameters import ConfigError, check_known, shown

_LARGEST = 1_000_000  # [byte]

# `object`: anything; `str`; `dict`: any object; a `Number`; ``[shape]``: a list; ``{str: shape}``: an object
# of any keys; ``{"a": shape, "b?": shape}``: an object of these keys, those with ? optional;
# ``(shape, None)``: that or null.
Shape = Any


@dataclass(frozen=True)
class Number:
    """A number within limits."""

    low: float = -1e300
    high: float = 1e300


_WORDS: dict[Any, str] = {Number: "a number", str: "a text", list: "a list", dict: "an object {...}"}
_WHOLE = "the file"


def read_text(path: Path, kind: str = "model file") -> str:
    """Text of a regular file of some kind; a pipe or a device could block the reader for ever.

    Raises ConfigError, without the file's name, if it cannot be read, is too long or not UTF-8.
    """
    try:
        with open(path, "rb", opener=_regular) as file:
            data = file.read(_LARGEST + 1) or b""  # None if the read would block
    except (OSError, ValueError) as error:
        cause = error.strerror if isinstance(error, OSError) else error
        raise ConfigError(f"cannot be read: {cause}") from error
    if len(data) > _LARGEST:
        raise ConfigError(f"longer than {_LARGEST} bytes: not a {kind}")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise ConfigError(f"not a text in UTF-8: {error.reason} at byte {error.start}") from error


def reader(*folders: Path) -> Callable[[str, str], str]:
    """A function that gives the text of a model file by the joint's name and the path, or raises ConfigError.

    Relative paths are searched in these folders, then in the current one.
    """

    def read(joint: str, path: str) -> str:
        places = [folder / path for folder in folders if (folder / path).exists()]
        return read_text(places[0] if places else Path(path))

    return read


def _regular(path: str, flags: int) -> int:
    """Opener for ``open``: descriptor of a regular file; ValueError for others, which stay unopened."""
    kinds = stat.S_IFREG, stat.S_IFDIR  # for a folder ``open`` itself raises the right error
    if stat.S_IFMT(os.stat(path).st_mode) in kinds:
        fd = os.open(path, flags | os.O_NONBLOCK | os.O_NOCTTY)
        if stat.S_IFMT(os.fstat(fd).st_mode) in kinds:  # unchanged since then
            return fd
        os.close(fd)
    raise ValueError("it is no regular file")


def parse(text: str, shape: Shape) -> Any:
    """Content of a JSON text; raises ConfigError with one line if it departs from the declared structure."""
    try:
        content = json.loads(text, parse_constant=_refuse, object_pairs_hook=_once)
    except ConfigError:
        raise
    except (ValueError, RecursionError) as error:
        reason = "nested too deep" if isinstance(error, RecursionError) else " ".join(str(error).split())
        raise ConfigError(f"not JSON: {reason}") from error
    _check(content, shape, "")
    return content


def _refuse(constant: str) -> Any:
    raise ConfigError(f"holds {constant}, which is not a number")


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ConfigError(f"{shown(twice)} appears twice")
    return found


def _check(value: Any, shape: Shape, where: str) -> None:
    if isinstance(shape, tuple):
        if value is None:
            return
        shape = shape[0]
    kind: Any = shape if isinstance(shape, type) else type(shape)
    types: Any = (int, float) if kind is Number else kind
    if not isinstance(value, types) or (kind is Number and isinstance(value, bool)):
        raise ConfigError(f"{where or _WHOLE}: expected {_WORDS[kind]}, not {shown(value)}")
    if isinstance(shape, Number) and not shape.low <= value <= shape.high:
        limits = f"from {shape.low:g} to {shape.high:g}"
        raise ConfigError(f"{where}: expected a number {limits}, not {shown(value)}")
    if isinstance(shape, list):
        for index, item in enumerate(value):
            _check(item, shape[0], f"{where}[{index}]")
    if isinstance(shape, dict):
        _check_object(value, shape, where)


def _check_object(value: dict[str, Any], shape: Mapping[Any, Shape], where: str) -> None:
    if str in shape:
        shape = dict.fromkeys(value, shape[str])
    known = {key.removesuffix("?"): inner for key, inner in shape.items()}
    check_known(value, known, f"{where or _WHOLE} has an unknown key")
    for name, inner in known.items():
        if name in value:
            _check(value[name], inner, f"{where}.{name}" if where else name)
        elif name in shape:
            raise ConfigError(f"{where or _WHOLE} lacks '{name}'")

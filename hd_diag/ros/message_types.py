"""Installed message types: their classes, and their definitions for the log and for reading fields."""

from __future__ import annotations

import importlib
import re
from typing import Any

from hd_diag.config.parameters import ConfigError
from hd_diag.messages.schemas import Definition, definition, jazzy
from hd_diag.streams.signals import nearest

_SEPARATOR = "=" * 80
_NAMES = {"boolean": "bool", "octet": "byte", "float": "float32", "double": "float64"}
_SEQUENCE = re.compile(r"sequence<(.+?)(?:, (\d+))?>")
_ARRAY = re.compile(r"(.+)\[(\d+)\]")
_NO_FIELDS = "uint8 structure_needs_at_least_one_member"


def message_class(type_name: str) -> Any:
    """Class of a message type, ``package/msg/Name``; ConfigError if it is not installed."""
    package, _, name = type_name.split("/")
    try:
        module = importlib.import_module(f"{package}.msg")
    except ImportError as error:
        raise ConfigError(f"{type_name} is not installed here: {error}") from error
    if not hasattr(module, name):
        near = nearest(name, [n for n in vars(module) if n[:1].isupper()])
        raise ConfigError(f"{package} has no message {name}{near and f'; the nearest is {near}'}")
    return getattr(module, name)


def definition_of(type_name: str) -> Definition:
    """Definition of an installed message type and of those that it uses."""
    return definition(type_name) if type_name in jazzy().fielddefs else definition_by_class(type_name)


def definition_by_class(type_name: str) -> Definition:
    """As `definition_of`, built from the fields of the installed classes."""
    parts: dict[str, str] = {}
    wanted = [type_name]
    while wanted:
        name = wanted.pop()
        if name not in parts:
            fields = message_class(name).get_fields_and_field_types()
            lines = [f"{_type(text)} {field}" for field, text in fields.items()]
            parts[name] = "\n".join(lines or [_NO_FIELDS])
            wanted += [_full(t) for t in (_element(text) for text in fields.values()) if "/" in t]
    head = parts.pop(type_name)
    more = [f"{_SEPARATOR}\nMSG: {name.replace('/msg/', '/')}\n{text}" for name, text in parts.items()]
    return Definition(type_name, "\n".join([head, *more]) + "\n")


def _type(text: str) -> str:
    """A field's type in the notation of message files."""
    if found := _SEQUENCE.fullmatch(text):
        return f"{_type(found[1])}[{f'<={found[2]}' if found[2] else ''}]"
    if found := _ARRAY.fullmatch(text):
        return f"{_type(found[1])}[{found[2]}]"
    base, bracket, bound = text.partition("<")
    return _NAMES.get(text, f"{base}<={bound[:-1]}" if bracket else text)


def _element(text: str) -> str:
    found = _SEQUENCE.fullmatch(text) or _ARRAY.fullmatch(text)
    return found[1] if found else text


def _full(name: str) -> str:
    package, _, own = name.partition("/")
    return f"{package}/msg/{own}"

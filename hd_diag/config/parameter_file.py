"""ROS parameter files: YAML as ROS itself reads it, and back."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from hd_diag.config.json_shape import read_text
from hd_diag.config.parameters import ROS_PARAMETERS, ConfigError, Value, flatten, nested, shown

_NODE, _EVERY = "hd_diag", "/**"
_EXPECTED = "expected 'hd_diag: ros__parameters: ...' at the top"
_INTEGER = re.compile(r"[-+]?(0|[1-9][0-9]*)$")
_REAL = re.compile(
    r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?$|[-+]?\.(inf|Inf|INF)$|\.(nan|NaN|NAN)$"
)


class _Loader(yaml.SafeLoader):
    """YAML with the numbers of ROS (1e-6 is one, 2026-01-01 a text), without aliases or repeated keys."""

    yaml_implicit_resolvers = {  # noqa: RUF012, PyYAML's own way to say it
        first: [(tag, form) for tag, form in found if not tag.endswith((":int", ":float", ":timestamp"))]
        for first, found in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Refuse aliases, as ROS does: a few of them can expand to a document of any size."""
        if self.check_event(yaml.AliasEvent):
            line = self.line + 1
            raise yaml.YAMLError(f"line {line}: an alias (*name), which ROS does not take")
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        """Refuse a key that appears twice: the last would win unseen."""
        mapping: dict[Any, Any] = super().construct_mapping(node, deep=deep)
        if len(mapping) != len(node.value):
            keys = [key.value for key, _ in node.value]
            twice = next((key for key in keys if keys.count(key) > 1), keys[0])
            raise yaml.YAMLError(f"line {node.start_mark.line + 1}: {shown(twice)} appears twice below it")
        return mapping


_Loader.add_implicit_resolver("tag:yaml.org,2002:int", _INTEGER, list("-+0123456789"))
_Loader.add_implicit_resolver("tag:yaml.org,2002:float", _REAL, list("-+.0123456789"))


def read(path: str | Path) -> dict[str, Any]:
    """Flat parameters of a file, without those that every ROS node has.

    YAML: ``hd_diag: ros__parameters: ...``; a node name with namespace, and ``/**``, are accepted too. The
    values are not yet checked. Raises ConfigError with the reason if it is no parameter file of this node.
    """
    document = _document(path)
    if not isinstance(document, Mapping):
        raise ConfigError(_EXPECTED)
    sections = {k: s for k, s in document.items() if str(k).rsplit("/", 1)[-1] in (_NODE, "**", "*")}
    if not sections:
        raise ConfigError(_EXPECTED)
    flat: dict[str, Any] = {}
    for name, section in sections.items():
        if not isinstance(section, Mapping) or not isinstance(section.get("ros__parameters"), Mapping):
            raise ConfigError(f"{shown(name)} holds no 'ros__parameters'")
        flat |= flatten(section["ros__parameters"])
    return {name: value for name, value in flat.items() if name.split(".")[0] not in ROS_PARAMETERS}


def sections(path: str | Path) -> list[Any]:
    """Names of the nodes with a section in a file; raises ConfigError if it is not ROS YAML."""
    document = _document(path)
    if document is None:
        return []
    if not isinstance(document, Mapping):
        raise ConfigError(_EXPECTED)
    return list(document)


def for_any_node(path: str | Path) -> str:
    """The text of a file with the section of ``hd_diag`` renamed to that of every node, ``/**``.

    All other text stays unchanged. Raises ConfigError if it is not ROS YAML.
    """
    sections(path)
    text = read_text(Path(path), "parameter file")
    document = yaml.compose(text, _Loader)
    for key, _ in reversed(document.value if document else []):
        if str(key.value).strip("/") == _NODE:
            text = f"{text[: key.start_mark.index]}{_EVERY!r}{text[key.end_mark.index :]}"
    return text


def is_for(section: str, node: str) -> bool:
    """Whether ROS applies a file's section to a node, by its full name; ``*`` is one name, ``**`` any."""
    parts = section.strip("/").split("/")
    pattern = "".join({"**": r"(/\w+)*", "*": r"/\w+"}.get(part, f"/{re.escape(part)}") for part in parts)
    return re.fullmatch(pattern, node) is not None


def parse_value(text: str) -> Any:
    """A single value written as in a parameter file; raises ConfigError if it is not YAML."""
    try:
        return yaml.load(text, _Loader)
    except yaml.YAMLError as error:
        raise ConfigError(f"not a value: {text!r}") from error


def _document(path: str | Path) -> Any:
    text = read_text(Path(path), "parameter file")
    try:
        return yaml.load(text, _Loader)
    except Exception as error:  # PyYAML also raises other errors than YAMLError on wrong tags and depth
        raise ConfigError(f"not YAML: {_reason(error)}") from error


def _reason(error: Exception) -> str:
    """Message of a PyYAML error in one line, without the text that it quotes."""
    mark = getattr(error, "problem_mark", None)
    if mark is None:
        return " ".join(str(error).split()) or type(error).__name__
    context = getattr(error, "context", None)
    where = f"line {mark.line + 1}, column {mark.column + 1}: {getattr(error, 'problem', '')}"
    return f"{where}, {context}" if context else where


def text(flat: Mapping[str, Value]) -> str:
    """The text of a parameter file with these values."""
    written: str = yaml.safe_dump({_NODE: {"ros__parameters": nested(flat)}}, sort_keys=False)
    return written

"""ROS parameter files: YAML as ROS itself reads it, and back."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from hd_diag.parameters import ROS_PARAMETERS, ConfigError, Value, flatten, nested, shown

_NODE = "hd_diag"
_LARGEST = 1_000_000  # [byte]; seven joints take 20,000
_EXPECTED = "expected 'hd_diag: ros__parameters: ...' at the top"


class _Loader(yaml.SafeLoader):
    """YAML with the numbers of ROS (1e-6 is one), no aliases, and no key twice."""

    yaml_implicit_resolvers = {  # noqa: RUF012 - PyYAML's own way
        first: [(tag, pattern) for tag, pattern in found if not tag.endswith((":int", ":float", ":timestamp"))]
        for first, found in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Refuse aliases, as ROS does: a few of them make a document of any size."""
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError(f"aliases (*name) are not for parameter files{self.peek_event().start_mark}")
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        """Refuse a key that stands twice, where the last would win unseen."""
        mapping = super().construct_mapping(node, deep=deep)
        if len(mapping) != len(node.value):
            keys = [key.value for key, _ in node.value]
            twice = next((key for key in keys if keys.count(key) > 1), keys[0])
            raise yaml.YAMLError(f"key {shown(twice)} stands twice{node.start_mark}")
        return mapping


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?$|[-+]?\.(inf|Inf|INF)$|\.(nan|NaN|NAN)$"),
    list("-+.0123456789"),
)
_Loader.yaml_implicit_resolvers = {
    first: [*found, ("tag:yaml.org,2002:int", re.compile(r"[-+]?(0|[1-9][0-9]*)$"))][::-1]
    for first, found in _Loader.yaml_implicit_resolvers.items()
}

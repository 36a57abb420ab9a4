"""What rosbag2 adds to its storage files: offered QoS profiles and ``metadata.yaml``, version 9 (Jazzy)."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import yaml

VERSION = 9
# rmw's infinite duration; rosbag2 writes it where a deadline, lifespan or lease is not set.
INFINITE = (9223372036, 854775807)
# rosbag2 starts from the largest time and lowers it with each message.
NO_START = 2**63 - 1

_POLICIES = {
    "history": ("system_default", "keep_last", "keep_all", "unknown"),
    "reliability": ("system_default", "reliable", "best_effort", "unknown", "best_available"),
    "durability": ("system_default", "transient_local", "volatile", "unknown", "best_available"),
    "liveliness": (
        "system_default",
        "automatic",
        "manual_by_node",
        "manual_by_topic",
        "unknown",
        "best_available",
    ),
}


@dataclass(frozen=True)
class Qos:
    """Quality of service that a publisher offered; durations as (seconds, nanoseconds)."""

    history: str = "keep_last"
    depth: int = 10
    reliability: str = "reliable"
    durability: str = "volatile"
    deadline: tuple[int, int] = INFINITE
    lifespan: tuple[int, int] = INFINITE
    liveliness: str = "automatic"
    liveliness_lease_duration: tuple[int, int] = INFINITE
    avoid_ros_namespace_conventions: bool = False

    def node(self) -> dict[str, Any]:
        """The profile as version 9 of the metadata spells it."""
        pairs = asdict(self).items()
        return {k: {"sec": v[0], "nsec": v[1]} if isinstance(v, tuple) else v for k, v in pairs}


def dump_offers(offers: Iterable[Qos]) -> str:
    """Profiles as the YAML text of a channel's ``offered_qos_profiles``; empty text for none."""
    nodes = [qos.node() for qos in offers]
    return _dump(nodes).rstrip("\n") if nodes else ""


def parse_offers(text: Any) -> tuple[Qos, ...]:
    """Profiles from a channel's ``offered_qos_profiles``, of any metadata version; none where unreadable."""
    try:
        nodes = load_yaml(text) if isinstance(text, str) else text
        return tuple(_qos(node) for node in nodes or ())
    except (yaml.YAMLError, KeyError, TypeError, ValueError, AttributeError, RecursionError):
        return ()


def _qos(node: Mapping[str, Any]) -> Qos:
    values = {key: _value(key, node[key]) for key in Qos.__dataclass_fields__ if key in node}
    return Qos(**values)


def _value(key: str, value: Any) -> Any:
    """One entry of a profile; before version 9 the policies were rmw's enum numbers."""
    if key in _POLICIES:
        names = _POLICIES[key]
        name = value if isinstance(value, str) else names[value] if 0 <= value < len(names) else ""
        return name if name in names else "unknown"
    if key == "depth":
        return int(value)
    if key == "avoid_ros_namespace_conventions":
        return bool(value)
    return int(value["sec"]), int(value["nsec"])


@dataclass
class FileInformation:
    """Counts and times of one storage file; times in log time [ns]."""

    path: str
    start: int = NO_START
    end: int = 0
    count: int = 0

    def node(self) -> dict[str, Any]:
        """The entry as ``metadata.yaml`` spells it."""
        return {"path": self.path, **_times(self.start, self.end), "message_count": self.count}


@dataclass
class TopicInformation:
    """A topic of a bag."""

    name: str
    type_name: str
    offers: tuple[Qos, ...] = ()
    type_hash: str = ""
    count: int = 0

    def node(self) -> dict[str, Any]:
        """The entry as ``metadata.yaml`` spells it."""
        topic = {
            "name": self.name,
            "type": self.type_name,
            "serialization_format": "cdr",
            "offered_qos_profiles": [qos.node() for qos in self.offers],
            "type_description_hash": self.type_hash,
        }
        return {"topic_metadata": topic, "message_count": self.count}


@dataclass
class Metadata:
    """Content of ``metadata.yaml``."""

    storage: str = "mcap"
    files: list[FileInformation] = field(default_factory=list)
    topics: list[TopicInformation] = field(default_factory=list)
    custom_data: dict[str, str] = field(default_factory=dict)
    ros_distro: str = "jazzy"

    def node(self) -> dict[str, Any]:
        """The mapping that rosbag2 puts below ``rosbag2_bagfile_information``."""
        start = min((f.start for f in self.files), default=NO_START)
        return {
            "version": VERSION,
            "storage_identifier": self.storage,
            **_times(start, max((f.end for f in self.files), default=0), duration_first=True),
            "message_count": sum(f.count for f in self.files),
            "topics_with_message_count": [t.node() for t in self.topics],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [f.path for f in self.files],
            "files": [f.node() for f in self.files],
            "custom_data": self.custom_data or None,
            "ros_distro": self.ros_distro,
        }

    def text(self) -> str:
        """The mapping as YAML, as rosbag2 keeps it inside an MCAP file."""
        return _dump(self.node())

    def save(self, folder: Path) -> None:
        """Write ``metadata.yaml``; the old one stays whole until the new one is there.

        Raises
        ------
        OSError
            Where the folder cannot be written.
        """
        target = folder / "metadata.yaml"
        draft = target.with_suffix(".yaml.tmp")
        draft.write_text(_dump({"rosbag2_bagfile_information": self.node()}), encoding="utf-8")
        os.replace(draft, target)


def _times(start: int, end: int, *, duration_first: bool = False) -> dict[str, Any]:
    begin = {"starting_time": {"nanoseconds_since_epoch": start}}
    length = {"duration": {"nanoseconds": max(0, end - start)}}
    return length | begin if duration_first else begin | length


class _Dumper(getattr(yaml, "CSafeDumper", yaml.SafeDumper)):  # type: ignore[misc]
    """No anchors: rosbag2's files have none, and equal profiles are common."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
# rosbag2's own files have a depth of 7.
_MAX_DEPTH = 50
_MAX_TEXT = 4 << 20


def load_yaml(text: str | bytes) -> Any:
    """Plain values of YAML of bounded size and depth: libyaml's loader crashes on deep nesting.

    Raises
    ------
    ValueError or yaml.YAMLError
        Where it is not YAML, too large or too deep.
    """
    if len(text) > _MAX_TEXT:
        raise ValueError(f"{len(text)} bytes of YAML are too many")
    depth = 0
    for event in yaml.parse(text, Loader=_Loader):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > _MAX_DEPTH:
            raise ValueError("YAML is nested too deep")
    return yaml.load(text, Loader=_Loader)


def _dump(node: Any) -> str:
    return yaml.dump(node, Dumper=_Dumper, sort_keys=False, default_flow_style=False, allow_unicode=True)

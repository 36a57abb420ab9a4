"""Additions of rosbag2 to storage files: offered QoS profiles and ``metadata.yaml``, version 9 (Jazzy)."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from mcap.records import Statistics
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

from hd_diag.bag.mcap_file import Stream, Written

_NO_START = 2**63 - 1  # rosbag2 starts from the largest time and lowers it with each message [ns]
# rmw's infinite duration; rosbag2 writes it if a deadline, lifespan or lease is not set.
_INFINITE = QosTime(9223372036, 854775807)
RELIABLE = Qos(
    history=QosHistory.KEEP_LAST,
    depth=10,
    reliability=QosReliability.RELIABLE,
    durability=QosDurability.VOLATILE,
    deadline=_INFINITE,
    lifespan=_INFINITE,
    liveliness=QosLiveliness.AUTOMATIC,
    liveliness_lease_duration=_INFINITE,
    avoid_ros_namespace_conventions=False,
)
"""QoS profile that publishers offer by default."""
UNREADABLE = yaml.YAMLError, KeyError, TypeError, ValueError, AttributeError, RecursionError, OverflowError
"""Errors raised by invalid or unexpected YAML."""
_MAX_DEPTH = 50  # rosbag2's own files have a depth of 7
_MAX_TEXT = 4 << 20


@functools.lru_cache(maxsize=256)
def plain_offers(text: str) -> str:
    """A channel's ``offered_qos_profiles`` in this version's form; cached, as a bag may have 20,000."""
    return dump_offers(parse_offers(text))


@functools.lru_cache(maxsize=256)
def _listed_offers(text: str) -> Any:
    return load_yaml(text) or []


def dump_offers(offers: Sequence[Qos]) -> str:
    """Profiles as the YAML text of a channel's ``offered_qos_profiles``; empty text for none."""
    if not offers:
        return ""
    from rosbags.rosbag2.metadata import dump_qos_v9  # late: it imports all of rosbags

    return dump_yaml(dump_qos_v9(list(offers))).rstrip("\n")


def parse_offers(text: str) -> list[Qos]:
    """Profiles from a channel's ``offered_qos_profiles`` of any metadata version; empty if unreadable."""
    from rosbags.rosbag2.metadata import parse_qos  # late: it imports all of rosbags

    try:
        return [_plain(offer) for offer in parse_qos(load_yaml(text) or [])]
    except UNREADABLE:
        return []


def _plain(offer: Qos) -> Qos:
    """The profile with durations and depth converted to int, because a hostile one may hold anything."""
    pairs = offer._asdict().items()
    plain: dict[str, Any] = {
        name: QosTime(*map(int, time)) for name, time in pairs if isinstance(time, QosTime)
    }
    plain["avoid_ros_namespace_conventions"] = bool(offer.avoid_ros_namespace_conventions)
    return offer._replace(depth=int(offer.depth), **plain)


def written(files: Iterable[Written], stream: Stream) -> int:
    """Number of a topic's messages that have reached the files."""
    return sum(file.statistics.channel_message_counts.get(stream.channel.id, 0) for file in files)


def metadata(files: Sequence[Written], streams: Iterable[Stream]) -> dict[str, Any]:
    """The mapping that rosbag2 puts below ``rosbag2_bagfile_information``, for files and topics."""
    topics = [
        {
            "topic_metadata": {
                "name": stream.channel.topic,
                "type": stream.schema.name,
                "serialization_format": stream.channel.message_encoding,
                "offered_qos_profiles": _listed_offers(stream.channel.metadata["offered_qos_profiles"]),
                "type_description_hash": stream.channel.metadata["topic_type_hash"],
            },
            "message_count": written(files, stream),
        }
        for stream in streams
    ]
    return {
        "version": 9,
        "storage_identifier": "mcap",
        **_extent([file.statistics for file in files]),
        "topics_with_message_count": topics,
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.path.name for file in files],
        "files": [{"path": file.path.name, **_extent([file.statistics])} for file in files],
        "custom_data": None,
        "ros_distro": "jazzy",
    }


def _extent(files: Sequence[Statistics]) -> dict[str, Any]:
    start = min([_NO_START, *(f.message_start_time for f in files if f.message_count)])
    duration = max(0, max(f.message_end_time for f in files) - start)
    return {
        "duration": {"nanoseconds": duration},
        "starting_time": {"nanoseconds_since_epoch": start},
        "message_count": sum(f.message_count for f in files),
    }


class _Dumper(getattr(yaml, "CSafeDumper", yaml.SafeDumper)):  # type: ignore[misc]
    """Dumper without anchors: equal profiles are common, but rosbag2's files have no anchors."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def dump_yaml(node: Mapping[str, Any] | Sequence[Any]) -> str:
    """YAML as rosbag2 writes it."""
    return yaml.dump(node, Dumper=_Dumper, sort_keys=False, default_flow_style=False, allow_unicode=True)


def load_yaml(source: str | Path) -> Any:
    """Plain values of YAML; ValueError if it is too long, or so deep that libyaml's loader would crash."""
    size = source.stat().st_size if isinstance(source, Path) else len(source)
    if size > _MAX_TEXT:
        raise ValueError(f"{size} bytes of YAML are too many")
    text = source.read_bytes() if isinstance(source, Path) else source
    depth = 0
    for event in yaml.parse(text, Loader=_Loader):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > _MAX_DEPTH:
            raise ValueError("YAML is nested too deep")
    return yaml.load(text, Loader=_Loader)

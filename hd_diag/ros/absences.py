"""Why joints get no samples, as far as the ROS graph shows it: who publishes which topic."""

from __future__ import annotations

import time
from collections.abc import Sequence

from rclpy.node import Node

from hd_diag.formatting import listed
from hd_diag.messages.fields import FieldReader
from hd_diag.messages.publications import INPUT, OWN_OUTPUTS
from hd_diag.monitor.absence import absence_of, missing
from hd_diag.monitor.settings import JointConfig
from hd_diag.ros.subscriptions import Reader, SignalInput, SignalTopic

_SHOWN = 5  # topics or nodes in a list


def absences(
    node: Node, inputs: Sequence[tuple[SignalInput, Reader]], joints: Sequence[JointConfig]
) -> dict[str, str]:
    """Facts for the diagnostics on joints whose input topic is silent or lacks the configured name."""
    found, now = {}, time.monotonic()
    by_topic = {each.source.topic: (each, reader) for each, reader in inputs}
    for joint in joints:
        signal = joint.signals.input
        taken, reader = by_topic[node.resolve_topic_name((signal and signal.topic) or INPUT)]
        if now - taken.heard > joint.limits["silence"].warn:
            found[absence_of(joint.name)] = _quiet(node, taken.source)
        elif signal and isinstance(reader, FieldReader) and reader.names and signal.name not in reader.names:
            found[absence_of(joint.name)] = f"{taken.source.topic}: {missing(signal.name, reader.names)}"
    return found


def _quiet(node: Node, source: SignalTopic) -> str:
    """Text on a silent topic: who publishes it, or which other topics carry its type."""
    topic, kind = source.topic, source.type_name
    infos = [i for i in node.get_publishers_info_by_topic(topic) if i.topic_type == kind]
    if infos:
        nodes = sorted({f"{i.node_namespace.rstrip('/')}/{i.node_name}" for i in infos})
        return f"nothing arrives on {topic}, which {listed(nodes, _SHOWN)} publishes"
    others = [
        name
        for name, kinds in node.get_topic_names_and_types()
        if kind in kinds and name != topic and not name.endswith(OWN_OUTPUTS) and node.count_publishers(name)
    ]
    return f"nobody publishes {topic}" + (
        f"; {kind} is on {listed(sorted(others), _SHOWN)}" if others else ""
    )

"""Running nodes in the terminal: what is known of them (`state`), how it arrives, how it is shown."""

from hd_diag.watch.state import (
    DEFAULT_TOPIC,
    LEVELS,
    PREFIX,
    JointView,
    NodeSeen,
    ReportedStatus,
    Watch,
    as_json,
)

__all__ = ["DEFAULT_TOPIC", "LEVELS", "PREFIX", "JointView", "NodeSeen", "ReportedStatus", "Watch", "as_json"]

"""Running nodes in the terminal: what is known of them (`seen`), how it arrives, how it is shown."""

from hd_diag.watch.seen import DEFAULT_TOPIC, LEVELS, PREFIX, JointView, Message, NodeSeen, Watch, as_json

__all__ = ["DEFAULT_TOPIC", "LEVELS", "PREFIX", "JointView", "Message", "NodeSeen", "Watch", "as_json"]

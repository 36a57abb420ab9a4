"""Running nodes in the terminal: what is known of them (`state`), how it arrives, how it is shown."""

from hd_diag.watch.state import PREFIX, JointView, Watch, as_json

__all__ = ["PREFIX", "JointView", "Watch", "as_json"]

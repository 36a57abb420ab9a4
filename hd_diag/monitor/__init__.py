"""What runs live, and in a replay: samples in, predictions, per-tooth arrays and diagnostics out; no ROS."""

from hd_diag.monitor.all_joints import Monitor, warm_up

__all__ = ["Monitor", "warm_up"]

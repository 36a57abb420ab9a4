"""Monitor, live and in a replay: samples in, predictions, per-tooth arrays and diagnostics out; no ROS."""

"""The live edge: the rclpy node and the writer of its log."""

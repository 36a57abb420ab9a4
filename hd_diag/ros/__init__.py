"""The rclpy node and the writer of its log."""

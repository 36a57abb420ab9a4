"""ROS 2 messages as bytes, without ROS: encodes and decodes many messages at once."""

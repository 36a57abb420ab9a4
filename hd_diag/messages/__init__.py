"""ROS 2 messages as bytes, without ROS: what is published, what is read, many rows at once."""

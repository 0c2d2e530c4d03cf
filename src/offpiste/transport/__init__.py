"""Transport of ROS 2 messages to and from a robot over zenoh."""

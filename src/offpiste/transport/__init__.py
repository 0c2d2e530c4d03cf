"""Transport of ROS 2 messages to and from a robot: an interface, and its implementation over zenoh."""

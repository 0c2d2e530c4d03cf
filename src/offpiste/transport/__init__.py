"""Messages to and from a robot that runs ROS 2, without ROS: one small interface, and zenoh behind it."""

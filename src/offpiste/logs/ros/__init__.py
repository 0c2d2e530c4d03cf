"""ROS messages without ROS: files of bags, decoding, writing, and messages from and to arrays."""

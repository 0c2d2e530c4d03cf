"""Driving a vehicle that runs ROS 2: its messages in, commands out, watched over by processes of their own."""

"""Example: offpiste drives a vehicle by rclpy instead of zenoh."""

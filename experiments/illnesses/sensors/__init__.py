"""Simulated drives with a camera and a LiDAR, healthy and ill, on which the checks of sensors are scored."""
